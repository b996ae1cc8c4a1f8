"""The way of a ping: from bytes to the map."""
