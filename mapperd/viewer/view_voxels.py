"""What of a chunk of the map is drawn."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.client.mirror import MapMirror
from mapperd.viewer.chunks import Chunk, Chunks

__all__ = ["Drawn", "Filter", "coarser", "drawn_of", "faces_shown", "points_m"]


@dataclass(frozen=True, slots=True)
class Filter:
    """Which cells are drawn.

    Attributes:
        min_probability: of being occupied; None takes the daemon's threshold.
        low_m, high_m: of z, between which their centres lie.
    """

    min_probability: float | None = None
    low_m: float = -np.inf
    high_m: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """The cells of a chunk that can be seen.

    Attributes:
        origin_m: (3,) where the chunk begins, map frame.
        cell_m: edge of a cell.
        local: (N, 3) int16, which of the chunk's cells.
        normals: (N, 3) float32, unit vectors out of what they are part of; 0 where it is on all
            sides alike.
        probability: (N,) float32.
        count: (N,) uint16.
        changed_ns: (N,) int64.
    """

    origin_m: NDArray[np.float64]
    cell_m: float
    local: NDArray[np.int16]
    normals: NDArray[np.float32]
    probability: NDArray[np.float32]
    count: NDArray[np.uint16]
    changed_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.local)


def drawn_of(mirror: MapMirror, chunks: Chunks, chunk: Chunk, chosen: Filter) -> Drawn:
    """The cells of a chunk that pass a filter and are not hidden by others on all six sides."""
    cell_m, edge = mirror.cell_m, chunks.edge
    cells = mirror.cells(
        "occupied", min_probability=chosen.min_probability, keys=chunks.blocks_of(chunk)
    )
    z_m = cells.centres_m[:, 2]
    passed = (z_m >= chosen.low_m) & (z_m <= chosen.high_m)
    index = np.floor(cells.centres_m / cell_m).astype(np.int64) - np.asarray(chunk) * edge
    near = ((index >= -1) & (index <= edge)).all(axis=1) & passed
    filled = np.zeros((edge + 2,) * 3, np.bool_)
    filled[tuple((index[near] + 1).T)] = True
    inside = near & ((index >= 0) & (index < edge)).all(axis=1)
    at = np.flatnonzero(inside)
    shown, normals = faces_shown(filled, index[at] + 1)
    at = at[shown]
    return Drawn(
        np.asarray(chunk) * (edge * cell_m),
        cell_m,
        index[at].astype(np.int16),
        normals[shown],
        cells.probability[at],
        cells.count[at],
        cells.changed_ns[at],
    )


def faces_shown(
    filled: NDArray[np.bool_], index: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Whether cells have a free side, and where it is free.

    Args:
        filled: (E, E, E) cells that are drawn.
        index: (N, 3) cells in question, none of them at the border.

    Returns:
        (N,) and (N, 3): unit vectors to the free sides.
    """
    normals = np.zeros((len(index), 3), np.float32)
    shown = np.zeros(len(index), np.bool_)
    for axis in range(3):
        for step in (-1, 1):
            beside = index.copy()
            beside[:, axis] += step
            free = ~filled[tuple(beside.T)]
            shown |= free
            normals[:, axis] += step * free
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return shown, normals / np.maximum(length, 1)


def coarser(drawn: Drawn, factor: int) -> Drawn:
    """Cubes of factor**3 cells instead of cells; each has the values of one cell in it."""
    if factor == 1:
        return drawn
    local, first = np.unique(drawn.local // factor, axis=0, return_index=True)
    return Drawn(
        drawn.origin_m,
        drawn.cell_m * factor,
        local,
        drawn.normals[first],
        drawn.probability[first],
        drawn.count[first],
        drawn.changed_ns[first],
    )


def points_m(drawn: Drawn) -> NDArray[np.float64]:
    """Centres of the cells, (N, 3), map frame."""
    return drawn.origin_m + (drawn.local + 0.5) * drawn.cell_m
