"""What the project asks of its integrators, and whether a run meets it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

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
from measured import figure, times_faster
from results import CaseResult, Results

FINE_M = 0.05
ORACLE_WORST = 8.6e-5
"""Largest difference in log-odds of the exact integrator from the oracle of the C++ tests, most of
it the oracle's own (docs/mapping.md)."""
MOST_MEDIAN_MS = {10.0: 20.0, 30.0: 40.0}
LEAST_ERROR_RATIO = 10.0
MOST_GROWTH = {"exact": 4.5, "default": 3.0}


@dataclass(frozen=True, slots=True)
class Verdict:
    """One wish and what came of it."""

    wish: str
    found: str
    met: bool


def verdicts(results: Results) -> list[Verdict]:
    """Judge a run."""
    fine = [case for case in results.cases if case.resolution_m == FINE_M]
    found = [verdict for case in fine for verdict in (*_speed(case), *_error(case))]
    found += [verdict for case in fine for verdict in _medians(case)]
    return found + list(_growth(results))


def _speed(case: CaseResult) -> Iterator[Verdict]:
    """Exact mode against the others, on the same first returns."""
    exact = case.runs[EXACT_FIRST]
    vdb = [case.runs[way.name] for way in OPENVDB if way.name in case.runs]
    rivals = (
        ("OctoMap", [case.runs[OCTOMAP.name]] if OCTOMAP.name in case.runs else [], 50.0),
        ("the faster OpenVDB", vdb, 2.0),
        ("our rays", [case.runs[RAYS_FIRST]], 10.0),
    )
    for name, runs, least in rivals:
        wish = f"{case.name}: exact on first returns at least {least:g}x faster than {name}"
        if runs:
            ratio = min(times_faster(exact, run) for run in runs)
            yield Verdict(wish, f"{figure(ratio)}x", ratio >= least)
        else:
            yield Verdict(wish, "not measured", met=False)


def _error(case: CaseResult) -> Iterator[Verdict]:
    """The exact integrator's worst error against the mean one of `rays`, where both know."""
    rays_error = case.accuracy[FIRST]["rays"].mean_of_shared
    ratio = rays_error / ORACLE_WORST
    yield Verdict(
        f"{case.name}: error of exact at least 10x smaller than that of our rays",
        f"{ORACLE_WORST:.1e} at worst, {rays_error:.2g} on average where both know: {ratio:.0f}x",
        ratio >= LEAST_ERROR_RATIO,
    )


def _medians(case: CaseResult) -> Iterator[Verdict]:
    most_ms = MOST_MEDIAN_MS[case.range_m]
    ours = (
        ("exact, first returns", EXACT_FIRST),
        ("exact, full image", EXACT_FULL),
        ("default, first returns", DEFAULT_FIRST),
        ("default, full image", DEFAULT_FULL),
    )
    for name, contender in ours:
        median_ms = case.runs[contender].median_ms
        wish = f"{case.name}: one thread, {name}, median under {most_ms:g} ms"
        yield Verdict(wish, f"{figure(median_ms)} ms", median_ms < most_ms)


def _growth(results: Results) -> Iterator[Verdict]:
    for way, most in MOST_GROWTH.items():
        times_ms = list(results.open_water[way].values())
        growth = [after / before for before, after in pairwise(times_ms)]
        yield Verdict(
            f"open water, {way}: each doubling of the range costs less than {most:g}x",
            ", ".join(f"{ratio:.2f}x" for ratio in growth),
            max(growth) < most,
        )
