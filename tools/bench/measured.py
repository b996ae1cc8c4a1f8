"""What one contender's run gives, and the figures made of it."""

import statistics
import subprocess
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

DENSE_VOXEL_BYTES = 6
"""Our voxel where a block holds each of its own: 4 bytes of log-odds and 2 of count."""


class Measured(msgspec.Struct, frozen=True):
    """One contender on the pings of one case.

    Attributes:
        ms: of each ping, in order; fewer than asked for when the time was up.
        touched: distinct voxels that each ping changed, where they were counted.
        memory_bytes: of the map after the last ping.
        known_voxels: in the map then.
        start_rss_bytes: of the process before its first ping.
        peak_rss_bytes: of the process after its last ping.
        finish_ms: what the map asks for once, after the last ping.
    """

    ms: list[float]
    touched: list[int | None]
    memory_bytes: int
    known_voxels: int
    start_rss_bytes: int
    peak_rss_bytes: int
    finish_ms: float = 0.0

    @property
    def median_ms(self) -> float:
        """Median of the pings."""
        return statistics.median(self.ms)

    @property
    def p95_ms(self) -> float:
        """95th percentile of the pings."""
        return float(np.percentile(self.ms, 95))

    @property
    def touched_a_ping(self) -> float:
        """Mean of the pings whose voxels were counted."""
        return statistics.mean(self._counted().values())

    @property
    def touched_a_second(self) -> float:
        """Voxels by time, over the pings whose voxels were counted."""
        counted = self._counted()
        return 1e3 * sum(counted.values()) / sum(self.ms[i] for i in counted)

    @property
    def ns_a_voxel(self) -> float:
        """Time by voxels, over the pings whose voxels were counted."""
        return 1e9 / self.touched_a_second

    @property
    def bytes_a_voxel(self) -> float:
        """Of the whole map, by its known voxels."""
        return self.memory_bytes / max(self.known_voxels, 1)

    def bound_ms(self, bytes_a_second: float) -> float:
        """Time to read and write each touched voxel once, at the memory's bandwidth."""
        return 1e3 * self.touched_a_ping * 2 * DENSE_VOXEL_BYTES / bytes_a_second

    def _counted(self) -> dict[int, int]:
        return {i: n for i, n in enumerate(self.touched) if n is not None}


def times_faster(ours: Measured, theirs: Measured) -> float:
    """Ratio of the medians, over the pings that both did."""
    both = min(len(ours.ms), len(theirs.ms))
    return statistics.median(theirs.ms[:both]) / statistics.median(ours.ms[:both])


def figure(value: float) -> str:
    """A number for people: three digits, or all whole ones."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"  # noqa: PLR2004 three digits


def status_bytes(name: str) -> int:
    """A line of /proc/self/status, such as VmHWM, in bytes."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) * 1024
    raise LookupError(name)


def run_json(command: Sequence[str | Path]) -> bytes:
    """Run a program in a process of its own; returns what it printed.

    Raises:
        RuntimeError: it failed; with what it said.
    """
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, check=False)  # noqa: S603 our own programs
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.decode(errors='replace').strip()}")
    return done.stdout
