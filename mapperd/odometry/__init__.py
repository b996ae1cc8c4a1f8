"""Odometry: bytes from the vehicle become records, records become the pose at a ping's time."""
