"""Whether alignment mends the drift of odometry: simulated dives, aligned and judged."""
