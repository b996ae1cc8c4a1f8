"""A survey of two hours over a simulated seabed, mapped whole by `mapper-survey` and judged."""
