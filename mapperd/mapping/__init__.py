"""The map, a wrapper of the C++ core, and its queries."""
