"""How far the evidence grid at `mapping.detail` 1 lies from the converged grid; prints JSON.

Each ping is integrated into an empty map of each kind, so that the differences are those of one
observation.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from bench.inputs import load
from bench.our_contender import config_of
from bench.results import DetailDifference
from mapperd.mapping.sonar_map import SonarMap

CONVERGED = 8.0
EVERY = 5
"""One ping in this many is compared."""


@dataclass(slots=True)
class ClassDifference:
    """Sums up differences in log-odds and in class between pairs of maps.

    Attributes:
        free_below, occupied_above: log-odds that bound the classes.
    """

    free_below: float
    occupied_above: float
    pings: int = 0
    voxels: int = 0
    one_only: int = 0
    other_class: int = 0
    total: float = 0.0

    def add(self, one: SonarMap, other: SonarMap) -> None:
        """Compare two maps of one ping."""
        self.pings += 1
        centres_m, log_odds, _ = one.core.voxels()
        other_log_odds, other_count = other.core.query(centres_m)
        shared = other_count > 0
        self._add(log_odds[shared], other_log_odds[shared])
        self._add_unshared(log_odds[~shared])
        centres_m, log_odds, _ = other.core.voxels()
        _, count = one.core.query(centres_m)
        self._add_unshared(log_odds[count == 0])

    def result(self) -> DetailDifference:
        """Shares and mean of all that was added."""
        voxels = max(self.voxels, 1)
        return DetailDifference(
            pings=self.pings,
            voxels=self.voxels,
            class_share=self.other_class / voxels,
            one_only_share=self.one_only / voxels,
            mean=self.total / voxels,
        )

    def _add(self, a: NDArray[np.float32], b: NDArray[np.float32]) -> None:
        limits = [self.free_below, self.occupied_above]
        differs = np.searchsorted(limits, a) != np.searchsorted(limits, b)
        self.voxels += len(a)
        self.other_class += int(np.count_nonzero(differs))
        self.total += float(np.abs(a - b).sum(dtype=np.float64))

    def _add_unshared(self, log_odds: NDArray[np.float32]) -> None:
        self.voxels += len(log_odds)
        self.one_only += len(log_odds)
        self.other_class += len(log_odds)
        self.total += float(np.abs(log_odds).sum(dtype=np.float64))


def compare(pings_file: Path, resolution_m: float, budget_s: float) -> DetailDifference:
    """Compare the two on full images; begins no ping after the budget."""
    pings = load(pings_file)
    configs = [config_of("grid", resolution_m, detail=detail) for detail in (1.0, CONVERGED)]
    limits = np.array([configs[0].free_threshold, configs[0].occupied_threshold])
    difference = ClassDifference(*np.log(limits / (1.0 - limits)).tolist())
    began_s = time.perf_counter()
    for i in range(0, len(pings), EVERY):
        if time.perf_counter() - began_s > budget_s:
            break
        maps = [SonarMap(config) for config in configs]
        for sonar_map in maps:
            echo = pings.echo(i, first_returns_only=False)
            sonar_map.integrate(echo, pings.map_T_sonar[i])
        difference.add(*maps)
    return difference.result()


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pings", type=Path, help="file of bench_pings")
    parser.add_argument("resolution_m", type=float)
    parser.add_argument("budget_s", type=float, help="begins no ping after this")
    args = parser.parse_args()
    found = compare(args.pings, args.resolution_m, args.budget_s)
    print(msgspec.json.encode(found).decode())


if __name__ == "__main__":
    main()
