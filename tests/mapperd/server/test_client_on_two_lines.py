"""Our own client, over real sockets, with two lines that are told on by turns and break."""

import asyncio
import random
import ssl
from pathlib import Path

import numpy as np
import pytest

from mapperd.client import Interest, MapClient, connect
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server import schedule as lines_module
from mapperd.server.schedule import Lines
from mapperd.server.source_protocol import FIRST, SECOND, Line
from tests.mapperd.server.told import expected, scatter, source_of
from tests.mapperd.server.watched import Bed, bed_of, run
from tests.support.control_server import TOKEN

pytestmark = pytest.mark.net

LOOKS = 120


@pytest.fixture
def any_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon advises a second line at once, and chooses by dice."""
    dice = random.Random(9)  # noqa: S311 no secret

    def choose(self: Lines, _: float, *, in_pass: bool) -> Line | None:
        assert in_pass in (True, False)
        self.line = dice.choice((FIRST, SECOND))
        return dice.choice((FIRST, SECOND)) if dice.random() < 0.2 else None

    monkeypatch.setattr(Lines, "choose", choose)
    monkeypatch.setattr(lines_module, "STALLS", 0)
    monkeypatch.setattr(lines_module, "FAR_S", 0.0)
    monkeypatch.setattr(connect, "WAIT_S", 0.01)


async def break_one(bed: Bed, dice: random.Random) -> None:
    """Of the daemon's connections."""
    clients = [*bed.server._clients]
    if clients:
        dice.choice(clients).drop()


async def complete(client: MapClient, sonar_map: SonarMap) -> None:
    async with asyncio.timeout(10.0):
        await client.complete()
        async for _ in client.changes():
            if client.mirror is not None and client.mirror.complete == sonar_map.core.revision:
                return


def same(client: MapClient, bed: Bed, sonar_map: SonarMap, interest: Interest) -> bool:
    assert client.mirror is not None
    blocks = client.mirror.blocks()
    pairs = zip(blocks.keys.tolist(), blocks.cells, strict=True)
    held = {tuple(key): cells.tobytes() for key, cells in pairs}
    told = expected(sonar_map.core, bed.source.facts(), interest)
    return held == {key: cells for key, (cells, _) in told.items()}


@pytest.mark.slow
@pytest.mark.usefixtures("any_line")
@pytest.mark.parametrize("kind", ["token", "tls"])
def test_a_client_holds_the_map_whatever_its_lines_do(
    kind: str, short: Path, tls: tuple[ssl.SSLContext, ssl.SSLContext]
) -> None:
    dice, chance = random.Random(4), np.random.default_rng(4)  # noqa: S311 no secret
    sonar_map = SonarMap(Config())

    async def work() -> None:
        async with bed_of(short, tls[0], source=source_of(sonar_map)) as bed:
            bed.feed.position_m = (0.0, 0.0, 0.0)
            host, port = bed.doors[kind].socket.getsockname()[:2]
            trusted = tls[1] if kind == "tls" else None
            place = f"localhost:{port}" if trusted else f"{host}:{port}"
            lines, interest = set(), Interest()
            async with MapClient(place, token=TOKEN, tls=trusted, wants=["map"]) as client:
                for n in range(LOOKS):
                    scatter(sonar_map, n, int(chance.integers(1, 200)))
                    await asyncio.sleep(0.03)
                    lines.add(client.link.lines)
                    if dice.random() < 0.1:
                        await break_one(bed, dice)
                    if n in (40, 80):
                        interest = Interest(level=interest.level ^ 1)
                        await client.change(interest=interest)
                await complete(client, sonar_map)
                assert same(client, bed, sonar_map, interest)
                assert client.link.faults == 0
            assert 2 in lines
            assert bed.counters["second_lines"] > 3
            assert bed.counters["parked_resumed"] > 0
            assert bed.counters["failed"] == 0

    run(work())
