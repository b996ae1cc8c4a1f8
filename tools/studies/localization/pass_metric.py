"""How far apart two maps of one place are, where both passes were looking."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from sonar_sim import Pose
from sonar_sim.sonar import SonarSettings

__all__ = ["Agreement", "Fans", "agreement", "in_fans", "to_nearest"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Agreement(msgspec.Struct, frozen=True):
    """Of one direction: from the voxels of one map to the nearest of the other; metres."""

    voxels: int
    median_m: float
    p95_m: float
    within_voxel: float
    """Share."""


@dataclass(frozen=True, slots=True, eq=False)
class Fans:
    """What a pass had before its sonar, whatever stood in the way.

    Attributes:
        poses: of the sonar, map frame, at its pings.
        sonar: its aperture and range.
    """

    poses: Sequence[Pose]
    sonar: SonarSettings


def in_fans(points_m: Floats, fans: Fans) -> Mask:
    """(N,) whether points (N, 3) lay in the fan of any ping."""
    sonar, seen = fans.sonar, np.zeros(len(points_m), dtype=np.bool_)
    sine_up = math.sin(sonar.vertical_width_rad / 2)
    sine_aside = math.sin(sonar.half_aperture_rad)
    for pose in fans.poses:
        offset = (points_m - pose.position_m) @ pose.rotation
        range_m = np.linalg.norm(offset, axis=1)
        seen |= (
            (offset[:, 0] > 0.0)
            & (range_m < sonar.range_m)
            & (np.abs(offset[:, 1]) < sine_aside * range_m)
            & (np.abs(offset[:, 2]) < sine_up * range_m)
        )
    return seen


def to_nearest(from_m: Floats, to_m: Floats) -> Floats:
    """(N,) distance of each point to the nearest of the others; infinite where there is none."""
    if len(to_m) == 0:
        return np.full(len(from_m), np.inf)
    distance: Floats = cKDTree(to_m).query(from_m)[0]
    return distance


def agreement(distance_m: Floats, voxel_m: float) -> Agreement:
    """The figures of distances.

    Raises:
        ValueError: there are none.
    """
    if len(distance_m) == 0:
        raise ValueError("no voxel to compare")
    median, p95 = np.quantile(distance_m, (0.5, 0.95))
    # Centres stand on a grid: a hair more than an edge is an edge.
    within = np.mean(distance_m <= voxel_m * (1 + 1e-6))
    return Agreement(len(distance_m), *(round(float(part), 3) for part in (median, p95, within)))
