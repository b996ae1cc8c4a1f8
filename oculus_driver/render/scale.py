"""Round numbers for range rings and bearing spokes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MOST_RINGS: Final = 6
_SLACK: Final = 2e-3
"""Images end a little before the range that was asked for: 1.998 m are shown with a ring at 2 m."""

_SPOKE_STEPS_DEG: Final = (5, 10, 15, 30, 45)
_MOST_SPOKES: Final = 9


def ring_ranges_m(max_range_m: float) -> list[float]:
    """Return at most six ranges, multiples of 1, 2 or 5 times a power of ten."""
    step = 10.0 ** math.floor(math.log10(max_range_m / _MOST_RINGS))
    factor = next(f for f in (1, 2, 5, 10, 20) if max_range_m / (f * step) <= _MOST_RINGS + 1e-9)
    step *= factor
    count = math.floor(max_range_m / step * (1.0 + _SLACK))
    return [round(step * index, 9) for index in range(1, count + 1)]


def spoke_bearings_deg(bearings_rad: NDArray[np.float64]) -> list[int]:
    """Return at most nine whole bearings within the aperture, 0 among them if it is inside."""
    low, high = np.degrees(bearings_rad[[0, -1]])
    slack = 0.5
    for step in _SPOKE_STEPS_DEG:
        first = math.ceil((low - slack) / step)
        last = math.floor((high + slack) / step)
        if last - first < _MOST_SPOKES:
            return [step * index for index in range(first, last + 1)]
    return [0]
