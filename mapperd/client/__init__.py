"""The live map of a daemon, mirrored: watch it grow, ask it, or steer the daemon."""
