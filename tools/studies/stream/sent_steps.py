"""Log-odds as the map stream sends them, by plain numpy: docs/reference/map-stream.md."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.wire.messages import MapFacts

__all__ = ["sent_steps"]

MOST = 127


def sent_steps(log_odds: NDArray[np.floating[Any]], facts: MapFacts) -> NDArray[np.int8]:
    """Whole steps of log-odds: the nearest that the thresholds sort as they do these, if any."""
    steps = np.arange(-MOST, MOST + 1)
    values = steps * facts.log_odds_step
    occupied = steps[values > facts.occupied_log_odds]
    free = steps[values < facts.free_log_odds]
    least_occupied = int(occupied[0]) if len(occupied) else MOST + 1
    most_free = int(free[-1]) if len(free) else -MOST - 1
    as_held = log_odds.astype(np.float32)
    is_occupied = as_held > facts.occupied_log_odds
    is_free = as_held < facts.free_log_odds
    least = np.where(is_occupied, least_occupied, np.where(is_free, -MOST, most_free + 1))
    most = np.where(is_free, most_free, np.where(is_occupied, MOST, least_occupied - 1))
    steps = np.clip(np.rint(log_odds / facts.log_odds_step), -MOST, MOST)
    sided = np.minimum(np.maximum(steps, least), most)
    sided_steps: NDArray[np.int8] = np.where(least <= most, sided, steps).astype(np.int8)
    return sided_steps
