"""What a client holds of the map, as the daemon's own blocks have it."""

import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd.client.mirror import MapMirror
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.server.map_source import MapSource
from mapperd.server.map_worker import next_frames
from mapperd.server.pacer import Pacer
from mapperd.server.priority_queue import SendSchedule
from mapperd.wire.blocks import UNKNOWN, decode_blocks
from mapperd.wire.framing import client_inbox
from mapperd.wire.messages import BLOCK_EDGE, BlocksMessage, Interest, MapInfo
from studies.accuracy_cost.streaming.truth import EDGE, UNIT, stream_keys

__all__ = [
    "PLAIN",
    "Made",
    "MapReader",
    "PlainClient",
    "PlainSender",
    "Sender",
    "StreamClient",
    "StreamSender",
]


PLAIN = np.dtype([("cell", "<i8"), ("p", "<f8")])
"""As many bytes as x, y, z and a probability in single precision; the study names cells instead."""

PIECE = 90
"""Plain cells in a message: a packet's worth."""


Made = tuple[bytes, float]
"""A message, and of when it is."""


class Sender(Protocol):
    """Sends a map to one client."""

    pacer: Pacer
    cpu_s: float

    @property
    def memory_bytes(self) -> int:
        """Of what it keeps of the map."""

    def info(self) -> MapInfo:
        """About the map."""

    def look(self, now_s: float, position_m: NDArray[np.float64]) -> None:
        """Find what changed."""

    def messages(self, now_s: float, position_m: NDArray[np.float64]) -> list[Made]:
        """What is to be sent now."""


@dataclass
class StreamSender:
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
        self._turns = SendSchedule(self.pacer)
        self._looked = False
        keep = MemoryPersistence(self.sonar_map)
        self._source = MapSource(self.sonar_map, keep, log_odds_step=self.log_odds_step)
        self._view = self._source.subscribe(self.interest)

    @property
    def memory_bytes(self) -> int:
        """As of `Sender`."""
        return self._source.memory_bytes

    def info(self) -> MapInfo:
        """As of `Sender`."""
        return self._source.info()

    def look(self, now_s: float, position_m: NDArray[np.float64]) -> None:
        """As of `Sender`."""
        began_s = time.thread_time()
        self._source.look(round(now_s * 1e9) + 1, position_m)
        self._looked = True
        self.cpu_s += time.thread_time() - began_s

    def messages(self, now_s: float, position_m: NDArray[np.float64]) -> list[Made]:
        """As of `Sender`; one round of `MapWorker`."""
        rooms = self._turns.rooms(now_s)
        if not rooms or not (self._looked or self._view.left):
            return []
        self._looked = False
        began_s = time.thread_time()
        x, y, z = position_m.tolist()
        frames = next_frames(self._view, rooms, (x, y, z))
        for frame, _, near_left in frames:
            if near_left is None:
                self._turns.sent_far()
            else:
                self._turns.sent_near(len(frame), near_left, now_s)
            self.pacer.note_sent(len(frame), now_s)
        self._view.settle(self._view.number)
        self.cpu_s += time.thread_time() - began_s
        return [(frame, now_s) for frame, _, _ in frames]


class PlainSender:
    """Every changed voxel as four floats, in the order of the changes: what is simplest.

    Args:
        sonar_map: map to send.

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
        """As of `Sender`."""
        seen = sum(block.nbytes for block in self._seen.values())
        return seen + sum(len(message) for message, _ in self._waiting)

    def info(self) -> MapInfo:
        """As of `Sender`."""
        return self._source.info()

    def look(self, now_s: float, position_m: NDArray[np.float64]) -> None:  # noqa: ARG002 plain
        """As of `Sender`."""
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
        """As of `Sender`: all that the connection takes."""
        sent = []
        while self._waiting and self.pacer.fits(len(self._waiting[0][0]), now_s):
            sent.append(self._waiting.popleft())
            self.pacer.note_sent(len(sent[-1][0]), now_s)
        return sent


Floats = NDArray[np.float32]


class MapReader(Protocol):
    """Reads messages."""

    def take(self, message: bytes) -> NDArray[np.int32]:
        """Read one; returns the keys (N, 3) of the blocks of the stream that it was about."""

    def probabilities(self, keys: NDArray[np.int32]) -> Floats:
        """(M, 4096) of the map's own blocks, x fastest; NaN where nothing is known."""


