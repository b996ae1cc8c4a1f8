"""One live session, and the daemon around it."""
