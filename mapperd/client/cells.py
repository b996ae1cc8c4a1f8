"""Cells of a mirror, as arrays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cells"]


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Some cells of a mirror, in no particular order.

    Attributes:
        centres_m: (N, 3) float64, map frame.
        log_odds: (N,) float32, quantised.
        probability: (N,) float32, of being occupied.
        count: (N,) uint16: that often observed at least; 0 where counts are not told.
        changed_ns: (N,) int64, Unix: when their block changed last.
    """

    centres_m: NDArray[np.float64]
    log_odds: NDArray[np.float32]
    probability: NDArray[np.float32]
    count: NDArray[np.uint16]
    changed_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.log_odds)
