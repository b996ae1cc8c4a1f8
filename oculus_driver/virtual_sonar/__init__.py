"""A virtual sonar: statuses on UDP, pings on TCP, and fire messages with their effect."""
