"""A pose of the odometry as it is in the map."""

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.odom_correction import MapFromOdom
from mapperd.odometry.fusion import FusedPose

__all__ = ["placed"]

Floats = NDArray[np.float64]

PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
"""x, y and the turn about z, of a pose's six."""


def placed(odom: FusedPose, correction: MapFromOdom, estimate: PlanarGaussian) -> FusedPose:
    """Correct a pose with all that belongs to it.

    Velocity and covariance turn with the frame; rates are about the base's own axes and stay. The
    covariance of what the estimate knows is the estimate's.

    Args:
        odom: the base in the odometry's frame.
        correction: of that frame.
        estimate: that it was made of.
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
