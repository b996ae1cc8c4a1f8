"""What the map stream and the control socket carry, for servers and clients."""
