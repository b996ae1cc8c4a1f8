"""All that one run of the benchmark measures, and the figures derived from it."""

import statistics
from pathlib import Path

import msgspec
import numpy as np

HELD_VOXEL_BYTES = 3
"""Our voxel where a block stores each of its own: 2 bytes of log-odds and 1 of count."""


class ContenderResult(msgspec.Struct, frozen=True):
    """One contender on the pings of one case.

    Attributes:
        ms: of each ping of the first pass, in order; fewer pings if the budget ran out.
        second_ms: of the same pings, integrated again into the same map.
        touched: distinct voxels that each ping of the first pass changed, where counted.
        memory_bytes: of the map after the first pass.
        known_voxels: in the map after the first pass.
        held_voxels: stored one by one after the first pass; 0 if the map does not report them.
        start_rss_bytes: of the process before its first ping.
        peak_rss_bytes: of the process after the first pass.
        resting_ms, moving_ms: of each ping without and with motion, alternating, into two further
            empty maps; empty if not measured.
    """

    ms: list[float]
    second_ms: list[float]
    touched: list[int | None]
    memory_bytes: int
    known_voxels: int
    start_rss_bytes: int
    peak_rss_bytes: int
    held_voxels: int = 0
    resting_ms: list[float] = []
    moving_ms: list[float] = []

    @property
    def median_ms(self) -> float:
        """Median of the first pass."""
        return statistics.median(self.ms)

    @property
    def p95_ms(self) -> float:
        """95th percentile of the first pass."""
        return p95(self.ms)

    @property
    def second_median_ms(self) -> float:
        """Median of the second pass: the steady state."""
        return statistics.median(self.second_ms)

    @property
    def first_ping_ratio(self) -> float:
        """The first ping, into an empty map, by the median."""
        return self.ms[0] / self.median_ms

    @property
    def motion_ratio(self) -> float | None:
        """Median with motion by the median without; None if not measured."""
        if not self.moving_ms:
            return None
        return statistics.median(self.moving_ms) / statistics.median(self.resting_ms)

    @property
    def touched_a_ping(self) -> float:
        """Mean of the pings whose voxels were counted."""
        return statistics.mean(self._counted().values())

    @property
    def ns_a_voxel(self) -> float:
        """Time by voxels, over the pings whose voxels were counted."""
        counted = self._counted()
        return 1e6 * sum(self.ms[i] for i in counted) / max(sum(counted.values()), 1)

    @property
    def bytes_a_voxel(self) -> float:
        """Of the whole map, by its known voxels."""
        return self.memory_bytes / max(self.known_voxels, 1)

    @property
    def bytes_a_held_voxel(self) -> float | None:
        """Of the whole map, by the voxels that it stores one by one; None if not reported."""
        return self.memory_bytes / self.held_voxels if self.held_voxels else None

    def memory_share(self, bytes_a_second: float) -> float:
        """Share of the median that reading and writing each touched voxel once would take."""
        return 1e3 * self.touched_a_ping * 2 * HELD_VOXEL_BYTES / bytes_a_second / self.median_ms

    def _counted(self) -> dict[int, int]:
        return {i: n for i, n in enumerate(self.touched) if n is not None}


class DetailDifference(msgspec.Struct, frozen=True):
    """How far `detail` 1 lies from the converged grid, over the voxels that either map knows.

    Attributes:
        pings, voxels: compared.
        class_share: whose class (unknown, free, uncertain, occupied) differs.
        one_only_share: that only one of the maps knows.
        mean: of the absolute difference in log-odds; unknown is 0.
    """

    pings: int
    voxels: int
    class_share: float
    one_only_share: float
    mean: float


class Machine(msgspec.Struct, frozen=True):
    """Where, and from what, the figures were measured.

    Attributes:
        load: mean number of running processes in the minute before.
        bytes_a_second: of streaming read-modify-write, one thread, read and written bytes counted.
    """

    cpu: str
    cores: int
    compiler: str
    commit: str
    load: float
    bytes_a_second: float


class CaseResult(msgspec.Struct, frozen=True):
    """One look, range and voxel size.

    Attributes:
        loud_share: share of the pixels above the map's intensity threshold.
        runs: by name of the contender.
        detail: None if not measured.
    """

    name: str
    look: str
    range_m: float
    resolution_m: float
    loud_share: float
    runs: dict[str, ContenderResult]
    detail: DetailDifference | None = None

    @property
    def size(self) -> str:
        """Range and voxel size for people."""
        return f"{self.range_m:g} m, {100 * self.resolution_m:g} cm"


class BenchResults(msgspec.Struct, frozen=True):
    """A whole run.

    Attributes:
        open_water: milliseconds a ping by range in metres; empty if not measured.
    """

    command: str
    pings: int
    seed: int
    machine: Machine
    cases: list[CaseResult]
    open_water: dict[str, float]

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_bytes(msgspec.json.format(msgspec.json.encode(self), indent=1))


def times_faster(ours: ContenderResult, theirs: ContenderResult) -> float:
    """Ratio of the medians, over the pings that both integrated."""
    both = min(len(ours.ms), len(theirs.ms))
    return statistics.median(theirs.ms[:both]) / statistics.median(ours.ms[:both])


def p95(values: list[float]) -> float:
    """95th percentile."""
    return float(np.percentile(values, 95))


def figure(value: float) -> str:
    """A number for people: three digits, or all whole ones."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"  # noqa: PLR2004 three digits
