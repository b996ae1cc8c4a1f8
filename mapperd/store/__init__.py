"""The map on disk: one SQLite file that the map is larger than memory in, and survives in."""
