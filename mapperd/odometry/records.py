"""What an odometry source says, in our conventions."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["UNKNOWN_VARIANCE", "Clock", "GeoPoint", "Odometry"]

Clock = Literal["unix", "boot", "arrival"]
Floats = NDArray[np.float64]

UNKNOWN_VARIANCE = 1e6
"""m², rad², (m/s)² or (rad/s)²: stands in a covariance for a part the sender does not know."""


@dataclass(frozen=True, slots=True)
class GeoPoint:
    """A place on the WGS-84 ellipsoid.

    Attributes:
        latitude_rad: north positive.
        longitude_rad: east positive.
        altitude_m: above mean sea level; None where the sender does not say.
    """

    latitude_rad: float
    longitude_rad: float
    altitude_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """One record; map frame ENU, base frame FLU, SI units. None is unknown, which is not zero.

    Attributes:
        stamp_ns: when it was so, on the clock that `clock` names; 0 for "arrival".
        clock: "unix", "boot" (some zero of the sender's), or "arrival" (has no clock).
        position_m: (3,) base in map.
        map_q_base: (4,) unit quaternion (w, x, y, z).
        velocity_mps: (3,) of the base, in base axes, over ground.
        rate_radps: (3,) of the base, about base axes.
        pose_covariance: (6, 6), x y z in map axes then rotations about map axes; m and rad.
        twist_covariance: (6, 6), as velocity and rate, in base axes.
        reset_count: changes when the source's estimate jumped.
        source: the sender's name.
        velocity_map_mps: (3,) of the base over ground, in map axes.
        velocity_east_north_mps: (2,) over ground, where the vertical part is not known.
        depth_m: below the surface, positive down, from pressure.
        geo: where the base is on Earth.
        heading_rad: the base's forward axis from east, counter-clockwise, without the other angles.
        altitude_m: above the bottom.
        confidence: the sender's own, 0 (none) to 1.
        valid: False where the sender itself says that it has lost track. Such a record holds a
            time and breaks dead reckoning.
        sent_ns: when the record left, on the same clock; None where stamp_ns is all there is.
            The clock is fitted with it: arrival minus this is the delay of the link alone.
        specific_force_mps2: (3,) what an accelerometer measures, base axes: (0, 0, 9.8) when level.
        north_referenced: False where the horizontal axes of the sender's world have an arbitrary
            heading: its positions and orientations do not mix with compass headings.
    """

    stamp_ns: int
    clock: Clock
    position_m: Floats | None = None
    map_q_base: Floats | None = None
    velocity_mps: Floats | None = None
    rate_radps: Floats | None = None
    pose_covariance: Floats | None = None
    twist_covariance: Floats | None = None
    reset_count: int = 0
    source: str = ""
    velocity_map_mps: Floats | None = None
    velocity_east_north_mps: Floats | None = None
    depth_m: float | None = None
    geo: GeoPoint | None = None
    heading_rad: float | None = None
    altitude_m: float | None = None
    confidence: float | None = None
    valid: bool = True
    sent_ns: int | None = None
    north_referenced: bool = True
    specific_force_mps2: Floats | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for name in _ARRAYS:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


_ARRAYS = (
    "position_m",
    "map_q_base",
    "velocity_mps",
    "rate_radps",
    "pose_covariance",
    "twist_covariance",
    "velocity_map_mps",
    "velocity_east_north_mps",
    "specific_force_mps2",
)
