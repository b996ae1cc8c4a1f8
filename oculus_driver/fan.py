"""A sonar's fan: bearing tables, and the geometry of a fan image.

Bearing tables are hundredths of a degree on the wire, uniform in sine. In images, ahead is up and
starboard is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
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


@dataclass(frozen=True, slots=True, eq=False)
class FanGeometry:
    """A fan inside a frame.

    Attributes:
        width_px, height_px: of the frame.
        apex_px: position of the sonar, (x, y), x to the right and y down.
        metres_per_px: of range.
        row_share: float32 (height_px, width_px), range divided by the maximum range, 0 to 1.
        beam: float32 (height_px, width_px), index in the bearing table, fractional between beams.
        outside: bool (height_px, width_px), True outside the field of view.
    """

    width_px: int
    height_px: int
    apex_px: tuple[float, float]
    metres_per_px: float
    row_share: NDArray[np.float32] = field(repr=False)
    beam: NDArray[np.float32] = field(repr=False)
    outside: NDArray[np.bool_] = field(repr=False)

    def pixel(self, range_m: float, bearing_rad: float) -> tuple[float, float]:
        """Return the pixel (x, y) of a target."""
        away_px = range_m / self.metres_per_px
        x, y = self.apex_px
        return x + away_px * float(np.sin(bearing_rad)), y - away_px * float(np.cos(bearing_rad))


def fit_fan(
    bearings_rad: NDArray[np.float64],
    max_range_m: float,
    size_px: tuple[int, int],
    margins_px: tuple[int, int, int, int],
) -> FanGeometry:
    """Return the largest fan that fits between the margins.

    Args:
        bearings_rad: float64 (beams,), strictly increasing, within ±π/2; not uniform in angle.
        max_range_m: maximum range of the image.
        size_px: width and height of the frame.
        margins_px: left, top, right and bottom, kept free for labels.
    """
    width_px, height_px = size_px
    left, top, right, bottom = margins_px
    edges = edges_rad(bearings_rad)
    half_m = max_range_m * max(abs(float(np.sin(edges[0]))), abs(float(np.sin(edges[-1]))), 1e-3)
    metres_per_px = max(
        max_range_m / max(1, height_px - top - bottom),
        2.0 * half_m / max(1, width_px - left - right),
    )
    apex_px = (0.5 * (left + width_px - right), float(height_px - bottom))
    across_m = (np.arange(width_px) + 0.5 - apex_px[0]) * metres_per_px
    ahead_m = (apex_px[1] - np.arange(height_px) - 0.5) * metres_per_px
    share = np.hypot(across_m[np.newaxis, :], ahead_m[:, np.newaxis]) / max_range_m
    bearing = np.arctan2(across_m[np.newaxis, :], ahead_m[:, np.newaxis])
    positions = np.interp(np.sin(bearing), np.sin(bearings_rad), np.arange(bearings_rad.size))
    outside = (share > 1.0) | (bearing < edges[0]) | (bearing > edges[-1])
    return FanGeometry(
        width_px,
        height_px,
        apex_px,
        metres_per_px,
        share.astype(np.float32),
        positions.astype(np.float32),
        outside,
    )


_MAX_RINGS: Final = 6
_SLACK: Final = 2e-3
"""Images end slightly before the requested range: 1.998 m get a ring at 2 m."""


def ring_ranges_m(max_range_m: float) -> list[float]:
    """Return at most six ranges, multiples of 1, 2 or 5 times a power of ten."""
    step = 10.0 ** math.floor(math.log10(max_range_m / _MAX_RINGS))
    factor = next(f for f in (1, 2, 5, 10, 20) if max_range_m / (f * step) <= _MAX_RINGS + 1e-9)
    step *= factor
    count = math.floor(max_range_m / step * (1.0 + _SLACK))
    return [round(step * index, 9) for index in range(1, count + 1)]
