"""Recordings, replay, recovery and the start of a session."""
