"""The converged map: the finest evidence grid, with all beams and rows.

Poses are interpolated and samples placed at their own time of flight. It is what a setting's
log-odds are compared with, wherever the setting leaves the grid and the rule of update as they
are; those of another rule mean something else.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.mapping.sonar_map import SonarMap
from studies.accuracy_cost.mapping.dives import capture_of, made_by, once
from studies.accuracy_cost.mapping.driving import Driven, drive
from studies.accuracy_cost.mapping.settings import config_for
from studies.accuracy_cost.study import Dive, Setting

__all__ = [
    "CONVERGED",
    "log_odds_error",
    "make_oracle",
    "mean_difference",
    "oracle_of",
    "same_rule",
]

CONVERGED = Setting("converged", {"mapping.detail": 8.0})

OTHER_RULE = ("octree.", "iwlo.", "adaptive.", "filtering.", "sonar.", "mapping.aggregation")
"""Settings that change what the log-odds mean, not how well they are known."""

Voxels = tuple[NDArray[np.int64], NDArray[np.float64]]


def _files(dive: Dive, folder: Path) -> tuple[Path, Path]:
    """The map, and what it took."""
    name = f"mapping-{dive.name}-{dive.seed}-finest"
    return folder / f"{name}.map", folder / f"{name}.npz"


def make_oracle(dive: Dive, folder: Path) -> None:
    """Map a dive's capture with the finest evidence grid, unless that is done."""
    map_file, times_file = _files(dive, folder)
    if map_file.exists() and times_file.exists():
        return
    driven = drive(CONVERGED, made_by(dive), capture_of(dive, folder))
    map_part, times_part = once(map_file), once(times_file)
    driven.map.save(map_part)
    with times_part.open("wb") as stream:
        np.savez(stream, mapped_ms=driven.mapped_ms, pings=driven.pings)
    map_part.rename(map_file)
    times_part.rename(times_file)


def oracle_of(dive: Dive, folder: Path) -> Driven:
    """What `make_oracle` made."""
    map_file, times_file = _files(dive, folder)
    config, _ = config_for(CONVERGED, made_by(dive))
    sonar_map = SonarMap(config)
    sonar_map.load(map_file)
    with np.load(times_file) as archive:
        return Driven(sonar_map, archive["mapped_ms"].tolist(), int(archive["pings"]))


def same_rule(setting: Setting, default: Setting) -> bool:
    """Whether the log-odds of two settings mean the same."""
    names = {*setting.overrides, *default.overrides}
    return not any(
        name.startswith(OTHER_RULE) and setting.overrides.get(name) != default.overrides.get(name)
        for name in names
    )


def log_odds_error(sonar_map: SonarMap, dive: Dive, folder: Path) -> float:
    """Mean absolute difference of log-odds from the converged map's, over voxels of either."""
    return mean_difference(_known(sonar_map), _known(oracle_of(dive, folder).map))


def mean_difference(one: Voxels, other: Voxels) -> float:
    """Of log-odds, absolute, over all voxels of either; what is not known has 0.

    Args:
        one: keys (N,), each once, and log-odds (N,).
        other: the same of another map.
    """
    _, here, there = np.intersect1d(one[0], other[0], assume_unique=True, return_indices=True)
    total = np.abs(one[1]).sum() + np.abs(other[1]).sum()
    total -= np.abs(one[1][here]).sum() + np.abs(other[1][there]).sum()
    total += np.abs(one[1][here] - other[1][there]).sum()
    return float(total / max(len(one[0]) + len(other[0]) - len(here), 1))


def _known(sonar_map: SonarMap) -> Voxels:
    centres_m, log_odds, _ = sonar_map.core.voxels()
    place = np.floor(centres_m / sonar_map.resolution_m).astype(np.int64) + (1 << 20)
    return place[:, 0] << 42 | place[:, 1] << 21 | place[:, 2], log_odds.astype(np.float64)