class StreamClient:
    """Of the map stream.

    Args:
        info: of the map.
        interest: what to send.
    """

    def __init__(self, info: MapInfo, interest: Interest) -> None:
        self._inbox = client_inbox()
        self._mirror = MapMirror(info, interest)
        self._interest = interest
        self._values = _values(info, interest)

    def take(self, message: bytes) -> NDArray[np.int32]:
        """As of `MapReader`."""
        (received,) = self._inbox.feed(message)
        if not isinstance(received, BlocksMessage) or not received.body:
            return np.zeros((0, 3), np.int32)
        blocks = decode_blocks(received.body, counts=self._interest.detail == "counts")
        self._mirror.put(blocks, received.stamp_ns)
        return blocks.keys

    def probabilities(self, keys: NDArray[np.int32]) -> Floats:
        """As of `MapReader`: a cell is all of its voxels."""
        level = self._interest.level
        of = stream_keys(keys, level)
        cells = self._mirror.cells_of(of.reshape(-1, 3)).reshape(-1, *(BLOCK_EDGE,) * 3)
        if level == 0:
            whole = cells.reshape(-1, 2, 2, 2, 8, 8, 8).transpose(0, 1, 4, 2, 5, 3, 6)
            return self._of(whole.reshape(len(keys), -1))
        size = 2**level
        edge = EDGE // size
        first = (keys & (2 ** (level - 1) - 1)) * edge
        at = first[:, :, None] + np.arange(edge)
        row = np.arange(len(keys))[:, None, None, None]
        part = cells[row, at[:, 2, :, None, None], at[:, 1, None, :, None], at[:, 0, None, None, :]]
        for axis in (1, 2, 3):
            part = part.repeat(size, axis=axis)
        return self._of(part.reshape(len(keys), -1))

    def _of(self, cells: NDArray[np.int8]) -> Floats:
        return np.asarray(self._values[cells.astype(np.intp) + 128])


class PlainClient:
    """Of plain floats."""

    def __init__(self) -> None:
        self._held: dict[bytes, Floats] = {}

    def take(self, message: bytes) -> NDArray[np.int32]:
        """As of `MapReader`."""
        name, rows = message[:12], np.frombuffer(message, PLAIN, offset=12)
        if name not in self._held:
            self._held[name] = np.full(EDGE**3, math.nan, np.float32)
        self._held[name][rows["cell"]] = rows["p"]
        key = np.frombuffer(name, np.int32).reshape(1, 3)
        return stream_keys(key, 0).reshape(-1, 3).astype(np.int32)

    def probabilities(self, keys: NDArray[np.int32]) -> Floats:
        """As of `MapReader`."""
        nothing = np.full(EDGE**3, math.nan, np.float32)
        return np.stack([self._held.get(key.tobytes(), nothing) for key in keys])


def _values(info: MapInfo, interest: Interest) -> Floats:
    """(256,) probabilities of sent values from -128 on; a class is a step beyond its threshold."""
    steps = np.arange(-128, 128)
    log_odds = steps * info.log_odds_step
    if interest.detail == "classes":
        low = info.free_log_odds - info.log_odds_step
        high = info.occupied_log_odds + info.log_odds_step
        middle = (info.free_log_odds + info.occupied_log_odds) / 2
        log_odds = np.choose(np.clip(steps, -1, 1) + 1, [low, middle, high])
    values = (1 / (1 + np.exp(-log_odds))).astype(np.float32)
    values[steps == UNKNOWN] = math.nan
    return np.asarray(values)
