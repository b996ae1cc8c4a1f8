"""Where the vehicle is on a map that is known: scans, maps, and what becomes of an estimate."""
