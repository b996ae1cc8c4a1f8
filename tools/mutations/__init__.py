"""Mutation check: each guarded formula is broken once, and a test must notice."""
