"""Odometry: decodes the vehicle's bytes to records and fuses them to the pose at a ping's time."""
