"""Chooses the size of tiles by the memory of a worker."""

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
"""Memory of a worker without a map: the program, one ping, and Python's own reserve."""

COPIES = 3
"""Copies of a tile at the end of its task: map, encoded bricks, and pages of the file."""

VOXEL_BYTES = 3.2
"""Memory of a voxel: log-odds of two bytes, a count of one, and its share of the map's overhead.
Used to choose tiles."""

MAX_VOXEL_BYTES = 4
"""The same for counts beyond 255, without overhead; used to bound pings."""

EVIDENCE_BYTES = {"evidence_grid": 0, "rays": 176}
"""Temporary memory of a voxel that a ping changes: a sample in a table of rays.cpp. The evidence
grid has no list of voxels, see `grid_bytes`."""

BLOCK_BYTES = 1024
"""Temporary memory of a block that a ping changes, besides its voxels."""

ROW_PITCH, COLUMN_PITCH = 0.27, 0.5
"""Pitch of the evidence grid in voxels at `detail` 1: the finest between rows, the widest between
columns at the largest range (evidence_grid.cpp)."""

GRID_POINT_BYTES = 1.2
"""Memory of a point of the grid: its code, and its share of the tiles' classes."""

DEEP_M = 3.5
"""Assumed thickness of the observed layer for the choice of tiles; it was 2.4 m, with free water,
on a seabed of sand waves and wrecks. Small tiles cost time: each ping is read for several."""

MAX_EDGE = 32

UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 1 << 10, "mi": 1 << 20, "gi": 1 << 30}


def bytes_of(text: str) -> int:
    """Parse `2GB`, `1500 MiB` or a number of bytes.

    Raises:
        SurveyError: the text is not a size.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmg]i?)?b?\s*", text, re.IGNORECASE)
    if found is None:
        raise SurveyError(f"{text!r} is not a size of memory; allowed: such as 2GB or 1500MiB")
    return int(float(found[1]) * UNITS[(found[2] or "").lower()])


def voxel_bytes_of(memory_bytes: int, resolution_m: float) -> int:
    """Return the memory for the voxels of one tile in a worker.

    Raises:
        SurveyError: it is too small for a single brick.
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
    """Return a tile's edge in bricks, a power of two, so that it can be halved if too large.

    Args:
        config: the settings.
        voxel_bytes: memory for the voxels of a tile.
        tile_size_m: requested size; None chooses one that a seabed probably fits in.
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
    """Return the edge, reduced if a single ping would exceed the memory of a tile.

    Memory is checked after each ping, so a tile can exceed its limit by one ping; the copies for
    writing do not exist at that time.

    Args:
        edge: edge of a tile in bricks, a power of two.
        dives: rows of each dive.
        config: the settings.
        voxel_bytes: memory for the voxels of a tile.
    """
    room = (COPIES - 1) * voxel_bytes
    extents = [rows["last"].astype(np.int64) - rows["first"] + 1 for rows in dives]
    while edge > 1 and any(ping_bytes(extent, edge, config) > room for extent in extents):
        edge //= 2
    return edge


def ping_bytes(extents: NDArray[np.int64], edge: int, config: Config) -> int:
    """Return the maximum memory of one of some pings in a tile, during its integration.

    Args:
        extents: (N, 3) sizes of the boxes that the pings may change, in blocks.
        edge: edge of a tile, in bricks.
        config: the settings.
    """
    within = np.clip(extents, 0, edge * BRICK_VOXELS // BLOCK_VOXELS)
    voxel_bytes = MAX_VOXEL_BYTES + EVIDENCE_BYTES[config.mapping.integrator]
    blocks = int(within.prod(axis=1).max(initial=0))
    return blocks * (voxel_bytes * BLOCK_VOXELS**3 + BLOCK_BYTES) + grid_bytes(extents, config)


def grid_bytes(extents: NDArray[np.int64], config: Config) -> int:
    """Return the maximum memory of the evidence grid of one of some pings.

    The grid covers the whole ping, however small the tile: some 6 MB at 30 m with voxels of 5 cm.
    Range and width are unknown here and bounded by the box's diagonal and half a turn, so the
    result is a few times too large.

    Args:
        extents: (N, 3) sizes of the boxes that the pings may change, in blocks.
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
