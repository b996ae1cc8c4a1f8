"""Pings that another sound source fills: in them most beams see what no ping before saw.

A ping is explained by another one if few of its returns differ from that one's by more than the
vehicle can have moved. It is compared with the two before it: a burst is explained by neither, the
ping after a burst by the one before it, and what really changed by its own repetition.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BurstState", "BurstWatch", "unexplained_share"]

Floats = NDArray[np.float64]

MIN_RETURNS = 16
"""Fewer returns give no share."""


class BurstState(NamedTuple):
    """State of a `BurstWatch`: its limits, and time, bearings and ranges of the last pings."""

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
    """Share of a ping's returns that another ping of the same beams does not explain.

    A return is explained by one of a beam that a turn may have put in its place, at a range that
    differs by no more than the vehicle may have moved.

    Args:
        bearing_rad: (beams,) increasing.
        range_m: (beams,), NaN where there is no return.
        before_m: (beams,) of the other ping.
        moved_m: at most, between the pings.
        turned_rad: at most.

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
        max_speed_mps: of the vehicle.
        max_turn_radps: of the vehicle.
    """

    def __init__(self, max_speed_mps: float, max_turn_radps: float) -> None:
        self._max_speed_mps = max_speed_mps
        self._max_turn_radps = max_turn_radps
        self._last: tuple[_SeenScan, ...] = ()

    def state(self) -> BurstState:
        """Everything that `restored` needs to continue exactly."""
        last = [(one.stamp_ns, one.bearing_rad, one.range_m) for one in self._last]
        return BurstState(self._max_speed_mps, self._max_turn_radps, last)

    @classmethod
    def restored(cls, state: BurstState) -> "BurstWatch":
        """The watch of which `state` was taken."""
        watch = cls(state.max_speed_mps, state.max_turn_radps)
        watch._last = tuple(_SeenScan(*seen) for seen in state.last)
        return watch

    def share(self, stamp_ns: int, bearing_rad: Floats, range_m: Floats, cell_m: float) -> float:
        """Share of the returns that no ping before explains, 0..1; the ping is then remembered.

        Args:
            stamp_ns: of the ping, on any one clock.
            bearing_rad: (beams,).
            range_m: (beams,), NaN where there is no return.
            cell_m: by which ranges differ anyway.
        """
        seen = _SeenScan(stamp_ns, bearing_rad, range_m)
        shares = [self._share(seen, other, cell_m) for other in self._last]
        self._last = (*self._last, seen)[-2:]
        enough = np.isfinite(range_m).sum() >= MIN_RETURNS
        return min((one for one in shares if one is not None), default=0.0) if enough else 0.0

    def _share(self, seen: _SeenScan, other: _SeenScan, cell_m: float) -> float | None:
        """None for a ping of other beams: it cannot be compared."""
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
