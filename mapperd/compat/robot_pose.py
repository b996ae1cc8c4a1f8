"""A pose as the library's callers give it: a position and a quaternion [qx, qy, qz, qw]."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.errors import MapError
from mapperd.geometry.frames import rigid_transform

__all__ = ["robot_pose"]

LENGTH_TOLERANCE = 1e-3
"""Quaternions come with rounding errors; one further from unit length is a mistake."""


def robot_pose(position: ArrayLike, orientation: ArrayLike) -> NDArray[np.float64]:
    """Transform (4, 4) of a robot; the quaternion is brought to length 1.

    Args:
        position: (3,) metres.
        orientation: (4,) [qx, qy, qz, qw], of unit length within a thousandth.

    Raises:
        MapError: these are no position and no unit quaternion.
    """
    try:
        place = np.asarray(position, dtype=np.float64)
        turn = np.asarray(orientation, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MapError(f"a pose is made of numbers: {error}", "bad_pose") from error
    if place.shape != (3,) or turn.shape != (4,):
        raise MapError("a pose is a position of 3 and a quaternion of 4 numbers", "bad_pose")
    length = float(np.linalg.norm(turn))
    if not (np.isfinite(place).all() and abs(length - 1) <= LENGTH_TOLERANCE):
        raise MapError("a pose is a finite position and a unit quaternion", "bad_pose")
    x, y, z, w = turn / length
    return rigid_transform(place, (w, x, y, z))
