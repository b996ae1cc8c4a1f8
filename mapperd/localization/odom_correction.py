"""The odometry's frame in the map, and poses corrected by it.

The filter estimates the vehicle's position and heading on the map. Depth, roll and pitch come from
the sensors and stay. The correction is therefore a shift in x and y and a turn about z:

    map_T_odom = map_T_base * inverse(odom_T_base)

with height, roll and pitch of the base taken from the odometry.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.frames import Pose, quaternion_product
from mapperd.geometry.gaussian import PlanarGaussian, wrapped
from mapperd.localization.scan import yaw_of
from mapperd.odometry.fusion import FusedPose

__all__ = ["MapFromOdom", "map_from_odom", "placed"]

Floats = NDArray[np.float64]

NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class MapFromOdom:
    """Pose of the odometry's frame in the map: level, at height 0.

    Attributes:
        stamp_ns: time until which it is valid: that of the scan plus the tolerance.
        x_m, y_m: origin of the odometry's frame, map frame.
        yaw_rad: from the odometry's x to the map's, -pi to pi.
    """

    stamp_ns: int
    x_m: float
    y_m: float
    yaw_rad: float

    @property
    def map_T_odom(self) -> Floats:  # noqa: N802 frames are named
        """(4, 4) rigid transform from odometry to map coordinates."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        transform = np.eye(4)
        transform[:2, :2] = [[c, -s], [s, c]]
        transform[:2, 3] = self.x_m, self.y_m
        return transform

    @property
    def map_q_odom(self) -> Floats:
        """Unit quaternion (w, x, y, z) of the rotation."""
        half = self.yaw_rad / 2
        return np.array([math.cos(half), 0.0, 0.0, math.sin(half)])

    def corrected(self, odom: Pose) -> Pose:
        """Return a pose of the odometry in the map; height, roll and pitch stay."""
        placed = self.map_T_odom @ np.append(odom.position_m, 1.0)
        quaternion = quaternion_product(self.map_q_odom, odom.map_q_base)
        return Pose(placed[:3], quaternion / np.linalg.norm(quaternion))


def map_from_odom(
    estimate: PlanarGaussian, odom: Pose, stamp_ns: int, tolerance_s: float
) -> MapFromOdom:
    """Return the transform that moves the odometry's pose to the estimate.

    Args:
        estimate: pose of the base in the map.
        odom: pose of the base in the odometry's frame at the same time.
        stamp_ns: that time.
        tolerance_s: how far ahead the transform is stamped.
    """
    yaw = wrapped(estimate.yaw_rad - yaw_of(odom.map_q_base))
    c, s = math.cos(yaw), math.sin(yaw)
    x, y = (float(part) for part in odom.position_m[:2])
    return MapFromOdom(
        stamp_ns + round(tolerance_s * NS_PER_S),
        estimate.x_m - (c * x - s * y),
        estimate.y_m - (s * x + c * y),
        yaw,
    )


PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
"""Indices of x, y and the turn about z in a pose's covariance."""


def placed(odom: FusedPose, correction: MapFromOdom, estimate: PlanarGaussian) -> FusedPose:
    """Correct a pose, its velocity and its covariance.

    Velocity and covariance rotate with the frame; rates are about the axes of the base and stay.
    The covariance of x, y and heading is that of the estimate.

    Args:
        odom: pose of the base in the odometry's frame.
        correction: pose of that frame in the map.
        estimate: from which the correction was computed.
    """
    turn = correction.map_T_odom[:3, :3]
    velocity = None if odom.velocity_mps is None else turn @ odom.velocity_mps
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = turn
    covariance: Floats = both @ odom.covariance @ both.T
    covariance[[0, 1, 5], :] = covariance[:, [0, 1, 5]] = 0.0
    covariance[PLANAR] = estimate.covariance
    return FusedPose(
        correction.corrected(odom.pose),
        velocity,
        odom.rate_radps,
        covariance,
        odom.segment,
        odom.reckoned_s,
    )
