"""A driver of Blueprint Subsea Oculus multibeam imaging sonars, useful alone."""
