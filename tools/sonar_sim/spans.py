"""How far a face's plane stands for the surface about a hit.

A ray's cell may reach far beyond the face that it met: over a floor of small triangles at grazing
incidence it has to, around a ball it must not. What the neighbouring rays met on the same surface
tells one from the other.
"""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.fan import Fan
from sonar_sim.meshes import Meshes, Met


def spans(meshes: Meshes, fan: Fan, met: Met) -> NDArray[np.float32]:
    """Ranges between which each hit's plane is followed, (N, 2)."""
    surface = np.where(met.face >= 0, meshes.surface[met.face], -3)
    range_m = np.where(met.face >= 0, met.range_m, np.float32(0.0))
    low, high = range_m.copy(), range_m.copy()
    _widen(low, high, range_m, surface, fan.column)
    across = _across(fan)
    if across is not None:
        _from_beside(low, high, range_m, surface, across)
    return span_about(meshes, met, low, high)


def span_about(
    meshes: Meshes, met: Met, low_m: NDArray[np.float32], high_m: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Widened by the face's own size, (N, 2)."""
    size = meshes.size_m[met.face]
    range_m = np.where(met.face >= 0, met.range_m, np.float32(0.0))
    near = np.maximum(np.minimum(low_m, range_m - size), np.float32(0.0))
    return np.stack([near, np.maximum(high_m, range_m + size)], axis=1).astype(np.float32)


def _widen(
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    range_m: NDArray[np.float32],
    surface: NDArray[np.int32],
    column: NDArray[np.int32],
) -> None:
    """Take in the neighbours up and down the column."""
    same = (surface[1:] == surface[:-1]) & (column[1:] == column[:-1])
    after = np.where(same, range_m[1:], range_m[:-1])
    before = np.where(same, range_m[:-1], range_m[1:])
    np.minimum(low[:-1], after, out=low[:-1])
    np.maximum(high[:-1], after, out=high[:-1])
    np.minimum(low[1:], before, out=low[1:])
    np.maximum(high[1:], before, out=high[1:])


def _across(fan: Fan) -> NDArray[np.int64] | None:
    """Each ray's neighbour in the next column, or the ray itself, (N,)."""
    count = len(fan.column)
    if count == 0:
        return None
    # Rays are ordered by column and by w: the next column's ray at or above the same w.
    place = 4.0 * fan.column.astype(np.float64) + fan.directions[:, 2]
    found = np.minimum(np.searchsorted(place, place + 4.0 - 1e-6), count - 1)
    beside: NDArray[np.int64] = np.where(
        fan.column[found] == fan.column + 1, found, np.arange(count)
    )
    return beside


def _from_beside(
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    range_m: NDArray[np.float32],
    surface: NDArray[np.int32],
    beside: NDArray[np.int64],
) -> None:
    """Take in the neighbours in the next column and, the other way, in the one before."""
    same = np.flatnonzero(surface[beside] == surface)
    other = beside[same]
    low[same] = np.minimum(low[same], range_m[other])
    high[same] = np.maximum(high[same], range_m[other])
    np.minimum.at(low, other, range_m[same])
    np.maximum.at(high, other, range_m[same])
