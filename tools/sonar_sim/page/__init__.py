"""The page of a served scene: its vehicles, live pings, and a pilot's keys."""
