"""The visible surface: the parts of the scene in the sonar's field of view during a survey.

A point belongs to it if in at least one ping a ray of the fan met it first: inside the -3 dB
apertures (elevation ±half the vertical width, bearing ±half the fan), within the sonar's range, not
hidden behind something nearer. How loud its echo was plays no part: a patch seen at so grazing an
angle that nothing came back counts as seen.
"""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.raycast.tracing import Trace
from sonar_sim.scene.sonar import SonarSettings

CELL_M = 0.05
"""At most one point a cell of this edge is kept: the points stand for about equal areas."""
PINGS_PER_MERGE = 16
KEY_OFFSET = 1 << 20
"""Makes indices positive; 20 bits of 5 cm cells reach 52 km either way."""


class VisibleSurface:
    """Collects points, one a cell, the first that came."""

    def __init__(self) -> None:
        self._keys = np.empty(0, dtype=np.int64)
        self._points = np.empty((0, 3))
        self._new: list[NDArray[np.float64]] = []

    def add(self, points_m: NDArray[np.float64]) -> None:
        """Take in the points (N, 3) that one ping saw."""
        self._new.append(points_m)
        if len(self._new) >= PINGS_PER_MERGE:
            self._merge()

    @property
    def points_m(self) -> NDArray[np.float64]:
        """All points, (N, 3), sorted by cell."""
        self._merge()
        return self._points

    def _merge(self) -> None:
        points = np.concatenate([self._points, *self._new])
        keys = np.concatenate([self._keys, *(_cell_keys(new) for new in self._new)])
        # np.unique names the first of equal keys: what was there before stays.
        self._keys, first = np.unique(keys, return_index=True)
        self._points = points[first]
        self._new.clear()

    def save(self, path: Path) -> None:
        """Write `points_m` as a NumPy archive."""
        np.savez_compressed(path, points_m=self.points_m)


def _cell_keys(points_m: NDArray[np.float64]) -> NDArray[np.int64]:
    cells = np.floor(points_m / CELL_M).astype(np.int64) + KEY_OFFSET
    keys: NDArray[np.int64] = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return keys


def visible_points(rays: Trace, sonar: SonarSettings) -> NDArray[np.float64]:
    """First hits inside the -3 dB aperture, map frame, whether or not their echo can be heard."""
    met = rays.met[0]
    return _core.visible_points(
        rays.fan.directions,
        rays.direction,
        met.face,
        met.range_m,
        rays.origin_m,
        sonar.range_m,
        math.sin(sonar.half_aperture_rad),
        math.sin(sonar.vertical_width_rad / 2.0),
    )
