"""A map that is there before the dive: a seabed around the place, too large to be told at once."""

from pathlib import Path

import numpy as np

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.tile_store import TileStore

__all__ = ["write_far_map"]

NEAREST_M, FURTHEST_M = 30.0, 42.0
DEPTH_M, HEIGHT_M, WAVE_M = -8.0, 1.5, 7.0
WATER_M = 1.2
OCCUPIED, FREE = 3.0, -4.0


def write_far_map(path: Path, config: Config) -> None:
    """Write the file of such a map.

    Args:
        path: that is not there yet.
        config: of the daemon that is to open it.
    """
    sonar_map = SonarMap(config)
    step_m = sonar_map.resolution_m
    axis = np.arange(-FURTHEST_M, FURTHEST_M, step_m) + step_m / 2
    x, y = (each.ravel() for each in np.meshgrid(axis, axis))
    away_m = np.hypot(x, y)
    ring = (away_m > NEAREST_M) & (away_m < FURTHEST_M)
    x, y = x[ring], y[ring]
    dice = np.random.default_rng(1)
    z = DEPTH_M + HEIGHT_M * np.sin(x / WAVE_M) * np.cos(y / WAVE_M)
    for above_m in np.arange(0, WATER_M, step_m):
        points = np.stack([x, y, z + above_m], axis=1)
        middle = FREE if above_m > step_m else OCCUPIED
        sonar_map.core.set_log_odds(points, middle + dice.normal(0, 0.3, len(points)))
    _, bricks = sonar_map.core.bricks_since(0)
    outofcore = config.outofcore
    path.parent.mkdir(parents=True, exist_ok=True)
    with TileStore(
        path,
        SonarMap(config),
        tile_size_m=outofcore.tile_size,
        cache_tiles=outofcore.cache_size,
    ) as store:
        store.restore([(key, brick) for key, _, brick in bricks], whole=True)
