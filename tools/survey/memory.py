"""How large tiles are, by the memory that a worker may take."""

import re

from mapperd.config import Config
from mapperd.mapping import BRICK_VOXELS
from survey.errors import SurveyError

__all__ = ["bytes_of", "edge_for", "voxel_bytes_of"]

PROGRAM_BYTES = 300 << 20
"""A worker before it has mapped anything, with one ping, and what Python keeps for itself."""

COPIES = 3
"""Of a tile at the end of its task: the map, its bricks as bytes, and the file's pages."""

VOXEL_BYTES = 6
"""Of an observed voxel in memory."""

DEEP_M = 10.0
"""How thick the seabed and what stands on it are taken to be, where tiles are chosen."""

MOST_EDGE = 32

UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 1 << 10, "mi": 1 << 20, "gi": 1 << 30}


def bytes_of(text: str) -> int:
    """`2GB`, `1500 MiB` or a number of bytes.

    Raises:
        SurveyError: it is none.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmg]i?)?b?\s*", text, re.IGNORECASE)
    if found is None:
        raise SurveyError(f"{text!r} is no size of memory; allowed: such as 2GB or 1500MiB")
    return int(float(found[1]) * UNITS[(found[2] or "").lower()])


def voxel_bytes_of(memory_bytes: int, resolution_m: float) -> int:
    """What the voxels of one tile may take of a worker's memory.

    Raises:
        SurveyError: not even a single brick has room in it.
    """
    brick = VOXEL_BYTES * BRICK_VOXELS**3
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
    while edge < MOST_EDGE and 2 * edge * brick_m <= tile_size_m:
        edge *= 2
    return edge
