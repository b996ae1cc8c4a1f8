"""Files made from a map; the map itself is the only copy of the data."""
