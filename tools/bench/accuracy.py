"""How far sampling, and our default error bound, lie from the exact map; prints JSON.

Each ping is integrated into an empty map of each kind, so that the differences are those of one
observation.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
from bench_pings import load
from numpy.typing import NDArray
from our_settings import add_arguments, config_of, print_json

from mapperd.mapping import SonarMap

EVERY = 5
"""Every so many pings one is compared."""
UNIT = 2.0**-24
"""Of the log-odds that the map gives; see docs/mapping.md."""
CLASSES = 4
LEAST, MOST, BINS = -9.0, 2.0, 2200
"""Decimal logarithms of differences, in bins of 1.2 %."""
BLOCKS_AT_ONCE = 512

Units = NDArray[np.int32]
Counts = NDArray[np.uint16]


class Accuracy(msgspec.Struct, frozen=True):
    """Over the voxels that at least one of two maps knows.

    Attributes:
        pings, voxels: compared.
        class_share: whose class (unknown, free, uncertain, occupied) differs.
        one_only_share: that only one of the maps knows.
        mean, p95: of the absolute difference in log-odds; unknown is 0.
        mean_of_shared: over the voxels that both know.
    """

    pings: int
    voxels: int
    class_share: float
    one_only_share: float
    mean: float
    p95: float
    mean_of_shared: float


@dataclass(slots=True)
class Difference:
    """Collects differences in log-odds and in class."""

    free_below: float
    occupied_above: float
    pings: int = 0
    voxels: int = 0
    one_only: int = 0
    other_class: int = 0
    total: float = 0.0
    shared_total: float = 0.0
    histogram: NDArray[np.int64] = field(default_factory=lambda: np.zeros(BINS, dtype=np.int64))

    def add(self, one: SonarMap, other: SonarMap) -> None:
        """Compare two maps of one ping."""
        self.pings += 1
        for (units_a, count_a), (units_b, count_b) in _paired_blocks(one, other):
            known = (count_a > 0) | (count_b > 0)
            shared = ((count_a > 0) & (count_b > 0))[known]
            a, b = (
                np.where(count[known] > 0, UNIT * units[known], 0.0)
                for units, count in ((units_a, count_a), (units_b, count_b))
            )
            differs = self._class(a, count_a[known]) != self._class(b, count_b[known])
            self.other_class += int(np.count_nonzero(differs))
            self._collect(np.abs(a - b), shared)

    def result(self) -> Accuracy:
        """Sum up."""
        voxels, shared = max(self.voxels, 1), max(self.voxels - self.one_only, 1)
        bin_95 = int(np.searchsorted(np.cumsum(self.histogram), 0.95 * self.voxels))
        p95 = 10.0 ** (LEAST + (bin_95 + 0.5) * (MOST - LEAST) / BINS) if bin_95 else 0.0
        return Accuracy(
            pings=self.pings,
            voxels=self.voxels,
            class_share=self.other_class / voxels,
            one_only_share=self.one_only / voxels,
            mean=self.total / voxels,
            p95=p95,
            mean_of_shared=self.shared_total / shared,
        )

    def _class(self, log_odds: NDArray[np.float64], count: Counts) -> NDArray[np.int64]:
        limits = [self.free_below, self.occupied_above]
        return np.where(count > 0, 1 + np.searchsorted(limits, log_odds), 0)

    def _collect(self, difference: NDArray[np.float64], shared: NDArray[np.bool_]) -> None:
        self.voxels += difference.size
        self.one_only += int(np.count_nonzero(~shared))
        self.total += float(difference.sum())
        self.shared_total += float(difference[shared].sum())
        exponent = np.log10(np.maximum(difference, 10.0**LEAST))
        bins = ((exponent - LEAST) * (BINS / (MOST - LEAST))).astype(np.int64)
        self.histogram += np.bincount(np.clip(bins, 0, BINS - 1), minlength=BINS)


def _paired_blocks(
    one: SonarMap, other: SonarMap
) -> Iterator[tuple[tuple[Units, Counts], tuple[Units, Counts]]]:
    """Blocks of equal keys, some at a time; where a map has none, one of unknown voxels."""
    stores = [one.core.blocks(), other.core.blocks()]
    names = [_names(keys) for keys, _, _ in stores]
    union = np.union1d(*names)
    for begin in range(0, len(union), BLOCKS_AT_ONCE):
        wanted = union[begin : begin + BLOCKS_AT_ONCE]
        yield _select(stores[0], names[0], wanted), _select(stores[1], names[1], wanted)


def _names(keys: NDArray[np.int32]) -> NDArray[np.int64]:
    """One number a block."""
    shifted = keys.astype(np.int64) + (1 << 20)
    named: NDArray[np.int64] = shifted[:, 0] << 42 | shifted[:, 1] << 21 | shifted[:, 2]
    return named


def _select(
    store: tuple[NDArray[np.int32], Units, Counts],
    names: NDArray[np.int64],
    wanted: NDArray[np.int64],
) -> tuple[Units, Counts]:
    _, units, count = store
    order = np.argsort(names)
    _, from_place, to_place = np.intersect1d(names[order], wanted, return_indices=True)
    shape = (len(wanted), *units.shape[1:])
    found_units, found_count = np.zeros(shape, units.dtype), np.zeros(shape, count.dtype)
    found_units[to_place] = units[order[from_place]]
    found_count[to_place] = count[order[from_place]]
    return found_units, found_count


def compare(
    pings_file: Path, resolution_m: float, budget_s: float, *, first_returns_only: bool
) -> dict[str, Accuracy]:
    """Compare `rays` and the default with the exact map, ping by ping."""
    pings = load(pings_file)
    differences = {way: _difference(resolution_m) for way in ("rays", "default")}
    began_s = time.perf_counter()
    for i in range(0, len(pings), EVERY):
        if time.perf_counter() - began_s > budget_s:
            break
        echo = pings.echo(i, first_returns_only=first_returns_only)
        maps = {way: SonarMap(config_of(way, resolution_m)) for way in ("exact", *differences)}
        for sonar_map in maps.values():
            sonar_map.integrate(echo, pings.map_T_sonar[i])
        for way, difference in differences.items():
            difference.add(maps["exact"], maps[way])
    return {way: difference.result() for way, difference in differences.items()}


def _difference(resolution_m: float) -> Difference:
    mapping = config_of("exact", resolution_m).mapping
    limits = np.array([mapping.free_threshold, mapping.occupied_threshold])
    free_below, occupied_above = np.log(limits / (1.0 - limits))
    return Difference(float(free_below), float(occupied_above))


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    said = parser.parse_args()
    print_json(
        compare(
            Path(said.pings),
            said.resolution_m,
            said.budget_s,
            first_returns_only=said.first_returns,
        )
    )


if __name__ == "__main__":
    main()
