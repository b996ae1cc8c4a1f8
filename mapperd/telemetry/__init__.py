"""Telemetry to an MQTT broker: how it goes, what happened, and commands where they are allowed."""
