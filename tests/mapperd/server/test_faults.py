"""What goes wrong on our side, with the map or with one client, leaves the others alone."""

import asyncio
import ssl
import threading
from pathlib import Path
from typing import Any

import pytest

from mapperd.server.session import ClientSession
from tests.mapperd.server.test_stream_server import fill
from tests.mapperd.server.watched import as_bytes, bed_of
from tests.support.control_server import TOKEN
from tests.support.waiting import run


@pytest.mark.slow
def test_a_fault_of_the_map_is_reported_and_passes(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            fill(bed, 10)
            watcher = await bed.welcomed()
            await watcher.until(lambda: watcher.complete == 10)
            bed.source.fault = OSError("the disk is gone")
            fill(bed, 11)
            await watcher.until(lambda: watcher.complete == 21)
            assert bed.counters["failed"] == 1
            assert any(e.code == "stream_failed" for e in bed.daemon.events.since(0)[0])
            await watcher.leave()

    run(work())


def test_requests_are_answered_while_the_map_is_stuck(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            begun, resume, looked = threading.Event(), threading.Event(), bed.source.look

            def look(*args: Any) -> None:
                begun.set()
                assert resume.wait(60)
                looked(*args)

            bed.source.look = look
            try:
                assert await asyncio.to_thread(begun.wait, 60)
                watcher = await bed.welcomed(wants=[])
                assert (await watcher.ask(do="status", id=9)).result["phase"] == "mapping"
                await watcher.leave()
            finally:
                resume.set()

    run(work())


def test_a_fault_of_one_clients_map_ends_its_connection_and_no_other(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            fill(bed, 10)
            watchers = [await bed.welcomed() for _ in range(3)]
            for watcher in watchers:
                await watcher.until(lambda watcher=watcher: watcher.complete == 10)  # type: ignore[misc]
            bed.source.reported_fault = MemoryError("no room for blocks")
            fill(bed, 11)
            ends = [asyncio.create_task(watcher.over()) for watcher in watchers]
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            (at,) = [n for n, end in enumerate(ends) if end.done()]
            for end in ends:
                end.cancel()
            await asyncio.gather(*ends, return_exceptions=True)
            first = watchers[at]
            others = [watcher for watcher in watchers if watcher is not first]
            assert first.complete == 10  # nothing counts as sent that was not sent
            for watcher in others:
                await watcher.until(lambda watcher=watcher: watcher.complete == 21)  # type: ignore[misc]
                assert watcher.cells == as_bytes(bed.source)
                await watcher.leave()
            assert bed.counters["failed"] == 1
            again = await bed.welcomed()
            await again.until(lambda: again.cells == as_bytes(bed.source))
            await again.leave()

    run(work())


def test_a_fault_with_one_client_ends_its_connection_and_no_other(
    short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            one, other = [await bed.welcomed(name=name) for name in ("one", "other")]
            looked = ClientSession.look

            def look(session: ClientSession, now_s: float) -> None:
                if session.name == "one":
                    raise AttributeError("its transport is half gone")
                looked(session, now_s)

            monkeypatch.setattr(ClientSession, "look", look)
            assert await one.over() is None
            fill(bed, 10)
            await other.until(lambda: other.cells == as_bytes(bed.source))
            assert bed.counters["failed"] == 1
            await other.leave()

    run(work())


def test_tls_that_is_gone_before_its_client_knows_is_let_be(
    short: Path, tls: tuple[ssl.SSLContext, ssl.SSLContext]
) -> None:
    async def work() -> None:
        async with bed_of(short, tls[0]) as bed:
            watcher = await bed.watcher("tls", tls[1])
            await watcher.hello(TOKEN)
            (client,) = bed.server._clients
            below = client._transport._ssl_protocol  # type: ignore[union-attr]
            below._transport.abort()
            while below._transport is not None:  # from here on it has no socket  # noqa: ASYNC110
                await asyncio.sleep(0)
            client.is_over = False  # as it is until the next turn of the loop
            client.turn()
            client.is_over = True
            await watcher.leave()

    run(work())
