"""Run a benchmark: `PYTHONPATH=tools python -m bench NAME [ARGUMENTS]`."""

import sys

from studies.runner import run_program

BENCHMARKS = {
    "bridges": "bench.bridges",
    "capture-reading": "bench.capture_reading",
    "detail": "bench.detail",
    "driver-throughput": "bench.driver_throughput",
    "image-filters": "bench.image_filters",
    "integrators": "bench.integrators",
    "localization": "bench.localization",
    "map-size": "bench.map_size",
    "odometry-cost": "bench.odometry_cost",
    "open-water": "bench.open_water",
    "ping-motion": "bench.ping_motion",
    "simulator-speed": "bench.simulator_speed",
    "stream-source": "bench.stream_source",
    "tile-cache": "bench.tile_cache",
    "view-load": "bench.view_load",
}
"""Module of each benchmark, which has a `main`."""

if __name__ == "__main__":
    sys.exit(run_program("bench", BENCHMARKS, sys.argv[1:]))
