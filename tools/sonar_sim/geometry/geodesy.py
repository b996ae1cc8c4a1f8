"""Degrees and metres about a place on Earth."""

import math

EQUATOR_M = 6_378_137.0
"""Semi-major axis of WGS-84."""
ECCENTRICITY_SQUARED = 6.694_379_990_141e-3
"""Of WGS-84."""


def metres_per_degree(latitude_deg: float) -> tuple[float, float]:
    """Metres a degree of latitude and of longitude at a latitude of WGS-84.

    They follow from the radii of curvature there, and hold over some kilometres.
    """
    latitude_rad = math.radians(latitude_deg)
    flat = 1.0 - ECCENTRICITY_SQUARED * math.sin(latitude_rad) ** 2
    meridian_m = EQUATOR_M * (1.0 - ECCENTRICITY_SQUARED) / flat**1.5
    parallel_m = EQUATOR_M / math.sqrt(flat) * math.cos(latitude_rad)
    return math.radians(meridian_m), math.radians(parallel_m)
