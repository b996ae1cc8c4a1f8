"""Clients of the daemon's own server hold its map, byte for byte, whatever happens on the way."""

import asyncio
import hashlib
import random
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from studies.stream.sent_steps import sent_steps

from mapperd import _core
from mapperd.client import Interest, MapClient
from mapperd.client import client as client_module
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.listeners import open_unix_listener
from mapperd.server.map_source import MapSource
from mapperd.server.state_feed import StateFeed
from mapperd.server.stream_server import StreamServer
from mapperd.wire.blocks import UNKNOWN
from mapperd.wire.messages import MapInfo
from tests.support.control_server import FakeDaemon
from tests.support.waiting import run

if TYPE_CHECKING:
    from numpy.typing import NDArray

pytestmark = pytest.mark.net

STEP = 0.25


class InMemory:
    store = None


def a_map() -> SonarMap:
    return SonarMap(Config())


def observe(sonar_map: SonarMap, chance: np.random.Generator, number: int = 400) -> None:
    points = chance.normal(0.0, 1.0, (number, 3))
    occupied = chance.random(number) < 0.5
    sonar_map.core.observe(points, np.where(occupied, 200.0, 10.0), occupied)


@asynccontextmanager
async def served(sonar_map: SonarMap, path: Path) -> AsyncIterator[StreamServer]:
    """A daemon of its own session."""
    daemon = FakeDaemon()
    daemon.settings.follow(["stream.rate"], lambda _: None)
    daemon.settings.apply({"stream.rate": 20.0}, "test")
    with MapSource(sonar_map, InMemory(), log_odds_step=STEP) as source:
        feed = StateFeed(daemon, lambda: None, 1000)
        async with StreamServer(
            daemon, [open_unix_listener(path, 0o600)], feed, source, now_ns=time.time_ns
        ) as server:
            yield server


def sent_digest(sonar_map: SonarMap, facts: MapInfo, level: int) -> str:
    """Of what a mirror ought to hold: rounded, then the highest of each cube, from all voxels."""
    keys, units, counts = sonar_map.core.blocks()
    edge = _core.BLOCK_EDGE
    at = np.stack(np.unravel_index(np.arange(edge**3), (edge,) * 3, order="F"), axis=-1)
    voxels = (keys[:, None, :].astype(np.int64) * edge + at).reshape(-1, 3)
    known = counts.reshape(-1) > 0
    sent = sent_steps(units.reshape(-1) * _core.LOG_ODDS_UNIT, facts)
    blocks: dict[tuple[int, ...], NDArray[np.int8]] = {}
    for cell, value in zip(voxels[known] >> level, sent[known], strict=True):
        block = blocks.setdefault(tuple(cell >> 3), np.full(512, UNKNOWN, np.int8))
        x, y, z = cell & 7
        block[x + 8 * y + 64 * z] = max(block[x + 8 * y + 64 * z], value)
    order = sorted(blocks, key=lambda key: key[::-1])
    digest = hashlib.sha256(np.array(order, "<i4").tobytes())
    digest.update(b"".join(blocks[key].tobytes() for key in order))
    return digest.hexdigest()


def digest_of(client: MapClient) -> str:
    assert client.mirror is not None
    return client.mirror.digest()


async def until_equal(clients: list[MapClient], sonar_map: SonarMap) -> None:
    for client in clients:
        assert client.mirror is not None
        right = sent_digest(sonar_map, client.mirror.info, client.mirror.interest.level)
        while digest_of(client) != right:  # noqa: ASYNC110 of another task
            await asyncio.sleep(0.02)


def go(work: Callable[[AsyncExitStack], Awaitable[None]]) -> None:
    async def stacked() -> None:
        async with AsyncExitStack() as stack:
            await work(stack)

    run(stacked())


def test_mirrors_equal_the_map_through_restarts_and_breaks(
    short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "MAX_RETRY_DELAY_S", 0.2)
    chance = np.random.default_rng(3)
    breaks = random.Random(3)  # noqa: S311 a test
    sonar_map, path = a_map(), short / "map.sock"

    async def work(stack: AsyncExitStack) -> None:
        interests = [Interest(), Interest(level=1), Interest(level=3)]
        clients = [
            await stack.enter_async_context(MapClient(str(path), interest=interest))
            for interest in (*interests, *interests)
        ]
        for _ in range(2):
            async with served(sonar_map, path):
                for client in clients:
                    await client.complete(20)
                for _ in range(6):
                    observe(sonar_map, chance)
                    victim = breaks.choice(clients)
                    if victim._writer is not None:
                        victim._writer.transport.abort()
                    await asyncio.sleep(0.05)
                for client in clients:
                    await client.complete(20)
                await until_equal(clients, sonar_map)
        assert all(client.link.faults == 0 for client in clients)
        assert len(digest_of(clients[0])) == 64

    go(work)


def test_reset_and_another_interest_are_followed(short: Path) -> None:
    chance = np.random.default_rng(4)
    sonar_map, path = a_map(), short / "map.sock"

    async def work(stack: AsyncExitStack) -> None:
        await stack.enter_async_context(served(sonar_map, path))
        client = await stack.enter_async_context(MapClient(str(path)))
        observe(sonar_map, chance)
        await client.complete(20)
        await until_equal([client], sonar_map)
        for level in (2, 0, 1):
            await client.change(interest=Interest(level=level))
        await client.complete(20)
        assert client.mirror is not None
        assert client.mirror.interest == Interest(level=1)
        await until_equal([client], sonar_map)
        before = client.mirror.info.id
        sonar_map.core.clear()
        observe(sonar_map, chance, 50)
        await until_equal([client], sonar_map)
        assert client.mirror.info.id != before
        assert client.link.faults == 0
        assert (await client.ask("status")) is not None

    go(work)
