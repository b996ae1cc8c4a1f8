"""A client whose link breaks again and again goes on where it was, complete or not."""

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Self

import numpy as np
import pytest

from mapperd.client import MapChanged, MapClient, MapReset
from mapperd.client import client as client_module
from mapperd.server.stream_server import StreamServer
from tests.mapperd.client.test_with_server import a_map, go, observe, served, until_equal

pytestmark = pytest.mark.net

RATE = 6_000
CUT_AFTER = 2_000
"""Bytes of a connection: much less than the map, which is never complete within one."""


class Relay:
    """Between a client and a daemon; cuts each connection after some bytes, wherever that is.

    The daemon sees the end of the connection, or goes on as if nothing were.
    """

    def __init__(self, to: Path, at: Path, *, reports: bool) -> None:
        self.to, self.at, self.reports = to, at, reports
        self.cuts = 0
        self._backs: list[asyncio.StreamWriter] = []

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_unix_server(self._serve, self.at)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for back in self._backs:
            back.transport.abort()
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_unix_connection(self.to)
        self._backs.append(back)

        async def upwards() -> None:
            while data := await reader.read(65536):
                back.write(data)

        sending = asyncio.create_task(upwards())
        left = CUT_AFTER
        try:
            while left > 0 and (data := await there.read(min(left, 4096))):
                left -= len(data)
                writer.write(data)
            await writer.drain()
            self.cuts += left <= 0
        except OSError:
            pass
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)
            writer.close()
            if self.reports:
                back.transport.abort()


def counters(server: StreamServer) -> dict[str, int]:
    found = server.status()["counters"]
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize("reports", [False, True])
@pytest.mark.parametrize("grows", [False, True])
def test_a_link_that_breaks_all_the_time_brings_all_of_the_map(
    short: Path,
    monkeypatch: pytest.MonkeyPatch,
    grows: bool,  # noqa: FBT001
    reports: bool,  # noqa: FBT001
) -> None:
    monkeypatch.setattr(client_module, "RETRY_DELAY_S", 0.02)
    monkeypatch.setattr(client_module, "MAX_RETRY_DELAY_S", 0.02)
    chance = np.random.default_rng(5)
    sonar_map = a_map()
    observe(sonar_map, chance, 1500)
    sent = resets = 0

    async def work(stack: AsyncExitStack) -> None:
        nonlocal sent, resets
        server = await stack.enter_async_context(served(sonar_map, short / "map.sock"))
        relay = Relay(short / "map.sock", short / "relay.sock", reports=reports)
        await stack.enter_async_context(relay)
        client = await stack.enter_async_context(
            MapClient(str(relay.at), wants=["map"], bytes_per_s=RATE)
        )

        async def count() -> None:
            nonlocal sent, resets
            async for change in client.changes():
                resets += isinstance(change, MapReset)
                sent += len(change.keys) if isinstance(change, MapChanged) else 0

        counting = asyncio.create_task(count())
        while relay.cuts < 5:
            await asyncio.sleep(0.05)
            if grows:
                observe(sonar_map, chance, 1)
        await until_equal([client], sonar_map)
        await client.complete(20)
        counting.cancel()
        await asyncio.gather(counting, return_exceptions=True)
        assert client.mirror is not None
        assert client.link.faults == 0
        assert resets == 1
        if not grows:
            assert sent < 1.5 * len(client.mirror)
        assert counters(server)["parked_resumed"] >= 5
        assert server.status()["clients"] == 1

    go(work)
