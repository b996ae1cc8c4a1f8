"""The live map in Foxglove, and recordings for it."""
