"""Benchmarks: speed and memory of the driver, the map and the simulator."""
