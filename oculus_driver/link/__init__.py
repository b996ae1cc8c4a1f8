"""The link to one sonar: state machine, connection, received pings, confirmation of settings."""
