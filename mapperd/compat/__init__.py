"""The names and settings of the published mapper."""
