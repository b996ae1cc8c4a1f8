"""Frames of reference, places on Earth, motion and planar estimates."""
