"""Pieces of the vehicle's way as messages, which hold double precision in two single ones.

Points alone are half a metre off where the map's zero is 4650 km away, as that of a survey's zone.
They go on being in the map's frame, which whoever knows no more of a path reads; what rounding
them left goes beside them.
"""

import numpy as np
from numpy.typing import NDArray

from mapperd.wire.messages import Path

__all__ = ["SEEN_M", "path_message"]

SEEN_M = 1e-3
"""Rounding is told from here on; within 32 km of the map's zero it is less, and costs no bytes."""


def path_message(first: int, points_m: NDArray[np.float64], version: int = 0) -> Path:
    """A piece of the path, (N, 3) metres, map frame, whose first point has that number."""
    points = points_m.astype("<f4")
    rest = points_m - points
    told = bool((np.abs(rest) >= SEEN_M).any())
    return Path(
        first=first,
        points=points.tobytes(),
        version=version,
        rest=rest.astype("<f4").tobytes() if told else b"",
    )
