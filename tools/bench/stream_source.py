"""What the map stream costs: bytes a changed voxel, and processor time, on a recorded dive.

The recording is mapped as fast as it can be; at each tick of its own clock clients are sent all
that changed; bytes are those of one. The measure of bytes is a message of the same with x, y, z and
a probability as four float32 each voxel: every voxel whose value or count is another than at the
tick before, and, in brackets, those alone whose quantised value is. Prints the tables.

Usage: python -m bench stream-source [RECORDING] [--config FILE]
"""

import argparse
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config.loader import load_config
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.server.map_source import MapSource
from mapperd.server.subscription import Subscription
from mapperd.session.replay import Replay, Window
from mapperd.wire.messages import Interest
from oculus_driver.recording import Chunk, open_recording

STEPS = (0.1, 0.25, 0.5)
RATES_HZ = (5.0, 0.5)
PLAIN_BYTES = 16
MAX_BYTES = 1 << 20
BLOCKS = 100_000
BLOCK_VOXELS = 16
LOG_ODDS_UNIT = 2.0**-24
"""Of the map's own values."""

Blocks = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.uint16]]


@dataclass
class ViewedDive:
    """One client's view of a dive.

    Attributes:
        others: clients that are sent the same.
        sent_bytes, messages: that it was sent.
        look_s, encode_s: processor time of the looks, and of making messages.
        max_s: of the longest tick.
        ticks: so many.
    """

    source: MapSource
    client: Subscription
    others: list[Subscription]
    sent_bytes: int = 0
    messages: int = 0
    look_s: float = 0.0
    encode_s: float = 0.0
    max_s: float = 0.0
    ticks: int = 0

    def tick(self, now_ns: int) -> None:
        """Find and send what changed."""
        began_s = time.process_time()
        self.source.look(now_ns)
        looked_s = time.process_time()
        while (message := self.client.next(None, MAX_BYTES)) is not None:
            self.sent_bytes += len(message)
            self.messages += 1
        for other in self.others:
            while other.next(None, MAX_BYTES) is not None:
                pass
        ended_s = time.process_time()
        self.look_s += looked_s - began_s
        self.encode_s += ended_s - looked_s
        self.max_s = max(self.max_s, ended_s - began_s)
        self.ticks += 1


@dataclass
class Changes:
    """Voxels that differ from tick to tick, by brute force."""

    step: float
    changed: int = 0
    sent: int = 0
    _seen: dict[bytes, tuple[NDArray[np.int32], NDArray[np.uint16]]] = field(default_factory=dict)

    def tick(self, blocks: Blocks) -> None:
        """Compare with the blocks of the tick before."""
        for key, units, counts in zip(*blocks, strict=True):
            name = key.tobytes()
            old_units, old_counts = self._seen.get(name, (0 * units, 0 * counts))
            self.changed += int(((units != old_units) | (counts != old_counts)).sum())
            known = (counts > 0) != (old_counts > 0)
            steps = np.rint(units * (LOG_ODDS_UNIT / self.step))
            before = np.rint(old_units * (LOG_ODDS_UNIT / self.step))
            self.sent += int((known | (steps != before)).sum())
            self._seen[name] = units, counts


def dive(
    recording: Path, config: Config, steps: tuple[float, ...], rate_hz: float, clients: int = 1
) -> None:
    """Map the dive once, for so many clients of each step; prints their rows."""
    sonar_map = SonarMap(config)
    period_ns = round(1e9 / rate_hz)
    watched, changes = [], []
    for step in steps:
        source = MapSource(sonar_map, MemoryPersistence(sonar_map), log_odds_step=step)
        first, *others = [source.subscribe(Interest()) for _ in range(clients)]
        watched.append(ViewedDive(source, first, others))
        changes.append(Changes(step))
    clock = _RecordingClock()
    next_ns = 0

    def tick() -> None:
        blocks = sonar_map.core.blocks()
        for one, count in zip(watched, changes, strict=True):
            one.tick(clock.now_ns)
            count.tick(blocks)

    with open_recording(recording) as chunks:
        replay = Replay(sonar_map, OdometryPoses(config), Window(), time.perf_counter)
        for _ in replay.run(clock.watching(chunks)):
            if clock.now_ns >= next_ns:
                next_ns = clock.now_ns + period_ns
                tick()
        tick()
    for step, one, count in zip(steps, watched, changes, strict=True):
        seconds = clock.seconds
        print(
            f"{clients:7d} {rate_hz:4.1f} {step:5.2f} {one.sent_bytes:10d}"
            f" {one.sent_bytes / seconds / 1e3:7.1f}"
            f" {count.changed:10d} {one.sent_bytes / count.changed:6.2f}"
            f" ({one.sent_bytes / max(count.sent, 1):5.2f})"
            f" {PLAIN_BYTES * count.changed / one.sent_bytes:6.1f}"
            f" ({PLAIN_BYTES * count.sent / one.sent_bytes:5.1f})"
            f" {1e3 * one.look_s / one.ticks:6.2f} {1e3 * one.encode_s / one.ticks:6.2f}"
            f" {1e3 * one.max_s:6.1f} {100 * (one.look_s + one.encode_s) / seconds:5.2f}"
            f" {100 * one.source.memory_bytes / sonar_map.memory_bytes:5.1f}"
        )


class _RecordingClock:
    """The time of the recording."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.first_ns: int | None = None

    @property
    def seconds(self) -> float:
        return (self.now_ns - (self.first_ns or 0)) / 1e9

    def watching(self, chunks: Iterable[Chunk]) -> Iterator[Chunk]:
        """Chunks that report the time as they pass."""
        for chunk in chunks:
            if chunk.arrival_ns is not None:
                self.now_ns = max(self.now_ns, chunk.arrival_ns)
                self.first_ns = self.first_ns or chunk.arrival_ns
            yield chunk


def large_map() -> None:
    """A scan of many blocks for the few that changed."""
    sonar_map = SonarMap(Config())
    edge = round(BLOCKS ** (1 / 3)) + 1
    grid = np.stack(np.unravel_index(np.arange(BLOCKS), (edge,) * 3), axis=-1) - edge // 2
    centres = (grid * BLOCK_VOXELS + 0.5) * sonar_map.resolution_m
    for part in np.array_split(centres, 100):
        sonar_map.core.set_log_odds(np.ascontiguousarray(part), np.full(len(part), 2.0))
    nothing = np.zeros((0, 3), np.int32)
    spent_s = []
    for value in range(20):
        since = sonar_map.core.revision
        sonar_map.core.set_log_odds(centres[:50], np.full(50, 1.0 + value))
        began_s = time.process_time()
        sonar_map.core.changed_blocks(since, nothing)
        spent_s.append(time.process_time() - began_s)
    print(f"changed blocks of {sonar_map.core.block_count}: {1e3 * np.median(spent_s):.2f} ms")


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, nargs="?", default=Path("out/demo/capture.bin"))
    parser.add_argument("--config", type=Path, default=Path("config/demo.yaml"))
    arguments = parser.parse_args()
    config = load_config(arguments.config)
    print(
        "clients   Hz  step      bytes    kB/s    changed  B/voxel        times smaller  look ms"
        " send ms most ms  core % memory %"
    )
    for rate_hz in RATES_HZ:
        dive(arguments.recording, config, STEPS, rate_hz)
    dive(arguments.recording, config, (0.25,), 5.0, clients=20)
    large_map()


if __name__ == "__main__":
    main()
