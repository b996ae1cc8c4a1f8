"""A mirror as a map that can be saved, exported and asked like the daemon's own."""

import math

import msgspec
import numpy as np

from mapperd.client.block_table import Cells
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.wire.messages import MapFacts

__all__ = ["map_of"]

MAX_LOG_ODDS = 127.0
"""Of any map."""


def map_of(cells: Cells, cell_m: float, facts: MapFacts, config: Config | None = None) -> SonarMap:
    """Every cell as a voxel with its quantised log-odds, observed once.

    Args:
        cells: that are known.
        cell_m: edge of a cell, which may be several voxels of the daemon's.
        facts: of the daemon's map.
        config: the daemon's settings, as far as they are known; grid, thresholds and clamps are
            those of the cells.
    """
    config = config or Config()
    # A whole number of steps may lie beyond what the map that was rounded to them can hold.
    most = min(float(np.abs(cells.log_odds).max(initial=0.0)), MAX_LOG_ODDS)
    replace = msgspec.structs.replace
    sonar_map = SonarMap(
        replace(
            config,
            octree=replace(config.octree, voxel_resolution=cell_m),
            mapping=replace(
                config.mapping,
                occupied_threshold=_probability(facts.occupied_log_odds),
                free_threshold=_probability(facts.free_log_odds),
            ),
            iwlo=replace(
                config.iwlo,
                L_min=min(config.iwlo.L_min, -most),
                L_max=max(config.iwlo.L_max, most),
            ),
        )
    )
    sonar_map.core.set_log_odds(cells.centres_m, cells.log_odds.astype(np.float64))
    return sonar_map


def _probability(log_odds: float) -> float:
    """Strictly between 0 and 1, as a threshold must be."""
    odds = math.exp(-abs(log_odds))
    p = odds / (1 + odds) if log_odds < 0 else 1 / (1 + odds)
    return min(max(p, math.ulp(0.0)), math.nextafter(1.0, 0.0))
