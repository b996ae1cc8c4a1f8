"""The link to one sonar: connection, state machine, received pings."""
