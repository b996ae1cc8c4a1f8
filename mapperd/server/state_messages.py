"""Where the vehicle is and what its sonar looks at, as messages."""

import math

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.geometry.frames import Pose as Place
from mapperd.geometry.frames import pose_from_rpy, quaternion_product, quaternion_to_matrix
from mapperd.imaging.ping_image import beams_in_view
from mapperd.localization.status import LocalizationFacts
from mapperd.wire.messages import Fan, Pose
from oculus_driver.ping import Ping

__all__ = ["Mounting", "fan_message", "localized_covariance", "pose_message"]

Floats = NDArray[np.float64]

FINE_RAD, FINE_M = 1e-4, 1e-3
"""What a fan is rounded to: the speed of sound makes its range tremble."""


class Mounting:
    """Where the sonar sits on the base.

    Args:
        config: says it.
    """

    def __init__(self, config: Config) -> None:
        place, turn = config.mounting.position, config.mounting.orientation
        self._base = pose_from_rpy((place.x, place.y, place.z), (turn.roll, turn.pitch, turn.yaw))

    def of_sonar(self, base: Place) -> Place:
        """The sonar where the base is; both in the map's frame."""
        offset = quaternion_to_matrix(base.map_q_base) @ self._base.position_m
        turn = quaternion_product(base.map_q_base, self._base.map_q_base)
        return Place(base.position_m + offset, turn / np.linalg.norm(turn))


def pose_message(
    base: Place,
    sonar: Place,
    *,
    stamp_ns: int,
    source: str,
    velocity_mps: Floats | None = None,
    covariance: Floats | None = None,
) -> Pose:
    """As `Pose` says; what is not finite is not told."""
    return Pose(
        stamp_ns=max(stamp_ns, 0),
        position_m=_three(base.position_m),
        orientation_xyzw=_xyzw(base.map_q_base),
        velocity_mps=None if velocity_mps is None else _three(velocity_mps),
        covariance=_finite(covariance),
        sonar_position_m=_three(sonar.position_m),
        sonar_orientation_xyzw=_xyzw(sonar.map_q_base),
        source=source,
    )


def localized_covariance(facts: LocalizationFacts) -> Floats | None:
    """(6, 6) of the estimate: what it does not know, height, roll and pitch, is the odometry's."""
    if facts.belief is None:
        return None
    covariance = np.zeros((6, 6))
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = facts.belief.best.covariance
    return covariance


def fan_message(ping: Ping, config: Config) -> Fan | None:
    """What a ping looks at; None where its bearings are no fan."""
    try:
        view = beams_in_view(ping.bearings_rad, config.sonar)
    except MapError:
        return None
    first, last = ping.bearings_rad[view][[0, -1]].tolist()
    return Fan(
        bearings_rad=(_rounded(first, FINE_RAD), _rounded(last, FINE_RAD)),
        vertical_aperture_rad=math.radians(config.sonar.vertical_aperture),
        min_range_m=min(config.filtering.min_range, ping.max_range_m),
        max_range_m=_rounded(ping.max_range_m, FINE_M),
    )


def _rounded(value: float, step: float) -> float:
    return round(value / step) * step


def _three(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _xyzw(quaternion: Floats) -> tuple[float, float, float, float]:
    w, x, y, z = quaternion.tolist()
    return x, y, z, w


def _finite(covariance: Floats | None) -> tuple[float, ...] | None:
    if covariance is None or not np.isfinite(covariance).all():
        return None
    return tuple(covariance.ravel().tolist())
