"""Filters on a ping's image."""
