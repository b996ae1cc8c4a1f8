"""Many recordings, one map: the daemon's map code over surveys larger than one machine."""
