"""The map stream and the control socket of a daemon."""
