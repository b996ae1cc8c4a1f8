"""Counts of integers, with exact quantiles."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

__all__ = ["Tally"]

Ints = NDArray[np.int64]


class Tally:
    """Counts integers; memory grows with the number of different ones."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}

    def add(self, numbers: Ints) -> None:
        """Count numbers."""
        for number, count in zip(*np.unique(numbers, return_counts=True), strict=True):
            self.add_one(int(number), int(count))

    def add_one(self, number: int, count: int) -> None:
        """Count one number several times."""
        self._counts[number] = self._counts.get(number, 0) + count

    def __len__(self) -> int:
        return sum(self._counts.values())

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Return numbers and counts, ascending."""
        return iter(sorted(self._counts.items()))

    def up_to(self, limit: int) -> int:
        """Return how many are at most a value."""
        return sum(count for number, count in self._counts.items() if number <= limit)

    def quantile(self, share: float) -> int | None:
        """Return the smallest number that a share of all does not exceed; None without any."""
        wanted, seen = max(1, math.ceil(share * len(self) - 1e-9)), 0
        for number, count in self:
            seen += count
            if seen >= wanted:
                return number
        return None
