"""A client of the map stream that a test feeds, and maps to feed it."""

import asyncio
import time
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from plyfile import PlyData

from mapperd.client import (
    AskError,
    ClientChange,
    ConnectionStatus,
    LinkChanged,
    MapChanged,
    MapReset,
)
from mapperd.client.mirror import MapMirror
from mapperd.config.live import facts_of
from mapperd.config.tree import Config
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet
from mapperd.wire.messages import Interest, MapInfo, PoseMessage, SettingsMessage, WelcomeMessage

ROOT = Path(__file__).resolve().parents[3]
STEP = 0.25
MAP_INFO = MapInfo("one", 0.1, STEP, 0.85, 0.0)


def blocks_of(
    index: ArrayLike, log_odds: ArrayLike = 3.0, counts: ArrayLike = 4, age_ms: int = 0
) -> BlockSet:
    """Blocks that hold cells (N, 3) and nothing else."""
    cell = np.asarray(index, np.int64).reshape(-1, 3)
    keys, row = np.unique(cell >> 3, axis=0, return_inverse=True)
    x, y, z = (cell & 7).T
    at = (row.ravel(), x + 8 * (y + 8 * z))
    cells = np.full((len(keys), CELLS), UNKNOWN, np.int8)
    cells[at] = np.clip(np.round(np.asarray(log_odds) / STEP), -127, 127)
    bits = np.zeros((len(keys), CELLS), np.uint8)
    bits[at] = np.floor(np.log2(np.maximum(counts, 1))) + 1
    ages = np.full(len(keys), age_ms, np.uint32)
    return BlockSet(keys.astype(np.int32), ages, cells, bits)


def mirror_of(blocks: BlockSet, stamp_ns: int = 0) -> MapMirror:
    mirror = MapMirror(MAP_INFO, Interest(detail="counts"))
    mirror.put(blocks, stamp_ns)
    return mirror


def some_map() -> BlockSet:
    """The demo's, where it was made; else a floor with a wall and two piles."""
    path = ROOT / "out" / "demo" / "map.ply"
    if path.exists():
        vertex = PlyData.read(str(path))["vertex"].data
        centres = np.stack([vertex[axis] for axis in "xyz"], axis=1)
        odds = np.log(vertex["probability"] / (1 - vertex["probability"]))
        return blocks_of(np.floor(centres / MAP_INFO.resolution_m), odds, vertex["count"])
    floor = np.add(np.indices((90, 80, 2)).reshape(3, -1).T, (-40, -40, -62))
    wall = np.add(np.indices((90, 2, 30)).reshape(3, -1).T, (-40, 38, -60))
    piles = [np.add(np.indices((4, 4, 20)).reshape(3, -1).T, (x, 5, -60)) for x in (-20, 15)]
    return blocks_of(np.concatenate([floor, wall, *piles]))


class FakePageClient:
    """What the page needs of a `MapClient`."""

    def __init__(self, blocks: BlockSet) -> None:
        self.link = ConnectionStatus("connecting", "127.0.0.1:52300", "", time.monotonic())
        self.mirror: MapMirror | None = None
        self.welcome: WelcomeMessage | None = None
        self.path: NDArray[np.float64] = np.zeros((0, 3))
        self.values: dict[str, Any] = {}
        self.refuses: dict[str, str] = {}
        self.wants: tuple[str, ...] = ()
        self._blocks = blocks
        self._queue: asyncio.Queue[ClientChange | None] = asyncio.Queue()

    async def changes(self) -> AsyncIterator[ClientChange]:
        while (change := await self._queue.get()) is not None:
            yield change

    def feed(self, change: ClientChange | None) -> None:
        self._queue.put_nowait(change)

    def connect(self, *, facts: MapInfo = MAP_INFO) -> None:
        self._be("connected", "")
        self.mirror = MapMirror(facts, Interest(detail="counts"))
        self.welcome = WelcomeMessage(
            version=1,
            server="1",
            vehicle="rov",
            session="s",
            map=facts,
            revision=1,
            resumed=False,
            may_change=True,
        )
        self.feed(MapReset(facts))
        self.mirror.put(self._blocks, time.time_ns())
        self.feed(MapChanged(self._blocks.keys, time.time_ns(), 0))
        self.feed(SettingsMessage(facts=facts_of(Config(), lambda _: "default", [])))

    def lose(self, reason: str) -> None:
        self._be("waiting", reason)

    def _be(self, state: Any, reason: str) -> None:
        connects = self.link.connects + (state == "connected")
        self.link = ConnectionStatus(state, self.link.address, reason, time.monotonic(), connects)
        self.feed(LinkChanged(self.link))

    async def change(self, *, wants: tuple[str, ...]) -> None:
        self.wants = wants

    async def set(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        if self.refuses.keys() & changes.keys():
            raise AskError("refused", "nothing was changed", {"reasons": self.refuses})
        before = {name: self.values.get(name) for name in changes}
        self.values.update(changes)
        return {name: [before[name], value] for name, value in changes.items()}


def pose_at(x: float, y: float, z: float, yaw: float, stamp_ns: int | None = None) -> PoseMessage:
    turn = (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
    return PoseMessage(
        stamp_ns=time.time_ns() if stamp_ns is None else stamp_ns,
        position_m=(x, y, z),
        orientation_xyzw=turn,
        sonar_position_m=(x, y, z),
        sonar_orientation_xyzw=turn,
    )
