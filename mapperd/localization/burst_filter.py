"""Detects pings that another sound source fills: most of their returns are new.

A ping is explained by another one if few of its returns differ by more than the vehicle can have
moved. Each ping is compared with the two before it. Neither explains a burst; the ping before a
burst explains the one after it; a real change is explained by its repetition.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BurstState", "BurstWatch", "unexplained_share"]

Floats = NDArray[np.float64]

MIN_RETURNS = 16
"""Minimum number of returns for a share."""


class BurstState(NamedTuple):
    """State of a `BurstWatch`: its limits, and times, bearings and ranges of the last pings."""

    max_speed_mps: float
    max_turn_radps: float
    last: list[tuple[int, Floats, Floats]]


@dataclass(frozen=True, slots=True, eq=False)
class _SeenScan:
    stamp_ns: int
    bearing_rad: Floats
    range_m: Floats


def unexplained_share(
    bearing_rad: Floats, range_m: Floats, before_m: Floats, *, moved_m: float, turned_rad: float
) -> float:
    """Return the share of a ping's returns that another ping does not explain.

    Another return explains one if a turn can have moved its beam there and if the ranges differ by
    no more than the vehicle can have moved.

    Args:
        bearing_rad: (beams,) increasing.
        range_m: (beams,), NaN where there is no return.
        before_m: (beams,) ranges of the other ping.
        moved_m: maximum motion between the pings.
        turned_rad: maximum turn between the pings.

    Returns:
        0..1; 0 where there are no returns.
    """
    beams = len(bearing_rad)
    spacing = (bearing_rad[-1] - bearing_rad[0]) / max(beams - 1, 1)
    reach = min(beams, 1 + math.ceil(turned_rad / max(spacing, 1e-9)))
    nearest = np.full(beams, np.inf)
    for shift in range(-reach, reach + 1):
        ours = slice(max(shift, 0), beams + min(shift, 0))
        theirs = slice(max(-shift, 0), beams + min(-shift, 0))
        difference = np.abs(range_m[ours] - before_m[theirs])
        nearest[ours] = np.fmin(nearest[ours], difference)
    returns = np.isfinite(range_m)
    count = int(returns.sum())
    return float((nearest[returns] > moved_m).sum()) / count if count else 0.0


class BurstWatch:
    """Compares each ping with the two before it.

    Args:
        max_speed_mps: maximum speed of the vehicle.
        max_turn_radps: maximum turn rate of the vehicle.
    """

    def __init__(self, max_speed_mps: float, max_turn_radps: float) -> None:
        self._max_speed_mps = max_speed_mps
        self._max_turn_radps = max_turn_radps
        self._last: tuple[_SeenScan, ...] = ()

    def state(self) -> BurstState:
        """Return the state for `restored`."""
        last = [(one.stamp_ns, one.bearing_rad, one.range_m) for one in self._last]
        return BurstState(self._max_speed_mps, self._max_turn_radps, last)

    @classmethod
    def restored(cls, state: BurstState) -> "BurstWatch":
        """Return the watch that `state` was taken from."""
        watch = cls(state.max_speed_mps, state.max_turn_radps)
        watch._last = tuple(_SeenScan(*seen) for seen in state.last)
        return watch

    def share(self, stamp_ns: int, bearing_rad: Floats, range_m: Floats, cell_m: float) -> float:
        """Return the share of returns that no earlier ping explains, 0..1; remember the ping.

        Args:
            stamp_ns: time of the ping, always on the same clock.
            bearing_rad: (beams,).
            range_m: (beams,), NaN where there is no return.
            cell_m: difference of ranges that always counts as equal.
        """
        seen = _SeenScan(stamp_ns, bearing_rad, range_m)
        shares = [self._share(seen, other, cell_m) for other in self._last]
        self._last = (*self._last, seen)[-2:]
        enough = np.isfinite(range_m).sum() >= MIN_RETURNS
        return min((one for one in shares if one is not None), default=0.0) if enough else 0.0

    def _share(self, seen: _SeenScan, other: _SeenScan, cell_m: float) -> float | None:
        """Return the share against one ping; None if its beams differ."""
        if not np.array_equal(seen.bearing_rad, other.bearing_rad):
            return None
        passed_s = abs(seen.stamp_ns - other.stamp_ns) / 1e9
        return unexplained_share(
            seen.bearing_rad,
            seen.range_m,
            other.range_m,
            moved_m=cell_m + self._max_speed_mps * passed_s,
            turned_rad=min(self._max_turn_radps * passed_s, math.pi),
        )
