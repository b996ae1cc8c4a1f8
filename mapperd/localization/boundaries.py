"""Surfaces without what lies behind them: an echo is longer than a wall is thick.

A sonar's map holds a wall as deep as its echoes are long. A scan has the front, and a filter that
finds all of the depth alike likely sits by half of it too near.
"""

import numpy as np

from mapperd.mapping.probability import log_odds_of
from mapperd.mapping.queries import FREE, MapQueries
from mapperd.mapping.sonar_map import SonarMap

__all__ = ["keep_boundaries"]

SIDES = np.concatenate([np.eye(3), -np.eye(3)])


def keep_boundaries(sonar_map: SonarMap) -> int:
    """Make occupied voxels with no free one at any of their six sides uncertain.

    Returns:
        How many stay occupied.
    """
    mapping = sonar_map.config.mapping
    queries = MapQueries(
        sonar_map.core,
        occupied_threshold=mapping.occupied_threshold,
        free_threshold=mapping.free_threshold,
    )
    occupied_m = sonar_map.voxels("occupied").centres_m
    beside = np.zeros(len(occupied_m), dtype=np.bool_)
    for side in SIDES:
        beside |= queries.classify(occupied_m + sonar_map.resolution_m * side) == FREE
    behind_m = occupied_m[~beside]
    limits = mapping.free_threshold, mapping.occupied_threshold
    between = float(np.mean([log_odds_of(limit, "threshold") for limit in limits]))
    sonar_map.core.set_log_odds(behind_m, np.full(len(behind_m), between))
    return int(beside.sum())
