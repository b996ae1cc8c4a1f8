"""Bearing tables: hundredths of a degree on the wire, uniform in sine."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from oculus_driver.errors import EncodeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

CENTIDEGREE_RAD: Final = math.pi / 18000.0

_ROUNDING_GUARD_CDEG: Final = 1e-9
"""Larger than the rounding error of asin(sin(A)), smaller than the table's step: 30° stays 3000."""


def bearing_table_cdeg(beams: int, half_aperture_rad: float) -> NDArray[np.int16]:
    """Return the bearing table of a sonar: uniform in sine, truncated toward zero.

    `b_j = trunc(100 * deg(asin(sin A * (2j/(N-1) - 1))))`. With A = 30° this reproduces all 256
    values of the known captures exactly.

    Args:
        beams: number of beams, N ≥ 1. A single beam points straight ahead.
        half_aperture_rad: A, greater than 0 and at most π/2.

    Returns:
        int16 (beams,), strictly increasing, positive to starboard.

    Raises:
        EncodeError: `beams` or `half_aperture_rad` is outside these limits.
    """
    if beams < 1 or not 0.0 < half_aperture_rad <= math.pi / 2:
        raise EncodeError(f"no bearing table of {beams} beams over ±{half_aperture_rad} rad")
    if beams == 1:
        return np.zeros(1, dtype=np.int16)
    sines = math.sin(half_aperture_rad) * (2.0 * np.arange(beams) / (beams - 1) - 1.0)
    exact = 100.0 * np.degrees(np.arcsin(np.clip(sines, -1.0, 1.0)))
    return np.trunc(exact + np.copysign(_ROUNDING_GUARD_CDEG, exact)).astype(np.int16)


def edges_rad(bearings_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edges between beams, halfway in sine; the outermost edges are extrapolated.

    Args:
        bearings_rad: float64 (beams,), beams ≥ 1. A single beam gets ±0.5°.

    Returns:
        float64 (beams + 1,), within ±π/2.
    """
    if bearings_rad.size == 1:
        half = math.radians(0.5)
        return np.array([bearings_rad[0] - half, bearings_rad[0] + half])
    sines = np.sin(bearings_rad)
    edges = np.empty(sines.size + 1)
    edges[1:-1] = 0.5 * (sines[:-1] + sines[1:])
    edges[0] = 1.5 * sines[0] - 0.5 * sines[1]
    edges[-1] = 1.5 * sines[-1] - 0.5 * sines[-2]
    return np.arcsin(np.clip(edges, -1.0, 1.0))
