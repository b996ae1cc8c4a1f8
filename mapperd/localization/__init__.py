"""Localization: a particle filter finds the vehicle on a known map."""
