"""What clients should have been sent, worked out voxel by voxel, and a client of the map."""

import numpy as np
from numpy.typing import NDArray
from studies.stream.sent_steps import sent_steps

from mapperd import _core
from mapperd.client.mirror import MapMirror
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.server.map_source import MapSource
from mapperd.wire.blocks import CELLS, UNKNOWN, decode_blocks
from mapperd.wire.messages import (
    BLOCK_EDGE,
    BlocksMessage,
    Interest,
    MapInfo,
    ResetMessage,
    Resume,
)

SECOND_NS = 1_000_000_000
SentState = dict[tuple[int, ...], tuple[bytes, bytes]]


def expected(core: _core.VoxelMap, facts: MapInfo, interest: Interest) -> SentState:
    """Block to cells and counts, of a map that is in memory as a whole."""
    blocks, units, counts = core.blocks()
    edge = _core.BLOCK_EDGE
    local = np.stack(np.unravel_index(np.arange(edge**3), (edge,) * 3, order="F"), axis=-1)
    row, voxel = np.nonzero(counts)
    cell = (blocks[row].astype(np.int64) * edge + local[voxel]) >> interest.level
    log_odds = units[row, voxel] * _core.LOG_ODDS_UNIT + facts.prior_log_odds
    values = _values(np.asarray(log_odds, np.float64), facts, interest)
    keys, block_of = np.unique(cell // BLOCK_EDGE, axis=0, return_inverse=True)
    at = block_of.ravel(), (cell % BLOCK_EDGE) @ (1, BLOCK_EDGE, BLOCK_EDGE**2)
    cells = np.full((len(keys), CELLS), UNKNOWN, np.int8)
    np.maximum.at(cells, at, values)
    seen = np.zeros((len(keys), CELLS), np.int64)
    np.maximum.at(seen, at, counts[row, voxel])
    bits = np.array([count.bit_length() for count in range(2**16)], np.uint8)[seen]
    return {
        tuple(key.tolist()): (cells[i].tobytes(), _counts(bits[i], interest))
        for i, key in enumerate(keys)
    }


def _values(log_odds: NDArray[np.float64], facts: MapInfo, interest: Interest) -> NDArray[np.int8]:
    if interest.detail == "classes":
        occupied = log_odds > facts.occupied_log_odds
        free = log_odds < facts.free_log_odds
        return occupied.astype(np.int8) - free.astype(np.int8)
    return sent_steps(log_odds, facts)


def _counts(bits: NDArray[np.uint8], interest: Interest) -> bytes:
    return bits.tobytes() if interest.detail == "counts" else b""


def source_of(sonar_map: SonarMap) -> MapSource:
    return MapSource(sonar_map, MemoryPersistence(sonar_map), log_odds_step=0.25)


def scatter(sonar_map: SonarMap, seed: int, voxels: int, reach_m: float = 3.0) -> None:
    random = np.random.default_rng([33, seed])
    points = random.uniform(-reach_m, reach_m, (voxels, 3))
    sonar_map.core.set_log_odds(points, random.uniform(-6.0, 6.0, voxels))


class Client:
    """Watches a source; what it holds outlives its connections."""

    def __init__(
        self, source: MapSource, interest: Interest | None = None, resume: Resume | None = None
    ) -> None:
        self.interest = interest or Interest()
        self.newest = 0
        self.sent_blocks = self.sent_messages = self.resets = 0
        self.connect(source, resume)

    def connect(self, source: MapSource, resume: Resume | None = None) -> None:
        self.session = source.session
        self.view = source.subscribe(self.interest, resume)
        if not self.view.resumed:
            self.mirror = MapMirror(source.info(), self.interest)

    def reconnect(self, source: MapSource) -> None:
        resume = self.resume()
        self.view.close()
        self.connect(source, resume)

    def resume(self) -> Resume | None:
        if self.mirror.complete is None or self.mirror.interest != self.interest:
            return None
        return Resume(
            map=self.mirror.info.id,
            session=self.session,
            revision=self.mirror.complete,
            level=self.interest.level,
            detail=self.interest.detail,
            radius_m=self.interest.radius_m,
            box=self.interest.box,
            newest=self.newest,
        )

    def hear(
        self,
        most_bytes: int = 1 << 20,
        messages: int = 1000,
        position_m: tuple[float, float, float] | None = None,
    ) -> int:
        """Take so many messages, or as many as there are."""
        for heard in range(messages):
            message = self.view.next_message(position_m, most_bytes)
            if message is None:
                return heard
            self.take(message)
        return messages

    def take(self, message: BlocksMessage | ResetMessage) -> None:
        self.newest = max(self.newest, message.revision)
        self.sent_messages += 1
        if isinstance(message, ResetMessage):
            self.resets += 1
            self.mirror = MapMirror(message.map, message.interest or self.interest)
            self.newest = message.revision
            return
        assert message.complete is None or message.left == 0
        blocks = decode_blocks(message.body, counts=self.interest.detail == "counts")
        self.sent_blocks += len(blocks)
        self.mirror.put(blocks, message.stamp_ns)
        if message.complete is not None:
            self.mirror.complete = message.complete

    def holds(self) -> SentState:
        blocks = self.mirror.blocks()
        return {
            tuple(key.tolist()): (
                blocks.cells[i].tobytes(),
                b"" if blocks.counts is None else blocks.counts[i].tobytes(),
            )
            for i, key in enumerate(blocks.keys)
        }


def look_until_indexed(source: MapSource, now_ns: int = SECOND_NS) -> None:
    """Look until nothing is left to be indexed."""
    source.look(now_ns)
    while source.indexing:
        source.look(now_ns)


def assert_same(client: Client, sonar_map: SonarMap) -> None:
    """Assert that a client holds what the map holds within its interest."""
    assert client.holds() == expected(sonar_map.core, client.mirror.info, client.interest)
