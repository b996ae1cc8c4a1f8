"""A scan: what one ping says about where surfaces are."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Scan", "decimated", "decimation"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """The first return of each beam that has one; arrays are read-only.

    The level frame is the base without its roll and pitch: origin in the base, x ahead and level,
    y to port, z up. A return is placed in the middle of the beam's vertical aperture; where in the
    aperture it is, is unknown.

    Attributes:
        stamp_ns: when the sound met the middle of the image, on the clock of the odometry.
        bearing_rad: (N,) float64, increasing, in the sonar's fan, positive to starboard.
        range_m: (N,) float64, slant range from the sonar.
        points_m: (N, 3) float64, level frame.
        quality: (N,) float64, 0..1: how far the return stands out, less where it may be floor.
        beam: (N,) int64, the beams' columns in the ping.
        misses_bearing_rad: (M,) float64 of the beams without a return. They say nothing: a smooth
            surface reflects sound away.
        max_range_m: farther away nothing was looked for.
        level_T_sonar: (4, 4) rigid transform, sonar x along the centre beam, y to port, z up.
    """

    stamp_ns: int
    bearing_rad: Floats
    range_m: Floats
    points_m: Floats
    quality: Floats
    beam: NDArray[np.int64]
    misses_bearing_rad: Floats
    max_range_m: float
    level_T_sonar: Floats  # noqa: N815 frames are named

    def __post_init__(self) -> None:
        """Keep anybody from changing the arrays."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __len__(self) -> int:
        return len(self.range_m)


def decimation(count: int, most: int) -> NDArray[np.int64]:
    """Indices of `most` evenly spaced of `count` things, the first and the last among them.

    Index ceil(k (count - 1) / (most - 1)) for k = 0 .. most - 1; all if there are not more than
    `most`, the first alone for `most` 1.
    """
    if most >= count:
        return np.arange(count, dtype=np.int64)
    if most <= 1:
        return np.zeros(max(most, 0), dtype=np.int64)
    k = np.arange(most, dtype=np.int64)
    return -(-k * (count - 1) // (most - 1))


def decimated(scan: Scan, most: int) -> Scan:
    """A scan of at most so many returns. Beams without a return are gone already: none is wasted.

    Args:
        scan: any.
        most: returns, evenly spaced among those that there are.
    """
    kept = decimation(len(scan), most)
    return dataclasses.replace(
        scan,
        bearing_rad=scan.bearing_rad[kept],
        range_m=scan.range_m[kept],
        points_m=scan.points_m[kept],
        quality=scan.quality[kept],
        beam=scan.beam[kept],
    )
