"""A small sonar on loopback that obeys fire messages and misbehaves on request."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pytest

from oculus_driver import LinkTimeouts, StreamParser, encode_dummy
from oculus_driver.wire import FIRE_V1, FIRE_V2, FireFlags, MessageId, PingRate

if TYPE_CHECKING:
    from tests.oculus_driver.conftest import MakePing

MakeSonar = Callable[..., "FakeSonar"]
Run = Callable[[Coroutine[Any, Any, None]], None]

MS = 1_000_000
QUICK = LinkTimeouts(
    connect_ns=500 * MS,
    keep_alive_ns=20 * MS,
    send_gap_ns=MS,
    silence_ns=5000 * MS,  # a busy machine's pause is no silence
    reconnect_ns=500 * MS,
    fallback_ns=200 * MS,
    back_off_ns=(10 * MS, 20 * MS),
)
"""A link's patience, for tests that wait for it to end; tests set their own silence."""


class FakeSonar:
    """Serves one client at a time, as the device does.

    Args:
        make_ping: makes ping messages.
        versions: of fire messages that it understands; others are ignored.
        echo: what its pings show otherwise than they were asked for.
        sends_dummies: whether it reports standby.
    """

    def __init__(
        self,
        make_ping: MakePing,
        *,
        versions: tuple[int, ...] = (1, 2),
        echo: dict[str, Any] | None = None,
        sends_dummies: bool = True,
        rows: int = 5,
    ) -> None:
        self.fires: list[dict[str, Any]] = []
        self.dummies_heard = 0
        self.clients = 0
        self.refused = 0
        self.pings_sent = 0
        self.rate_hz = 200.0
        self.mute = False
        self.port = 0
        self.next_id = 1
        self._make_ping = make_ping
        self._versions = versions
        self._echo = echo or {}
        self._sends_dummies = sends_dummies
        self._rows = rows
        self._settings: dict[str, Any] | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._awaited: tuple[int, asyncio.Event] | None = None
        self._serving = 0
        self._free = asyncio.Event()
        self._free.set()

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.drop()
        await self._server.wait_closed()
        await self._free.wait()

    def drop(self) -> None:
        """Cut the connection, as a pulled cable's reset does; the place is free at once."""
        if self._writer is not None:
            self._writer.transport.abort()
            self._writer = self._settings = None

    def send(self, data: bytes) -> None:
        assert self._writer is not None
        self._writer.write(data)

    async def send_at(self, megabits_per_s: float, data: bytes) -> None:
        """Send as a network of this speed would let through."""
        piece = 1 << 15
        for start in range(0, len(data), piece):
            self.send(data[start : start + piece])
            await asyncio.sleep(8e-6 * piece / megabits_per_s)

    def ping_message(self, **changes: Any) -> bytes:
        """Return the next ping, with the echo of the last fire message."""
        fire = self._settings or {}
        values: dict[str, Any] = {"version": 2, "ping_id": self.next_id, "rows": self._rows}
        names = {"mode": "mode", "gamma": "gamma", "range_demand": "range_m"}
        names |= {"gain_percent": "gain_percent", "salinity_ppt": "salinity_ppt"}
        values |= {ours: fire[theirs] for theirs, ours in names.items() if theirs in fire}
        if fire:
            values |= {"flags": fire["flags"], "version": fire["version"]}
            values["beams"] = 512 if fire["flags"] & FireFlags.FULL_BEAMS else 256
            if fire["flags"] & FireFlags.SEND_GAIN:
                values["gains"] = np.full(values["rows"], 4, dtype=np.uint32)
        self.next_id += 1
        return self._make_ping(**(values | self._echo | changes))

    def ping(self, **changes: Any) -> None:
        self.send(self.ping_message(**changes))
        self.pings_sent += 1
        if self._awaited is not None and self.pings_sent >= self._awaited[0]:
            self._awaited[1].set()

    async def sent(self, pings: int) -> None:
        """Wait until so many pings have been sent."""
        event = asyncio.Event()
        self._awaited = pings, event
        await event.wait()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._writer is not None:
            self.refused += 1
            writer.transport.abort()
            return
        self._writer = writer
        self._serving += 1
        self._free.clear()
        self.clients += 1
        self._settings = None
        try:
            async with asyncio.TaskGroup() as group:
                pinging = group.create_task(self._ping_on())
                await self._obey(reader)
                pinging.cancel()
        except* ConnectionError:
            pass
        finally:
            if self._writer is writer:
                self._writer = None
            writer.close()
            with suppress(ConnectionError):
                await writer.wait_closed()
            self._serving -= 1
            if self._serving == 0:
                self._free.set()

    async def _obey(self, reader: asyncio.StreamReader) -> None:
        parser = StreamParser()
        while data := await reader.read(1 << 16):
            for message in parser.feed(data):
                if message.message_id == MessageId.DUMMY:
                    self.dummies_heard += 1
                elif message.message_id == MessageId.FIRE:
                    layout = FIRE_V2 if message.version == 2 else FIRE_V1
                    self._fire(layout.unpack(message.data))

    def _fire(self, fire: dict[str, Any]) -> None:
        self.fires.append(fire)
        if fire["version"] not in self._versions:
            return
        self._settings = fire
        if fire["flags"] & FireFlags.NETWORK_TRIGGER and not self.mute:
            self.ping()

    async def _ping_on(self) -> None:
        while True:
            await asyncio.sleep(1.0 / self.rate_hz)
            if self._settings is None or self.mute:
                continue
            if self._settings["ping_rate"] == PingRate.STANDBY:
                if self._sends_dummies:
                    self.send(encode_dummy(source_id=7892))
            elif not self._settings["flags"] & FireFlags.NETWORK_TRIGGER:
                self.ping()


@pytest.fixture
def fake(make_ping: MakePing) -> MakeSonar:
    """Return a maker of sonars on loopback."""

    def make(**options: Any) -> FakeSonar:
        return FakeSonar(make_ping, **options)

    return make


@pytest.fixture(scope="session")
def quick() -> LinkTimeouts:
    return QUICK


@pytest.fixture(scope="session")
def run() -> Run:
    """Return a runner that fails where a task is left behind, or nothing comes to an end."""

    async def whole(job: Coroutine[Any, Any, None]) -> None:
        async with asyncio.timeout(20.0):
            await job
        left = asyncio.all_tasks() - {asyncio.current_task()}
        assert not left, f"left behind: {left}"

    def go(job: Coroutine[Any, Any, None]) -> None:
        asyncio.run(whole(job))

    return go
