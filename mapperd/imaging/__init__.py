"""From a ping to its image: detection of robots, and filters."""
