"""What a client is told of the map: by the map stream, or as plain floats."""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.server.map_source import MapSource
from mapperd.server.map_worker import next_frames
from mapperd.server.pacer import Pacer
from mapperd.server.schedule import Turns
from mapperd.wire.messages import Interest, MapFacts
from studies.accuracy_cost.streaming.truth import UNIT

__all__ = ["PLAIN", "Made", "PlainTeller", "StreamTeller", "Teller"]

PLAIN = np.dtype([("cell", "<i8"), ("p", "<f8")])
"""As many bytes as x, y, z and a probability in single precision; the study names cells instead."""

PIECE = 90
"""Plain cells in a message: a packet's worth."""


Made = tuple[bytes, float]
"""A message, and of when it is."""


class Teller(Protocol):
    """Tells one client of a map."""

    pacer: Pacer
    cpu_s: float

    @property
    def memory_bytes(self) -> int:
        """Of what it keeps of the map."""

    def facts(self) -> MapFacts:
        """About the map."""

    def look(self, now_s: float, position_m: NDArray[np.float64]) -> None:
        """Find what changed."""

    def messages(self, now_s: float, position_m: NDArray[np.float64]) -> list[Made]:
        """What is to be sent now."""


@dataclass
class StreamTeller:
    """The map stream's own source, pacer and turns.

    Attributes:
        cpu_s: of the looks and of making messages.
    """

    sonar_map: SonarMap
    interest: Interest
    log_odds_step: float
    bytes_per_s: int
    cpu_s: float = 0.0
    pacer: Pacer = field(init=False)

    def __post_init__(self) -> None:
        """Connect."""
        self.pacer = Pacer(self.bytes_per_s)
        self._turns = Turns(self.pacer)
        self._looked = False
        keep = MemoryPersistence(self.sonar_map)
        self._source = MapSource(self.sonar_map, keep, log_odds_step=self.log_odds_step)
        self._view = self._source.subscribe(self.interest)

    @property
    def memory_bytes(self) -> int:
        """As of `Teller`."""
        return self._source.memory_bytes

    def facts(self) -> MapFacts:
        """As of `Teller`."""
        return self._source.facts()

    def look(self, now_s: float, position_m: NDArray[np.float64]) -> None:
        """As of `Teller`."""
        began_s = time.thread_time()
        self._source.look(round(now_s * 1e9) + 1, position_m)
        self._looked = True
        self.cpu_s += time.thread_time() - began_s

    def messages(self, now_s: float, position_m: NDArray[np.float64]) -> list[Made]:
        """As of `Teller`; a round as `MapRounds` has it."""
        rooms = self._turns.rooms(now_s)
        if not rooms or not (self._looked or self._view.left):
            return []
        self._looked = False
        began_s = time.thread_time()
        x, y, z = position_m.tolist()
        frames = next_frames(self._view, rooms, (x, y, z))
        for frame, _, near_left in frames:
            if near_left is None:
                self._turns.told_far()
            else:
                self._turns.told_near(len(frame), near_left, now_s)
            self.pacer.note_sent(len(frame), now_s)
        self._view.settle(self._view.number)
        self.cpu_s += time.thread_time() - began_s
        return [(frame, now_s) for frame, _, _ in frames]


class PlainTeller:
    """Every changed voxel as four floats, in the order of the changes: what is simplest.

    Args:
        sonar_map: that is told.

    Attributes:
        cpu_s: of finding and of packing; by numpy, so only roughly what a program would take.
    """

    def __init__(self, sonar_map: SonarMap) -> None:
        self.cpu_s = 0.0
        self.pacer = Pacer()
        self._map = sonar_map
        self._source = MapSource(sonar_map, MemoryPersistence(sonar_map))
        self._seen: dict[bytes, NDArray[np.int32]] = {}
        self._waiting: deque[Made] = deque()

    @property
    def memory_bytes(self) -> int:
        """As of `Teller`."""
        seen = sum(block.nbytes for block in self._seen.values())
        return seen + sum(len(message) for message, _ in self._waiting)

    def facts(self) -> MapFacts:
        """As of `Teller`."""
        return self._source.facts()

    def look(self, now_s: float, position_m: NDArray[np.float64]) -> None:  # noqa: ARG002 plain
        """As of `Teller`."""
        began_s = time.thread_time()
        keys, units, counts = self._map.core.blocks()
        for key, block, count in zip(keys, units, counts, strict=True):
            name = key.tobytes()
            before = self._seen.get(name)
            changed = (count > 0) & (True if before is None else block != before)
            (cells,) = np.nonzero(changed)
            if len(cells):
                self._seen[name] = block.copy()
                rows = np.zeros(len(cells), PLAIN)
                rows["cell"] = cells
                rows["p"] = 1 / (1 + np.exp(-block[cells] * UNIT))
                parts = np.array_split(rows, -(-len(rows) // PIECE))
                self._waiting.extend((name + part.tobytes(), now_s) for part in parts)
        self.cpu_s += time.thread_time() - began_s

    def messages(self, now_s: float, position_m: NDArray[np.float64]) -> list[Made]:  # noqa: ARG002
        """As of `Teller`: all that the connection takes."""
        said = []
        while self._waiting and self.pacer.fits(len(self._waiting[0][0]), now_s):
            said.append(self._waiting.popleft())
            self.pacer.note_sent(len(said[-1][0]), now_s)
        return said
