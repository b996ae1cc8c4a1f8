"""The settings: their types, files, layers and changes while running."""
