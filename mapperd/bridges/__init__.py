"""Bridges from a daemon to ROS 2 and autopilots, and the watch for changes: clients of it."""
