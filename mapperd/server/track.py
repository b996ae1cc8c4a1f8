"""The way that the vehicle has come, as points that are as dense as there is room for."""

import threading

import numpy as np
from numpy.typing import NDArray

__all__ = ["Track"]

MOST_M = 1e30
"""That the float32 of the messages hold with room."""


class Track:
    """Points of a path; one thread adds, any reads.

    A full path keeps every second point, and takes new ones at twice the distance: its points are
    numbered anew then, and its version counts up.

    Args:
        most: points, at least 2.
        spacing_m: between points that are kept.

    Attributes:
        version: of the numbering.
    """

    def __init__(self, most: int, spacing_m: float) -> None:
        self.version = 0
        self._points = np.zeros((max(most, 2), 3))
        self._count = 0
        self._spacing_m = spacing_m
        self._last: tuple[float, float, float] | None = None
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._count

    def add(self, position_m: NDArray[np.float64]) -> None:
        """The vehicle is here now."""
        x, y, z = position_m.tolist()  # Python's floats: numpy's take several times as long
        if abs(x) + abs(y) + abs(z) > MOST_M:
            return
        last = self._last
        if last is not None:
            dx, dy, dz = x - last[0], y - last[1], z - last[2]
            if dx * dx + dy * dy + dz * dz < self._spacing_m * self._spacing_m:
                return
        self._last = (x, y, z)
        with self._lock:
            if self._count == len(self._points):
                self._thin()
            self._points[self._count] = self._last
            self._count += 1

    def since(self, version: int, first: int, most: int) -> tuple[int, int, NDArray[np.float64]]:
        """The next points of who holds some.

        Args:
            version: of what is held.
            first: number of the first point that is not.
            most: points to give.

        Returns:
            The version, the number of the first point given, and (N, 3) points, metres, map frame.
        """
        with self._lock:
            if version != self.version or first > self._count:
                first = 0
            end = min(self._count, first + most)
            return self.version, first, self._points[first:end].copy()

    def _thin(self) -> None:
        kept = self._points[::2].copy()
        self._points[: len(kept)] = kept
        self._count = len(kept)
        self._spacing_m *= 2
        self.version += 1
