"""Estimates a dive's trajectory again from what the sonar saw: submaps, registration, pose graph."""
