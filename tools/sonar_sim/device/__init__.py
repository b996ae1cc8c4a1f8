"""The simulator as a device: what it makes of fire messages, without sockets."""
