"""What the project requires of the evidence grid at 5 cm, and whether a run meets it."""

import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from bench.contenders import (
    BONXAI,
    GRID_FIRST,
    GRID_FULL,
    GRID_FULL_2,
    OCTOMAP,
    OPENVDB,
    RAYS_FULL,
    Contender,
)
from bench.inputs import AHEAD, DOWN
from bench.results import CaseResult, ContenderResult, figure, p95, times_faster

FINE_M = 0.05
Measure = Callable[[CaseResult], float | None]
Corner = tuple[str, float]
"""Look and range in metres."""
CORNERS: tuple[Corner, ...] = ((DOWN, 10.0), (AHEAD, 10.0), (DOWN, 30.0), (AHEAD, 30.0))
RATE_MS = {10.0: 6.25, 30.0: 100.0}
"""By range: a quarter of the 25 ms between the sonar's pings at 40 Hz; ten pings a second."""


@dataclass(frozen=True, slots=True)
class PerformanceTarget:
    """One figure of each 5 cm case, and its limit.

    Attributes:
        wish: what is required.
        measure: the figure; None if it was not measured.
        limits: by case; empty for a figure that is only reported.
        at_least: the limit is the least allowed value, otherwise the greatest.
        unit: follows the figure.
        asked: the project requires it; otherwise it is for information.
    """

    wish: str
    measure: Measure
    limits: Mapping[Corner, float] = field(default_factory=dict)
    at_least: bool = True
    unit: str = "x"
    asked: bool = True


@dataclass(frozen=True, slots=True)
class TargetVerdict:
    """A target on one case.

    Attributes:
        found: None if not measured.
        limit: None if the target has none for this case.
    """

    target: PerformanceTarget
    found: float | None
    limit: float | None

    @property
    def met(self) -> bool:
        """Whether the limit is kept; a figure that is missing keeps none."""
        if self.found is None or self.limit is None:
            return self.limit is None
        return self.found >= self.limit if self.target.at_least else self.found <= self.limit

    def __str__(self) -> str:
        """The figure with its limit; bold where missed."""
        if self.found is None:
            return "not measured"
        found = f"{figure(self.found)}{self.target.unit}"
        if self.limit is None:
            return found
        sign = "≥" if self.target.at_least else "≤"
        found = found if self.met else f"**{found}**"
        return f"{found} ({sign} {self.limit:g})"


def fine_cases(cases: list[CaseResult]) -> list[CaseResult]:
    """The cases that targets are for."""
    return [case for case in cases if case.resolution_m == FINE_M]


def judge(target: PerformanceTarget, case: CaseResult) -> TargetVerdict:
    """Compare a case's figure with its limit."""
    return TargetVerdict(target, target.measure(case), target.limits.get((case.look, case.range_m)))


def _everywhere(limit: float) -> dict[Corner, float]:
    return dict.fromkeys(CORNERS, limit)


def _each(*limits: float) -> dict[Corner, float]:
    return dict(zip(CORNERS, limits, strict=True))


def _faster_than(ours: Contender, *others: Contender) -> Measure:
    """Ratio of the medians, to the fastest of the others."""

    def ratio(case: CaseResult) -> float | None:
        run = case.runs.get(ours.name)
        rivals = [case.runs[other.name] for other in others if other.name in case.runs]
        return min((times_faster(run, each) for each in rivals), default=None) if run else None

    return ratio


def _full_image(figure_of: Callable[[ContenderResult], float | None]) -> Measure:
    """A figure of one thread on full images."""

    def found(case: CaseResult) -> float | None:
        run = case.runs.get(GRID_FULL.name)
        return figure_of(run) if run else None

    return found


def _threads(case: CaseResult) -> float | None:
    one, two = case.runs.get(GRID_FULL.name), case.runs.get(GRID_FULL_2.name)
    return times_faster(two, one) if one and two else None


def _median_moving(run: ContenderResult) -> float | None:
    return statistics.median(run.moving_ms) if run.moving_ms else None


def _p95_moving(run: ContenderResult) -> float | None:
    return p95(run.moving_ms) if run.moving_ms else None


def _at(range_m: float) -> dict[Corner, float]:
    return {corner: RATE_MS[range_m] for corner in CORNERS if corner[1] == range_m}


_FASTER_THAN_RAYS = "full image: faster than our rays"
_FASTER_THAN_OPENVDB = "first returns: faster than the faster OpenVDB"
TARGETS = (
    PerformanceTarget(
        _FASTER_THAN_RAYS, _faster_than(GRID_FULL, RAYS_FULL), _each(9, 13, 4.5, 3.5)
    ),
    PerformanceTarget(
        _FASTER_THAN_OPENVDB, _faster_than(GRID_FIRST, *OPENVDB), _each(3, 3, 1.3, 1.3)
    ),
    PerformanceTarget(
        "first returns: faster than OctoMap",
        _faster_than(GRID_FIRST, OCTOMAP),
        _each(35, 35, 35, 15),
    ),
    PerformanceTarget(
        "full image, moving: median, a quarter of the time between pings at 40 Hz",
        _full_image(_median_moving),
        _at(10.0),
        at_least=False,
        unit=" ms",
    ),
    PerformanceTarget(
        "full image, moving: 95th percentile, the time between pings at 10 Hz",
        _full_image(_p95_moving),
        _at(30.0),
        at_least=False,
        unit=" ms",
    ),
    PerformanceTarget(
        "full image: moving against at rest",
        _full_image(lambda run: run.motion_ratio),
        _everywhere(1.15),
        at_least=False,
    ),
    PerformanceTarget("full image: two threads against one", _threads, _everywhere(1.7)),
    PerformanceTarget(
        "full image: first ping into an empty map against the median",
        _full_image(lambda run: run.first_ping_ratio),
        _everywhere(2.0),
        at_least=False,
    ),
    PerformanceTarget(
        "full image: bytes a voxel held",
        _full_image(lambda run: run.bytes_a_held_voxel),
        _everywhere(4.0),
        at_least=False,
        unit="",
    ),
    PerformanceTarget(
        f"{_FASTER_THAN_RAYS}, moonshot",
        _faster_than(GRID_FULL, RAYS_FULL),
        _each(18, 26, 9, 7),
        asked=False,
    ),
    PerformanceTarget(
        "first returns: faster than Bonxai", _faster_than(GRID_FIRST, BONXAI), asked=False
    ),
)
