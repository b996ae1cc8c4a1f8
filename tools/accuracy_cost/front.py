"""Which settings are worth choosing: those that no other one beats in both error and cost."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from accuracy_cost.results import Results, key_of
from accuracy_cost.study import Dive, Knob, Setting, Study

__all__ = [
    "SAME_COST",
    "Lag",
    "Plane",
    "Point",
    "dominates",
    "front",
    "lag",
    "mean_point",
    "plane_of",
    "point_on",
]

SAME_COST = 1.05
"""Costs within a twentieth are the same: times of two runs differ by as much."""


@dataclass(frozen=True, slots=True)
class Point:
    """A setting as it is drawn: both axes are better where they are less."""

    setting: Setting
    cost: float
    error: float

    @property
    def known(self) -> bool:
        """Whether it has a place in the plot."""
        return math.isfinite(self.cost) and math.isfinite(self.error)


def dominates(a: Point, b: Point) -> bool:
    """Whether `a` is no worse than `b` in error and in cost, and better in one."""
    if a.cost > b.cost or a.error > b.error:
        return False
    return a.cost < b.cost or a.error < b.error


def front(points: Iterable[Point]) -> list[Point]:
    """The points that no other dominates, cheapest first."""
    known = [point for point in points if point.known]
    best = [a for a in known if not any(dominates(b, a) for b in known)]
    return sorted(best, key=lambda point: (point.cost, point.error))


@dataclass(frozen=True, slots=True)
class Lag:
    """How far a setting lies behind others.

    Attributes:
        share: of its error that another one avoids at no more cost; 0 is on the front.
        better: that other setting.
    """

    share: float
    better: Setting | None


def lag(point: Point, others: Sequence[Point]) -> Lag:
    """How much less the error of another setting is, among those that cost no more.

    An error that does not exist (nothing was mapped) is worse than any other.
    """
    error = math.inf if math.isnan(point.error) else point.error
    at_no_more = [o for o in others if o.known and o.cost <= point.cost * SAME_COST]
    best = min(at_no_more, key=lambda other: other.error, default=None)
    if best is None or best.error >= error:
        return Lag(0.0, None)
    return Lag(1.0 if math.isinf(error) else 1.0 - best.error / error, best.setting)


class Plane(NamedTuple):
    """The columns on both axes."""

    cost: str
    error: str


def plane_of(study: Study, knob: Knob | None = None) -> Plane:
    """Where settings are compared: a knob may have an error of its own."""
    own = knob.error if knob else None
    return Plane(study.cost, own or study.error)


def point_on(plane: Plane, results: Results, setting: Setting, dive: Dive) -> Point:
    """A setting on a dive; NaN where it is not measured."""
    figures = results.rows.get(key_of(setting, dive), {})
    return Point(setting, figures.get(plane.cost, math.nan), figures.get(plane.error, math.nan))


def mean_point(plane: Plane, results: Results, setting: Setting, dives: Sequence[Dive]) -> Point:
    """The mean over dives; NaN where it is not measured on all."""
    on = [point_on(plane, results, setting, dive) for dive in dives]
    return Point(
        setting,
        math.fsum(point.cost for point in on) / len(on),
        math.fsum(point.error for point in on) / len(on),
    )
