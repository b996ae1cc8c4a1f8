"""What a click on the map means, and how far two of them are apart."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.viewer.view_voxels import Drawn

__all__ = ["Measuring", "distance_text", "pick"]


def pick(
    drawn: Iterable[Drawn], origin_m: ArrayLike, towards: ArrayLike
) -> NDArray[np.float64] | None:
    """The centre of the first cell that a ray meets, (3,) map frame; None where it meets none.

    Args:
        drawn: the cells.
        origin_m: (3,) where the ray begins, map frame.
        towards: (3,) its direction, of any length.
    """
    origin = np.asarray(origin_m, np.float64)
    direction = np.asarray(towards, np.float64)
    direction = direction / np.linalg.norm(direction)
    best_m, found = np.inf, None
    for part in drawn:
        if len(part) == 0:
            continue
        low = part.origin_m + part.local.min(axis=0) * part.cell_m
        high = part.origin_m + (part.local.max(axis=0) + 1.0) * part.cell_m
        if not _entry_m(low[None], high[None], origin, direction)[0] < best_m:
            continue
        corners = part.origin_m + part.local * part.cell_m
        at_m = _entry_m(corners, corners + part.cell_m, origin, direction)
        first = int(np.argmin(at_m))
        if at_m[first] < best_m:
            best_m, found = at_m[first], corners[first] + part.cell_m / 2
    return found


def _entry_m(
    low_m: NDArray[np.float64],
    high_m: NDArray[np.float64],
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
) -> NDArray[np.float64]:
    """How far along a ray it enters boxes (N, 3), (N,); infinite where it misses them."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (low_m - origin) / direction
        other = (high_m - origin) / direction
    parallel = np.isnan(one) | np.isnan(other)  # along a face: inside this pair of planes
    near = np.where(parallel, -np.inf, np.minimum(one, other)).max(axis=1)
    far = np.where(parallel, np.inf, np.maximum(one, other)).min(axis=1)
    return np.where((near <= far) & (far >= 0), np.maximum(near, 0.0), np.inf)


def distance_text(first_m: ArrayLike, second_m: ArrayLike) -> str:
    """Distance of two points of the map, and its parts along the axes."""
    dx, dy, dz = (float(one) for one in np.subtract(second_m, first_m))
    total = float(np.linalg.norm((dx, dy, dz)))
    return f"{total:.2f} m   dx {dx:+.2f}  dy {dy:+.2f}  dz {dz:+.2f}"


@dataclass(slots=True)
class Measuring:
    """Two points that somebody picks, one after the other; a third begins anew."""

    points_m: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, point_m: NDArray[np.float64]) -> str:
        """Take a point; returns what is to be said."""
        if len(self.points_m) == 2:  # noqa: PLR2004 a distance has two ends
            self.points_m.clear()
        self.points_m.append(point_m)
        if len(self.points_m) == 1:
            x, y, z = point_m
            return f"({x:.2f}, {y:.2f}, {z:.2f}) m; pick the other point"
        return distance_text(*self.points_m)
