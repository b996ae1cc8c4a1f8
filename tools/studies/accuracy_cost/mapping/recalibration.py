"""Fit the curve that turns a map's probabilities into shares, and judge it where it was not fitted.

Fitted on a harbour of its own (another layout, path and seed than any dive of the study) with the
profile `survey`; judged on the study's dives.

Usage: python -m studies calibration [--folder FOLDER] [--write]
"""

import argparse
import textwrap
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.export.calibration import ProbabilityCalibration, load_calibration
from studies.accuracy_cost.mapping.dives import DIVES, FIT, capture_of, made_by, make_dive
from studies.accuracy_cost.mapping.knobs import PROFILE_FOLDER, profile
from studies.accuracy_cost.mapping.measuring import drive
from studies.accuracy_cost.mapping.metrics import BINS, reliability, sampled
from studies.accuracy_cost.study import StudyDive

__all__ = ["FILE", "curve_of", "estimates_and_truth", "fit", "table", "written"]

FILE = PROFILE_FOLDER / "calibration" / "harbour.yaml"
STEPS = 60
FINE, FINE_TO = 0.2, 4.0
MIN_COUNT = 50
"""Groups of voxels that the curve begins from: so many of equal numbers, cut at steps of log-odds
where probabilities differ, none with fewer voxels."""
KEPT = 0.02
"""Log-odds by which the points of the file may differ from the fit."""
HEAD = """\
# Turns the probabilities of a map into shares: `mapperctl convert --calibration`,
# docs/guides/export.md.
"""
HARBOUR = """\
# For the profile survey and a sonar that looks ahead into a harbour; fitted by
# python -m studies calibration --write"""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def fit(log_odds: Floats, solid: Bools) -> ProbabilityCalibration:
    """The curve that never falls and is nearest to the shares (pool adjacent violators).

    Args:
        log_odds: of voxels (N,), as a map has them.
        solid: which of them hold something (N,).
    """
    groups = _groups(log_odds)
    middles = np.array([log_odds[group].mean() for group in groups])
    solids = np.array([solid[group].sum() for group in groups], dtype=np.float64)
    return curve_of(middles, np.array([float(len(group)) for group in groups]), solids)


def curve_of(log_odds: Floats, voxels: Floats, solids: Floats) -> ProbabilityCalibration:
    """The same curve from groups of voxels.

    Args:
        log_odds: mean of each group (N,), rising.
        voxels: number of each (N,), or weight.
        solids: of those, solid (N,).
    """
    pools: list[tuple[float, float, int]] = []  # solid voxels, voxels, groups
    for some, number in zip(solids, voxels, strict=True):
        pools.append((float(some), float(number), 1))
        while len(pools) > 1 and pools[-2][0] * pools[-1][1] >= pools[-1][0] * pools[-2][1]:
            last, before = pools.pop(), pools.pop()
            pools.append((before[0] + last[0], before[1] + last[1], before[2] + last[2]))
    share = np.concatenate([np.full(n, (solids + 1) / (all_ + 2)) for solids, all_, n in pools])
    share = np.maximum.accumulate(share)  # adding one solid and one free voxel may bend it
    return ProbabilityCalibration(log_odds, np.log(share / (1 - share)))


def _groups(log_odds: Floats) -> list[NDArray[np.int64]]:
    """Voxels of about equal log-odds, in rising order: by number, and finer where few are."""
    many = np.quantile(log_odds, np.linspace(0.0, 1.0, STEPS), method="nearest")
    edges = np.unique(np.concatenate([many, np.arange(-FINE_TO, FINE_TO + FINE, FINE)]))
    place = np.searchsorted(edges, log_odds)  # voxels alike, such as seen free once, stay together
    groups: list[NDArray[np.int64]] = []
    for i in np.unique(place):
        group = np.flatnonzero(place == i)
        if groups and len(groups[-1]) < MIN_COUNT:
            group = np.concatenate([groups.pop(), group])
        groups.append(group)
    return groups


def estimates_and_truth(dive: StudyDive, folder: Path) -> tuple[Floats, Bools]:
    """Log-odds of a dive's voxels with the profile `survey`, and which of them are solid."""
    made = made_by(dive)
    sonar_map = drive(profile("survey"), made, capture_of(dive, folder)).map
    centres_m, log_odds, _ = sonar_map.core.voxels()
    chosen = sampled(centres_m, sonar_map.resolution_m)
    solid = made.world.touched(centres_m[chosen], sonar_map.resolution_m)
    return log_odds[chosen].astype(np.float64), solid


def table(log_odds: Floats, solid: Bools, curve: ProbabilityCalibration) -> str:
    """Predicted and true shares before and after, Markdown."""
    raw = reliability(log_odds, solid)
    mended = reliability(curve.log_odds_of(log_odds), solid)
    lines = ["| p | voxels | mean | solid | voxels, calibrated | mean | solid |"]
    lines.append("|---|---:|---:|---:|---:|---:|---:|")
    for i in range(BINS):
        cells = [f"{i / 10:g} to {(i + 1) / 10:g}"]
        for found in (raw, mended):
            share = [
                f"{v:.2f}" if found.counts[i] else ""
                for v in (found.probability[i], found.solid[i])
            ]
            cells += [f"{found.counts[i]}", *share]
        lines.append(f"| {' | '.join(cells)} |")
    errors = [f"{v:.3f}" for v in (raw.expected, raw.worst, mended.expected, mended.worst)]
    lines += ["", "expected {}, worst bin {}; calibrated {} and {}".format(*errors)]
    return "\n".join(lines)


def written(curve: ProbabilityCalibration, origin: str) -> str:
    """The curve as a file, without points that its neighbours in the file stand for.

    Args:
        curve: of any number of points.
        origin: comments on where it comes from.
    """
    chosen = [0]
    for i in range(1, len(curve.log_odds) - 1):
        between = slice(chosen[-1], i + 2)
        ends = [chosen[-1], i + 1]
        line = np.interp(curve.log_odds[between], curve.log_odds[ends], curve.calibrated[ends])
        if np.abs(line - curve.calibrated[between]).max() > KEPT:
            chosen.append(i)
    chosen.append(len(curve.log_odds) - 1)
    lines = [HEAD + origin]
    for name, values in (("log_odds", curve.log_odds), ("calibrated", curve.calibrated)):
        text = ", ".join(f"{value:.4f}" for value in values[chosen])
        lines += textwrap.wrap(f"{name}: [{text}]", 100, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Fit, judge, and write where asked."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--folder", type=Path, default=Path("out/accuracy-cost"))
    parser.add_argument("--write", action="store_true", help=f"write {FILE.name}")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    for dive in (FIT, *DIVES):
        make_dive(dive, args.folder)
    if args.write:
        FILE.write_text(written(fit(*estimates_and_truth(FIT, args.folder)), HARBOUR))
    curve = load_calibration(FILE)
    for dive in (FIT, *DIVES):
        print(
            f"{dive.name}:\n\n{table(*estimates_and_truth(dive, args.folder), curve)}\n", flush=True
        )


if __name__ == "__main__":
    main()
