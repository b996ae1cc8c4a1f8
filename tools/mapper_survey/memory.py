"""How large tiles are, by the memory that a worker may take."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapper_survey.errors import SurveyError
from mapper_survey.spool import Rows
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import BLOCK_VOXELS, BRICK_VOXELS

__all__ = [
    "bytes_of",
    "edge_for",
    "edge_within",
    "grid_bytes",
    "ping_bytes",
    "voxel_bytes_of",
]

PROGRAM_BYTES = 300 << 20
"""A worker before it has mapped anything, with one ping, and what Python keeps for itself."""

COPIES = 3
"""Of a tile at the end of its task: the map, its bricks as bytes, and the file's pages."""

VOXEL_BYTES = 3.2
"""Of a voxel that is stored by itself: log-odds of two bytes, a count of one, and its part of what
the map needs beside them. Tiles are chosen by it."""

MAX_VOXEL_BYTES = 4
"""The same under a rule that counts beyond 255, without what is beside: pings are bounded by it."""

EVIDENCE_BYTES = {"evidence_grid": 0, "rays": 176}
"""Of a voxel that a ping changes, as long as it is integrated: a sample with its place in a table
in rays.cpp. The evidence grid has no list of voxels, see `grid_bytes`."""

BLOCK_BYTES = 1024
"""Of a block that a ping changes, beside its voxels."""

ROW_PITCH, COLUMN_PITCH = 0.27, 0.5
"""Of the evidence grid, in voxels, at `detail` 1: the finest between rows, the widest between
columns at the largest range (evidence_grid.cpp)."""

GRID_POINT_BYTES = 1.2
"""Of a point of the grid: its code, and its part of the tiles' classes."""

DEEP_M = 3.5
"""How thick a layer is taken to be observed, where tiles are chosen: 2.4 m were on a seabed of sand
waves and wrecks, free water with them. Many small tiles cost, as each ping is read for several."""

MAX_EDGE = 32

UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 1 << 10, "mi": 1 << 20, "gi": 1 << 30}


def bytes_of(text: str) -> int:
    """`2GB`, `1500 MiB` or a number of bytes.

    Raises:
        SurveyError: the text is not a size.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmg]i?)?b?\s*", text, re.IGNORECASE)
    if found is None:
        raise SurveyError(f"{text!r} is not a size of memory; allowed: such as 2GB or 1500MiB")
    return int(float(found[1]) * UNITS[(found[2] or "").lower()])


def voxel_bytes_of(memory_bytes: int, resolution_m: float) -> int:
    """What the voxels of one tile may take of a worker's memory.

    Raises:
        SurveyError: not even a single brick has room in it.
    """
    brick = int(VOXEL_BYTES * BRICK_VOXELS**3)
    most = (memory_bytes - PROGRAM_BYTES) // COPIES
    if most < 2 * brick:
        least = (PROGRAM_BYTES + 2 * brick * COPIES) >> 20
        raise SurveyError(
            f"{memory_bytes >> 20} MiB a worker are too little for the smallest tile of "
            f"{BRICK_VOXELS * resolution_m:g} m; allowed: {least} MiB or more"
        )
    return most


def edge_for(config: Config, voxel_bytes: int, tile_size_m: float | None) -> int:
    """A tile's edge in bricks, a power of two, so that it can be halved when it proves too large.

    Args:
        config: the settings.
        voxel_bytes: that a tile may take.
        tile_size_m: as asked for; None chooses one where the seabed is likely to fit.
    """
    resolution_m = config.octree.voxel_resolution
    brick_m = BRICK_VOXELS * resolution_m
    if tile_size_m is None:
        voxels = voxel_bytes / VOXEL_BYTES
        tile_size_m = float((voxels * resolution_m**3 / DEEP_M) ** 0.5)
    edge = 1
    while edge < MAX_EDGE and 2 * edge * brick_m <= tile_size_m:
        edge *= 2
    return edge


def edge_within(edge: int, dives: Sequence[Rows], config: Config, voxel_bytes: int) -> int:
    """The same edge, or a smaller one: no ping alone may bring more into a tile than has room.

    Memory is looked at after each ping. Up to then a tile may have grown from its bound by what the
    ping brings; the copies that it is written with are not there yet.

    Args:
        edge: of a tile, in bricks, a power of two.
        dives: rows of each.
        config: the settings.
        voxel_bytes: that a tile may take.
    """
    room = (COPIES - 1) * voxel_bytes
    extents = [rows["last"].astype(np.int64) - rows["first"] + 1 for rows in dives]
    while edge > 1 and any(ping_bytes(extent, edge, config) > room for extent in extents):
        edge //= 2
    return edge


def ping_bytes(extents: NDArray[np.int64], edge: int, config: Config) -> int:
    """The most that one of some pings may take in one tile, in the map and while it is integrated.

    Args:
        extents: (N, 3) of the boxes that the pings may change, in blocks.
        edge: of a tile, in bricks.
        config: the settings.
    """
    within = np.clip(extents, 0, edge * BRICK_VOXELS // BLOCK_VOXELS)
    voxel_bytes = MAX_VOXEL_BYTES + EVIDENCE_BYTES[config.mapping.integrator]
    blocks = int(within.prod(axis=1).max(initial=0))
    return blocks * (voxel_bytes * BLOCK_VOXELS**3 + BLOCK_BYTES) + grid_bytes(extents, config)


def grid_bytes(extents: NDArray[np.int64], config: Config) -> int:
    """The most that the evidence grid of one of some pings takes while it is integrated.

    A ping's grid is that of the whole ping, however small the tile. At 30 m, in voxels of 5 cm, it
    takes some 6 MB. Its range and width are not known here: the box's diagonal and half a turn
    bound them, so that this is a few times as much.

    Args:
        extents: (N, 3) of the boxes that the pings may change, in blocks.
        config: the settings.
    """
    if config.mapping.integrator != "evidence_grid":
        return 0
    diagonals = np.sqrt(np.square(extents.astype(np.float64)).sum(axis=1))
    reach = BLOCK_VOXELS * float(diagonals.max(initial=0))
    rows = config.mapping.detail * reach / ROW_PITCH
    columns = config.mapping.detail * 2 * reach / COLUMN_PITCH  # sines from -1 to 1
    planes = 2 if config.mapping.aggregation == "mean" else 1
    return int(GRID_POINT_BYTES * planes * rows * columns)
