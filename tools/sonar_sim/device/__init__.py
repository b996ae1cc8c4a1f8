"""The simulator as a device that obeys fire messages."""
