"""Mutation check: breaks each guarded formula once; a test must fail."""
