"""Fit of a remote clock to the host's: the lower envelope of arrival minus stamp.

Delays only add. So all points (arrival, arrival minus stamp) lie above the line of the true
offset and drift between the clocks, and the line closest to them from below is the best estimate.
That line is an edge of the lower convex hull of the points: S. Moon, P. Skelly and D. Towsley,
"Estimation and removal of clock skew from network delay measurements", INFOCOM 1999; L. Zhang,
Z. Liu and C. Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002.
Without drift: E. Olson, "A passive solution to the sensor synchronization problem", IROS 2010.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise, takewhile
from operator import itemgetter
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["ClockFit", "ClockFitState"]

WINDOW_NS: Final = 30_000_000_000
"""Lifetime of a point: long enough to measure a drift, short enough for a constant drift."""

BUCKET_NS: Final = 250_000_000
"""Only the lowest point of a bucket is kept, which bounds memory and work at any rate."""

MIN_SPAN_NS: Final = 10_000_000_000
"""Points over a shorter time do not determine the drift: 1 ms of delay would look like 100 ppm."""

MIN_POINTS: Final = 10
"""With fewer points all of them may be late."""

MAX_DRIFT: Final = 200e-6
"""No crystal drifts more. A steeper edge is a change of delay; the line follows it at this rate."""

MAX_RATE_ERROR: Final = 0.01
"""A steeper edge than this is not a clock, for example a constant stamp."""

JUMP_NS: Final = 1_000_000_000
"""A stamp further ahead of its arrival than this is a clock jump, not drift."""

MAX_POINTS: Final = 2 * WINDOW_NS // BUCKET_NS
"""Bound of the memory where arrivals jump to and fro."""

_Point = tuple[int, int]  # arrival, arrival minus stamp


@dataclass(frozen=True, slots=True)
class _Line:
    arrival_ns: int
    offset_ns: int
    slope: float
    rate_error: float  # slope before it was limited

    def at(self, arrival_ns: int) -> int:
        return self.offset_ns + round(self.slope * (arrival_ns - self.arrival_ns))


class _StampPoints:
    """The points that count, in the order in which they came, and their lower convex hull.

    As long as arrivals rise, the hull of all points but the last is carried on with each point that
    comes or goes; the last may still be replaced.
    """

    def __init__(self) -> None:
        self._points: deque[_Point] = deque()
        self._hull: list[_Point] | None = []  # of all but the last; None: to be rebuilt

    def __len__(self) -> int:
        return len(self._points)

    @property
    def first(self) -> _Point:
        return self._points[0]

    @property
    def last(self) -> _Point:
        return self._points[-1]

    def clear(self) -> None:
        self._points.clear()
        self._hull = []

    def state(self) -> tuple[list[_Point], list[_Point] | None]:
        return list(self._points), None if self._hull is None else list(self._hull)

    def restore(self, points: list[_Point], hull: list[_Point] | None) -> None:
        self._points = deque(points)
        self._hull = hull

    def add(self, point: _Point) -> None:
        if len(self) == MAX_POINTS:
            self.drop_first()
        if self._points and self._hull is not None:
            rises = self.last[0] < point[0]
            self._hull = _joined(self._hull, (self.last,)) if rises else None
        self._points.append(point)

    def replace_last(self, point: _Point) -> None:
        del self._points[-1]
        if self._points and not self.last[0] < point[0]:
            self._hull = None
        self._points.append(point)

    def drop_first(self) -> None:
        dropped = self._points.popleft()
        if not self._hull:
            return
        # What lies behind the hull's next corner stays as it is.
        corners = self._hull[1:]
        if corners:
            end = corners[0][0]
            before = takewhile(lambda point: point[0] < end, self._points)
            corners = _joined(_joined([], before), corners[:1]) + corners[1:]
        self._hull = corners if dropped == self._hull[0] else None

    def hull(self) -> list[_Point]:
        """Left to right, of at least one point."""
        if self._hull is None:
            points = list(self._points)
            if not all(before[0] < after[0] for before, after in pairwise(points)):
                return _joined([], sorted(points))
            self._hull = _joined([], points[:-1])
        return _joined(list(self._hull), (self.last,))

    def spread(self) -> tuple[int, int]:
        """Time between the first and the last arrival, and the mean of all."""
        arrivals = list(map(itemgetter(0), self._points))
        return max(arrivals) - min(arrivals), sum(arrivals) // len(arrivals)


class ClockFitState(NamedTuple):
    """State of a `ClockFit`; times in ns.

    Attributes:
        points: (arrival, arrival minus stamp) of the points that count, in their order.
        hull: lower convex hull of all points but the last; None if it is to be computed again.
        line: arrival, offset, slope and slope before it was limited; None before the first stamp.
        last_stamp_ns: newest stamp.
        suspect: (stamp, arrival) that seemed to be a clock jump.
    """

    points: list[tuple[int, int]]
    hull: list[tuple[int, int]] | None
    line: tuple[int, int, float, float] | None
    last_stamp_ns: int | None
    suspect: tuple[int, int] | None


class ClockFit:
    """Offset and drift of one remote clock, estimated from arriving stamps."""

    def __init__(self) -> None:
        self._points = _StampPoints()
        self._line: _Line | None = None
        self._last_stamp_ns: int | None = None
        self._suspect: tuple[int, int] | None = None  # (stamp, arrival)

    @property
    def drift(self) -> float:
        """Seconds that the host's clock gains per second on the remote one; 0 until it is known."""
        return 0.0 if self._line is None else self._line.slope

    @property
    def is_valid(self) -> bool:
        """False if the stamps do not advance like a clock; then their host times are useless."""
        return self._line is None or abs(self._line.rate_error) <= MAX_RATE_ERROR

    def state(self) -> ClockFitState:
        """Return everything that `restore` needs to continue exactly."""
        line = self._line
        return ClockFitState(
            *self._points.state(),
            None
            if line is None
            else (line.arrival_ns, line.offset_ns, line.slope, line.rate_error),
            self._last_stamp_ns,
            self._suspect,
        )

    def restore(self, state: ClockFitState) -> None:
        """Continue as the fit of which `state` was taken."""
        self._points.restore(state.points, state.hull)
        self._line = None if state.line is None else _Line(*state.line)
        self._last_stamp_ns, self._suspect = state.last_stamp_ns, state.suspect

    def restart(self) -> None:
        """Forget everything, after a known restart of the remote clock."""
        self._points.clear()
        self._line = self._last_stamp_ns = self._suspect = None

    def to_host_ns(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """Return the host time of a stamp, or None while the clock seems to have jumped.

        A late record does not matter. A single outlier is skipped; two consecutive outliers that
        agree with each other restart the fit.

        Args:
            stamp_ns: on the remote clock.
            arrival_ns: its arrival on the host's clock.
        """
        if self._jumped(stamp_ns, arrival_ns):
            confirmed = self._suspect is not None and _elapsed_agree(
                self._suspect, (stamp_ns, arrival_ns)
            )
            if not confirmed:
                self._suspect = (stamp_ns, arrival_ns)
                return None
            self.restart()
        self._last_stamp_ns, self._suspect = stamp_ns, None
        line = self._fit((arrival_ns, arrival_ns - stamp_ns))
        on_time_ns = stamp_ns + line.at(arrival_ns)
        # Evaluate the line at the time itself, not at the arrival. A point that was not kept can
        # be below the line by the drift over one bucket, but no event follows its own arrival.
        return min(arrival_ns, stamp_ns + line.at(on_time_ns))

    def _jumped(self, stamp_ns: int, arrival_ns: int) -> bool:
        if self._last_stamp_ns is None or self._line is None:
            return False
        ahead_ns = stamp_ns + self._line.at(arrival_ns) - arrival_ns
        return stamp_ns < self._last_stamp_ns or ahead_ns > JUMP_NS

    def _fit(self, point: _Point) -> _Line:
        """Add the point, drop expired ones, and return the line below all points."""
        news = self._keep(point)
        while abs(point[0] - self._points.first[0]) > WINDOW_NS:
            self._points.drop_first()
            news = True
        if news or self._line is None:
            self._line = _line_below(self._points)
        return self._line

    def _keep(self, point: _Point) -> bool:
        """Keep the point unless another of its time is lower; return whether it was kept."""
        points = self._points
        if len(points) and points.last[0] // BUCKET_NS == point[0] // BUCKET_NS:
            if points.last[1] <= point[1]:
                return False
            points.replace_last(point)
        else:
            points.add(point)
        return True


def _line_below(points: _StampPoints) -> _Line:
    """Return the line that is below all points, of which there is one, and closest on average."""
    hull = points.hull()
    rate_error = 0.0
    span, middle = points.spread()
    if len(points) >= MIN_POINTS and span >= MIN_SPAN_NS:
        rate_error = _slope_at(hull, middle)
    slope = max(-MAX_DRIFT, min(MAX_DRIFT, rate_error))
    origin = hull[0][0]
    arrival, offset = min(hull, key=lambda point: point[1] - slope * (point[0] - origin))
    return _Line(arrival, offset, slope, rate_error)


def _joined(hull: list[_Point], points: Iterable[_Point]) -> list[_Point]:
    """Carry a lower convex hull on (Andrew's monotone chain), exact in integers.

    Args:
        hull: left to right; it is changed.
        points: left to right, none left of the hull's last.
    """
    for point in points:
        x, y = point
        while len(hull) > 1:
            x0, y0 = hull[-2]
            x1, y1 = hull[-1]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        if hull and hull[-1][0] == x:
            if hull[-1][1] <= y:
                continue
            hull.pop()
        hull.append(point)
    return hull


def _slope_at(hull: list[_Point], x: int) -> float:
    """Return the slope of the hull's edge above `x`. `x` must be between the ends of the hull."""
    right = next(index for index, point in enumerate(hull) if point[0] >= x)
    (x0, y0), (x1, y1) = hull[max(right, 1) - 1], hull[max(right, 1)]
    return (y1 - y0) / (x1 - x0)


def _elapsed_agree(before: tuple[int, int], now: tuple[int, int]) -> bool:
    """Return whether both clocks measured the same time between two records."""
    stamps, arrivals = now[0] - before[0], now[1] - before[1]
    return stamps >= 0 and abs(stamps - arrivals) <= JUMP_NS
