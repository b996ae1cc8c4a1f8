"""The map on disk: one SQLite file, larger than memory, that survives a crash."""
