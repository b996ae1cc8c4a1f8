"""Legs of the sound's way: where it leaves and where it is heard, as the kernels want them."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.geometry.pose import Pose

LEG = 16
"""Numbers of a leg: origin (3), rotation (9), drift (3), gain (1)."""


def leg_in(
    map_T_object: Pose,  # noqa: N803
    origin_m: NDArray[np.float64],
    rotation: NDArray[np.float64],
    drift_m: NDArray[np.float64] | None = None,
    gain: float = 1.0,
) -> NDArray[np.float64]:
    """A leg of the map in an object's frame, (16,).

    Args:
        map_T_object: the object.
        origin_m: of the leg, map frame, (3,).
        rotation: map from sonar; may mirror, (3, 3).
        drift_m: growth of the apparent range per unit of direction, map frame, (3,).
        gain: of pressure.
    """
    back = map_T_object.rotation.T
    drift = np.zeros(3) if drift_m is None else back @ drift_m
    origin = back @ (origin_m - map_T_object.position_m)
    return np.concatenate([origin, (back @ rotation).ravel(), drift, [gain]])
