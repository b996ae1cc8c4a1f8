"""Absent, silent or malformed brokers only increase counters."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from mapperd.events import Severity
from mapperd.telemetry import broker
from mapperd.telemetry import telemetry as telemetry_module
from mapperd.telemetry.telemetry import Phase, Telemetry
from tests.mapperd.telemetry.conftest import FakeVehicle
from tests.support.process import free_tcp_port
from tests.support.waiting import until

pytestmark = pytest.mark.net

LONG_S = 30.0


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telemetry_module, "RETRY_DELAY_S", 0.01)
    monkeypatch.setattr(telemetry_module, "MAX_RETRY_DELAY_S", 0.02)
    monkeypatch.setattr(broker, "TIMEOUT_S", 0.2)


@contextlib.asynccontextmanager
async def running_telemetry(daemon: FakeVehicle) -> AsyncIterator[Telemetry]:
    telemetry = Telemetry(daemon, environment={}, chance=lambda: 0.5)
    task = asyncio.create_task(telemetry.run())
    try:
        yield telemetry
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def test_nobody_listens() -> None:
    daemon = FakeVehicle({"port": free_tcp_port()})

    async def run() -> None:
        async with running_telemetry(daemon) as telemetry:
            await until(lambda: telemetry.counts["lost"] >= 5)
            for k in range(3000):
                daemon.events.add(Severity.NOTICE, "code", str(k))
            await until(lambda: telemetry.counts["lost"] >= 10)
            status = telemetry.status()
        assert status["phase"] in (Phase.CONNECTING, Phase.BACKING_OFF)
        assert "refused" in status["reason"]
        assert (status["connected"], status["queue"], status["published"]) == (0, 0, 0)
        assert telemetry.phase is Phase.CLOSED

    asyncio.run(run())
    assert daemon.asked_for_status == 0  # what nobody hears is not worked out
    lost = [event for event in daemon.events.since(0)[0] if event.code == "mqtt_link"]
    assert len(lost) <= 1  # logged once, not at every attempt


async def _silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        await reader.read()
    writer.close()


async def _closing(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.close()


async def _babbling(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.read(10)
    with contextlib.suppress(OSError):
        for _ in range(50):
            writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n\xff\x00" * 20)
            await writer.drain()
        await reader.read()
    writer.close()


async def _refusing(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.read(10)
    writer.write(bytes((0x20, 2, 0, 5)))  # CONNACK: not authorised
    with contextlib.suppress(OSError):
        await reader.read()
    writer.close()


Server = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@pytest.mark.slow
@pytest.mark.parametrize("server", [_silent, _closing, _babbling, _refusing])
def test_somebody_else_listens(server: Server) -> None:
    served = ended = 0

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal served, ended
        served += 1
        await server(reader, writer)
        with contextlib.suppress(OSError):
            await writer.wait_closed()
        ended += 1

    async def run() -> Telemetry:
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as listening:
            daemon = FakeVehicle({"port": listening.sockets[0].getsockname()[1]})
            async with running_telemetry(daemon) as telemetry:
                await until(lambda: telemetry.counts["lost"] >= 8)
                assert served - ended <= 3  # sockets are closed, not left to the collector
            await until(lambda: ended == served)
            return telemetry

    telemetry = asyncio.run(run())
    assert telemetry.counts["connected"] == 0
    if server is _refusing:
        assert "not authorised" in telemetry.status()["reason"] or telemetry.phase is Phase.CLOSED
