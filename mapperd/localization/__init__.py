"""Where the vehicle is on a known map: scans, maps, particle filter, corrections."""
