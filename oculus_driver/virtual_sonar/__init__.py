"""A virtual sonar that serves recordings."""
