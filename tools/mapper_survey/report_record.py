"""`report.json`: fields say their units; docs/survey-products.md says what they mean."""

import math
from collections.abc import Mapping

import msgspec

from mapper_survey.coverage import Coverage
from mapper_survey.difference import Comparison, Way
from mapper_survey.tally import Tally

__all__ = ["VERSION", "DiveRecord", "PairRecord", "Report", "WayRecord", "report_of"]

VERSION = 1

EXCELLENT, MODERATE = 0.1, 0.3
"""Grades of the published mapper's analyser, by the share of voxels without a partner."""


class DiveRecord(msgspec.Struct, frozen=True):
    """Ground of one dive."""

    name: str
    observed_m2: float
    mapped_m2: float
    alone_m2: float


class WayRecord(msgspec.Struct, frozen=True):
    """From one dive's occupied voxels to the other's."""

    voxels: int
    common: int
    only: int
    only_share: float | None
    compared: int
    missing: int
    missing_share: float | None
    called_free: int
    conflicts: int
    farther: int
    median_m: float | None
    p95_m: float | None


class HeightRecord(msgspec.Struct, frozen=True):
    """Differences of surfaces where several dives have one."""

    cells: int
    median_m: float | None
    p95_m: float | None


class PairRecord(msgspec.Struct, frozen=True):
    """Two dives."""

    a: str
    b: str
    a_to_b: WayRecord
    b_to_a: WayRecord
    dz: HeightRecord
    mean_only_share: float | None
    published_grade: str | None
    mean_missing_share: float | None
    grade: str | None


class CoverageRecord(msgspec.Struct, frozen=True):
    """Ground of all dives."""

    mapped_m2: float
    overlap_m2: float
    merged_m2: float
    by_dives_m2: dict[str, float]


class Report(msgspec.Struct, frozen=True):
    """The whole document."""

    version: int
    resolution_m: float
    tolerance_m: float
    reach_m: float
    occupied_threshold: float
    free_threshold: float
    coverage: CoverageRecord
    spread: HeightRecord
    dives: list[DiveRecord]
    pairs: list[PairRecord]


def report_of(
    comparison: Comparison,
    coverage: Coverage,
    ways: Mapping[tuple[str, str], Way],
    *,
    tolerance_m: float,
    thresholds: tuple[float, float],
) -> Report:
    """Put together what was counted."""
    edge_m = comparison.resolution_m
    cell_m2 = edge_m**2
    return Report(
        VERSION,
        edge_m,
        tolerance_m,
        comparison.reach * edge_m,
        *thresholds,
        CoverageRecord(
            len(coverage.by_dives) * cell_m2,
            (len(coverage.by_dives) - coverage.by_dives.up_to(1)) * cell_m2,
            coverage.merged * cell_m2,
            {str(dives): cells * cell_m2 for dives, cells in coverage.by_dives},
        ),
        _heights(coverage.spread, coverage.spread, edge_m),
        [
            DiveRecord(
                name,
                coverage.observed[name] * cell_m2,
                coverage.mapped[name] * cell_m2,
                coverage.alone[name] * cell_m2,
            )
            for name in coverage.mapped
        ],
        [_pair(a, b, ways, tally, comparison) for (a, b), tally in coverage.dz.items()],
    )


def _pair(
    a: str, b: str, ways: Mapping[tuple[str, str], Way], dz: Tally, comparison: Comparison
) -> PairRecord:
    there, back = (_way(ways[pair], comparison) for pair in ((a, b), (b, a)))
    only, missing = (
        _mean(getattr(there, share), getattr(back, share))
        for share in ("only_share", "missing_share")
    )
    apart = Tally()
    for number, count in dz:
        apart.add_one(abs(number), count)
    heights = _heights(dz, apart, comparison.resolution_m)
    return PairRecord(a, b, there, back, heights, only, _grade(only), missing, _grade(missing))


def _way(way: Way, comparison: Comparison) -> WayRecord:
    missing, only = way.compared - way.common, way.voxels - way.common
    return WayRecord(
        way.voxels,
        way.common,
        only,
        only / way.voxels if way.voxels else None,
        way.compared,
        missing,
        missing / way.compared if way.compared else None,
        way.called_free,
        way.conflicts,
        len(way.squares) - way.squares.up_to(comparison.reach**2),
        _distance(way.squares.quantile(0.5), comparison),
        _distance(way.squares.quantile(0.95), comparison),
    )


def _distance(square: int | None, comparison: Comparison) -> float | None:
    """In metres; None where nobody knows more than that it is beyond the reach."""
    if square is None or square > comparison.reach**2:
        return None
    return math.sqrt(square) * comparison.resolution_m


def _heights(middle: Tally, high: Tally, edge_m: float) -> HeightRecord:
    median, p95 = middle.quantile(0.5), high.quantile(0.95)
    return HeightRecord(
        len(middle),
        None if median is None else median * edge_m,
        None if p95 is None else p95 * edge_m,
    )


def _mean(a: float | None, b: float | None) -> float | None:
    """Of both ways, or the one that there is."""
    there = [share for share in (a, b) if share is not None]
    return sum(there) / len(there) if there else None


def _grade(share: float | None) -> str | None:
    if share is None:
        return None
    return "excellent" if share < EXCELLENT else "moderate" if share < MODERATE else "poor"
