"""Paths of the sound, what it loses on them, and what comes back."""
