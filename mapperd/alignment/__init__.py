"""Estimates trajectories again from what the sonar saw: submaps, registration, pose graph."""
