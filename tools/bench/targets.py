"""What the project asks of its integrators, and whether a run meets it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from bench_input import DOWN
from contenders import (
    DEFAULT_FIRST,
    DEFAULT_FULL,
    EXACT_FIRST,
    EXACT_FULL,
    FIRST,
    OCTOMAP,
    OPENVDB,
    RAYS_FIRST,
)
from measured import Measured, figure, times_faster
from results import CaseResult, Results

FINE_M = 0.05
ORACLE_WORST = 8.6e-5
"""Largest difference in log-odds of the exact integrator from the oracle of the C++ tests, most of
it the oracle's own (docs/mapping.md)."""
MOST_MEDIAN_MS = {10.0: 20.0, 30.0: 40.0}
LEAST_ERROR_RATIO = 10.0
MOST_GROWTH = {"exact": 4.5, "default": 3.0}
NOT_MEASURED = "not measured"


@dataclass(frozen=True, slots=True)
class Verdict:
    """One wish and what came of it.

    Attributes:
        asked: the project asks it of itself; otherwise it is there for information.
    """

    wish: str
    found: str
    met: bool
    asked: bool = True


def verdicts(results: Results) -> list[Verdict]:
    """Judge a run."""
    fine = [case for case in results.cases if case.resolution_m == FINE_M]
    found = [verdict for case in fine for verdict in _medians(case)]
    found += [verdict for case in fine for verdict in _speed(case, "exact", EXACT_FIRST)]
    found += [verdict for case in fine for verdict in _error(case)]
    found += _growth(results)
    return found + [v for case in fine for v in _speed(case, "default bound", DEFAULT_FIRST)]


def _medians(case: CaseResult) -> Iterator[Verdict]:
    """Asked where the sonar looks down, as when the lines were drawn; ahead it is far denser."""
    most_ms, asked = MOST_MEDIAN_MS[case.range_m], case.look == DOWN
    ours = (
        ("default bound, full image (what a vehicle runs)", DEFAULT_FULL),
        ("default bound, first returns", DEFAULT_FIRST),
        ("exact, full image", EXACT_FULL),
        ("exact, first returns", EXACT_FIRST),
    )
    for name, contender in ours:
        case_name = case.name if asked else f"{case.name} (dense seabed)"
        wish = f"{case_name}: one thread, {name}: median under {most_ms:g} ms"
        run = case.runs.get(contender)
        if run:
            found, met = f"{figure(run.median_ms)} ms", run.median_ms < most_ms
            yield Verdict(wish, found, met, asked)
        else:
            yield Verdict(wish, NOT_MEASURED, met=False, asked=asked)


def _speed(case: CaseResult, way: str, contender: str) -> Iterator[Verdict]:
    """One thread of ours against the others, on the same first returns; asked of exact mode."""
    asked, ours = contender == EXACT_FIRST, case.runs.get(contender)
    rivals = (
        ("OctoMap", _runs(case, OCTOMAP.name), 50.0),
        ("the faster OpenVDB", _runs(case, *(each.name for each in OPENVDB)), 2.0),
        ("our rays", _runs(case, RAYS_FIRST), 10.0),
    )
    for name, runs, least in rivals:
        wish = f"{case.name}: {way} on first returns at least {least:g}x faster than {name}"
        if ours and runs:
            ratio = min(times_faster(ours, run) for run in runs)
            yield Verdict(wish, f"{figure(ratio)}x", ratio >= least, asked)
        else:
            yield Verdict(wish, NOT_MEASURED, met=False, asked=asked)


def _runs(case: CaseResult, *names: str) -> list[Measured]:
    return [case.runs[name] for name in names if name in case.runs]


def _error(case: CaseResult) -> Iterator[Verdict]:
    """The exact integrator's worst error against the mean one of `rays`, where both know."""
    wish = f"{case.name}: error of exact at least 10x smaller than that of our rays"
    if not case.accuracy:
        yield Verdict(wish, NOT_MEASURED, met=False)
        return
    rays_error = case.accuracy[FIRST]["rays"].mean_of_shared
    ratio = rays_error / ORACLE_WORST
    yield Verdict(
        wish,
        f"{ORACLE_WORST:.1e} at worst, {rays_error:.2g} on average where both know: {ratio:.0f}x",
        ratio >= LEAST_ERROR_RATIO,
    )


def _growth(results: Results) -> Iterator[Verdict]:
    for way, most in MOST_GROWTH.items():
        wish = f"open water, {way}: each doubling of the range costs less than {most:g}x"
        if way not in results.open_water:
            yield Verdict(wish, NOT_MEASURED, met=False)
            continue
        times_ms = list(results.open_water[way].values())
        growth = [after / before for before, after in pairwise(times_ms)]
        found = ", ".join(f"{ratio:.2f}x" for ratio in growth)
        yield Verdict(wish, found, max(growth) < most)
