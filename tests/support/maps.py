"""Maps of known voxels."""

from collections.abc import Sequence

import msgspec
import numpy as np

from mapperd.config.tree import Config, OctreeConfig
from mapperd.mapping.sonar_map import SonarMap

COARSE = Config(octree=OctreeConfig(voxel_resolution=0.25))

OCCUPIED = [(-3.125, 20.375, -7.875), (-3.125, 20.375, -6.125), (-2.625, 19.875, -7.125)]
FREE = [(-3.125, 20.375, -5.125), (-2.375, 20.625, -7.125), (-2.875, 20.125, 4.125)]
UNSURE = [(-2.375, 19.875, -7.125)]


def map_of(
    occupied: Sequence[tuple[float, ...]],
    free: Sequence[tuple[float, ...]] = (),
    unsure: Sequence[tuple[float, ...]] = (),
    config: Config = COARSE,
) -> SonarMap:
    sonar_map = SonarMap(config)
    for points, log_odds in ((occupied, 3.0), (free, -2.0), (unsure, 0.1)):
        if points:
            sonar_map.core.set_log_odds(np.array(points), np.full(len(points), log_odds))
    return sonar_map


def with_thresholds(occupied: float, free: float) -> Config:
    mapping = msgspec.structs.replace(
        COARSE.mapping, occupied_threshold=occupied, free_threshold=free
    )
    return msgspec.structs.replace(COARSE, mapping=mapping)
