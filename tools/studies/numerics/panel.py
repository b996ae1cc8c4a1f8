"""One experiment: errors after so many updates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Curve", "Panel", "checkpoints"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Curve:
    """What one way of computing is off by.

    Attributes:
        label: in the legend.
        error: at every checkpoint; NaN where the numbers themselves are none.
        ours: the product's; others are what a plain program would do.
    """

    label: str
    error: Floats
    ours: bool


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture.

    Attributes:
        title: what is updated.
        unit: of the error.
        updates: number of updates at every checkpoint.
        curves: ours first.
        oracle: by what they are judged.
    """

    title: str
    unit: str
    updates: NDArray[np.int64]
    curves: tuple[Curve, ...]
    oracle: str


def checkpoints(updates: int, count: int = 90) -> NDArray[np.int64]:
    """Numbers of updates, evenly on a logarithmic scale, the last of them all."""
    return np.unique(np.geomspace(1, updates, count).round().astype(np.int64))
