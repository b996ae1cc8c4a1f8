"""Mounting, time offset and scale of the ranges, estimated from a recording over structure."""
