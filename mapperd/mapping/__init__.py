"""The map over the C++ core, and questions to it."""
