"""Which settings are worth choosing: those that no other one beats in both error and cost."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from studies.accuracy_cost.results import StudyResults, key_of
from studies.accuracy_cost.study import Knob, Setting, Study, StudyDive

__all__ = [
    "SAME_COST",
    "SURELY",
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

SURELY = 2.0
"""Standard errors by which a difference is more than chance, 19 times of 20."""


@dataclass(frozen=True, slots=True)
class Point:
    """A setting as it is drawn: both axes are better where they are less.

    Attributes:
        chance: standard error of `error`, where it is of a sample drawn at random.
    """

    setting: Setting
    cost: float
    error: float
    chance: float = 0.0

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
        share: of its error that another one surely avoids at no more cost; 0 is on the front.
        better: that other setting.
    """

    share: float
    better: Setting | None


def lag(point: Point, others: Sequence[Point]) -> Lag:
    """How much less the error of another setting is, among those that cost no more.

    An error that does not exist (nothing was mapped) is worse than any other. A difference that
    may be chance does not count.
    """
    error = math.inf if math.isnan(point.error) else point.error
    at_no_more = [o for o in others if o.known and o.cost <= point.cost * SAME_COST]

    def at_most(other: Point) -> float:
        return other.error + SURELY * math.hypot(point.chance, other.chance)

    best = min(at_no_more, key=at_most, default=None)
    if best is None or at_most(best) >= error:
        return Lag(0.0, None)
    return Lag(1.0 if math.isinf(error) else 1.0 - at_most(best) / error, best.setting)


class Plane(NamedTuple):
    """The columns on both axes, and of the error's standard error where it has one."""

    cost: str
    error: str
    chance: str | None = None


def plane_of(study: Study, knob: Knob | None = None) -> Plane:
    """Where settings are compared: a knob may have an error of its own."""
    error = (knob.error if knob else None) or study.error
    chance = {column.name: column.chance for column in study.columns}
    return Plane(study.cost, error, chance.get(error))


def point_on(plane: Plane, results: StudyResults, setting: Setting, dive: StudyDive) -> Point:
    """A setting on a dive; NaN where it is not measured."""
    figures = results.rows.get(key_of(setting, dive), {})
    chance = figures.get(plane.chance, 0.0) if plane.chance else 0.0
    return Point(
        setting,
        figures.get(plane.cost, math.nan),
        figures.get(plane.error, math.nan),
        0.0 if math.isnan(chance) else chance,
    )


def mean_point(
    plane: Plane, results: StudyResults, setting: Setting, dives: Sequence[StudyDive]
) -> Point:
    """The mean over dives; NaN where it is not measured on all."""
    on = [point_on(plane, results, setting, dive) for dive in dives]
    return Point(
        setting,
        math.fsum(point.cost for point in on) / len(on),
        math.fsum(point.error for point in on) / len(on),
        math.hypot(*(point.chance for point in on)) / len(on),
    )
