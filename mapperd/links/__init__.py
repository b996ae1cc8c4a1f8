"""Links to the vehicle: where bytes come from, kept open, and known by name and state."""
