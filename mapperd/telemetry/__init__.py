"""Telemetry to an MQTT broker: status, events, and commands where they are allowed."""
