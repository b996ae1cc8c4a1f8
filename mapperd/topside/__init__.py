"""What people at the surface look at: viewers, recordings and files fed by the map stream."""
