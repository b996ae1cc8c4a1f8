"""Poses, motions and trajectories in space."""
