"""Map files of known voxels."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config, OctreeConfig
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.tile_store import TileStore

RESOLUTION_M = 0.1
CONFIG = Config(octree=OctreeConfig(voxel_resolution=RESOLUTION_M))

Ints = NDArray[np.int64]


def centres(index: Ints) -> NDArray[np.float64]:
    return np.asarray((index + 0.5) * RESOLUTION_M)


def map_of(
    occupied: Ints, log_odds: NDArray[np.float64] | float = 3.0, free: Ints | None = None
) -> SonarMap:
    """A map of voxels given by their indices (N, 3)."""
    sonar_map = SonarMap(CONFIG)
    values = np.broadcast_to(np.asarray(log_odds, dtype=np.float64), len(occupied)).copy()
    if free is not None and len(free):
        sonar_map.core.set_log_odds(centres(free), np.full(len(free), -2.0))
    if len(occupied):
        sonar_map.core.set_log_odds(centres(occupied), values)
    return sonar_map


def store_of(path: Path, sonar_map: SonarMap) -> Path:
    """Put a map that is in memory into a file."""
    _, bricks = sonar_map.core.bricks_since(0)
    empty = SonarMap(sonar_map.config)
    with TileStore(path, empty, tile_size_m=6.4, cache_tiles=1) as store:
        store.restore([(key, brick) for key, _, brick in bricks], whole=True)
    return path


def seabed(random: np.random.Generator, west: int = -300, east: int = 300) -> SonarMap:
    """A rough slope across many bricks: layers with gaps, holes, and a deck above a part."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(west, east, 3), np.arange(-80, 90, 5)))
    top = np.floor(-100 + 0.1 * x + 4 * np.sin(0.05 * y)).astype(np.int64)
    columns = np.stack([x, y, top], axis=1)[random.random(len(x)) > 0.1]
    layers = [columns - (0, 0, depth) for depth in (0, 1, 2, 5)]
    layers = [layer[random.random(len(layer)) > 0.2 * n] for n, layer in enumerate(layers)]
    deck = columns[(columns[:, 0] > 100) & (columns[:, 0] < 160)] * (1, 1, 0) + (0, 0, 10)
    index = np.unique(np.concatenate([*layers, deck]), axis=0)
    sonar_map = map_of(index, random.uniform(1.0, 6.0, len(index)))
    again = centres(index[random.random(len(index)) < 0.5])
    sonar_map.core.observe(again, np.full(len(again), 200.0), np.full(len(again), fill_value=True))
    return sonar_map
