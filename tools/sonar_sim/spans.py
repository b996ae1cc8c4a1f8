"""How far a face's plane stands for the surface about a hit.

A ray's cell may reach far beyond the face that it met: over a floor of small triangles at grazing
incidence it has to, around a ball it must not. What the neighbouring rays met on the same surface
tells one from the other.
"""

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.raycast.fan import Fan
from sonar_sim.raycast.meshes import Meshes, Met


def spans(meshes: Meshes, fan: Fan, met: Met) -> NDArray[np.float32]:
    """Ranges between which each hit's plane is followed, (N, 2)."""
    up = np.ascontiguousarray(fan.directions[:, 2])
    return _core.spans(met.range_m, met.face, fan.column, up, meshes.surface, meshes.size_m)


def span_about(
    meshes: Meshes, met: Met, low_m: NDArray[np.float32], high_m: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Widened by the face's own size, (N, 2)."""
    size = meshes.size_m[met.face]
    range_m = np.where(met.face >= 0, met.range_m, np.float32(0.0))
    near = np.maximum(np.minimum(low_m, range_m - size), np.float32(0.0))
    return np.stack([near, np.maximum(high_m, range_m + size)], axis=1).astype(np.float32)
