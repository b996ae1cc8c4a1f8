"""Log-odds as the map stream sends them, by plain numpy: docs/reference/map-stream.md."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.wire.messages import MapInfo

__all__ = ["sent_steps"]

MAX_STEP = 127


def sent_steps(log_odds: NDArray[np.floating[Any]], facts: MapInfo) -> NDArray[np.int8]:
    """Whole steps of log-odds: the nearest that the thresholds sort as they do these, if any."""
    steps = np.arange(-MAX_STEP, MAX_STEP + 1)
    values = steps * facts.log_odds_step
    occupied = steps[values > facts.occupied_log_odds]
    free = steps[values < facts.free_log_odds]
    min_occupied = int(occupied[0]) if len(occupied) else MAX_STEP + 1
    max_free = int(free[-1]) if len(free) else -MAX_STEP - 1
    as_held = log_odds.astype(np.float32)
    is_occupied = as_held > facts.occupied_log_odds
    is_free = as_held < facts.free_log_odds
    least = np.where(is_occupied, min_occupied, np.where(is_free, -MAX_STEP, max_free + 1))
    most = np.where(is_free, max_free, np.where(is_occupied, MAX_STEP, min_occupied - 1))
    steps = np.clip(np.rint(log_odds / facts.log_odds_step), -MAX_STEP, MAX_STEP)
    sided = np.minimum(np.maximum(steps, least), most)
    sided_steps: NDArray[np.int8] = np.where(least <= most, sided, steps).astype(np.int8)
    return sided_steps
