"""Oversized, slow and flooding clients: no crash, no growth, others keep their rate."""

import asyncio
import contextlib
import gc
import os
import re
import ssl
import tracemalloc
from dataclasses import replace
from pathlib import Path

import pytest

from mapperd.events import Severity
from mapperd.wire.auth import Limits, proof_of
from tests.support.control_server import (
    FREE,
    MALFORMED,
    TOKEN,
    Line,
    Served,
    descriptors,
    go,
    message_of,
)
from tests.support.waiting import until

pytestmark = pytest.mark.net

Contexts = tuple[ssl.SSLContext, ssl.SSLContext]
KINDS = ["unix", "tcp", "tls"]

LATE = Limits(hello_s=0.4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("greeted", [False, True])
def test_endless_message_is_cut(short: Path, tls: Contexts, kind: str, greeted: bool) -> None:  # noqa: FBT001 a parameter
    async def work(one: Served) -> None:
        line = await (one.line(kind) if greeted else one.raw(kind))
        sent = 0
        try:
            while sent < 64 << 20:
                await line.send_bytes(b"x" * 65536)
                sent += 65536
        except ConnectionError:
            pass
        assert sent < 64 << 20
        counter = "cut_too_long" if greeted else "refused_too_long"
        await until(lambda: one.counters[counter] == 1)
        line.close()

    go(work, short, limits=FREE, tls=tls)


@pytest.mark.parametrize("kind", KINDS)
def test_slow_hello_is_cut(short: Path, tls: Contexts, kind: str) -> None:
    async def work(one: Served) -> None:
        line = await one.raw(kind)
        await line.hear()
        hello = message_of({"t": "hello", "version": 1, "name": "x" * 100})
        trickle = asyncio.create_task(_trickle(line, hello))
        assert await line.is_cut()
        assert await trickle < len(hello)
        await until(lambda: one.counters["refused_late_hello"] == 1)
        line.close()

    go(work, short, limits=LATE, tls=tls)


async def _trickle(line: Line, data: bytes) -> int:
    """A byte now and then; each comes in time, all together do not. How many were taken."""
    for k in range(len(data)):
        try:
            await line.send_bytes(data[k : k + 1])
        except ConnectionError:
            return k
        await asyncio.sleep(0.02)
    return len(data)


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_silent_connection_is_cut_before_it_is_a_client(
    short: Path, tls: Contexts, kind: str
) -> None:
    async def work(one: Served) -> None:
        at = one.listeners[kind].socket.getsockname()
        silent = Line(*await asyncio.open_connection(at[0], at[1]))  # no TLS handshake either
        assert await silent.is_cut()
        await until(lambda: one.server.status()["newcomers"] == 0)
        silent.close()

    go(work, short, limits=LATE, tls=tls)


@pytest.mark.parametrize("kind", KINDS)
def test_client_that_acknowledges_nothing_is_cut(
    short: Path, tls: Contexts, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.server.session.QUIET_S", 1.5)

    async def work(one: Served) -> None:
        follower, silent = await one.line(kind), await one.line(kind)
        await follower.send({"t": "change", "wants": ["events"]})
        hearing = asyncio.create_task(follower.hear())  # acknowledges heartbeats
        assert await silent.is_cut()
        await until(lambda: one.counters["cut_no_acks"] == 1)
        one.daemon.events.add(Severity.INFO, "code", "text")
        assert (await hearing)["event"]["code"] == "code"
        assert "result" in await follower.ask("status")
        follower.close()
        silent.close()

    go(work, short, limits=FREE, tls=tls)


@pytest.mark.parametrize("kind", KINDS)
def test_client_that_never_reads_is_cut(short: Path, tls: Contexts, kind: str) -> None:
    async def work(one: Served) -> None:
        line = await one.line(kind)
        line.writer.transport.pause_reading()  # type: ignore[attr-defined]
        with contextlib.suppress(ConnectionError):
            while one.server.status()["clients"]:
                await asyncio.wait_for(line.send_bytes(ASK), 60)
                await asyncio.sleep(0)
        await until(lambda: one.counters["cut_too_many_asks"] + one.counters["cut_unread"] == 1)
        line.close()

    go(work, short, limits=FREE, tls=tls)


def test_flood_of_requests_is_cut_and_others_are_not(short: Path) -> None:
    async def work(one: Served) -> None:
        flooders = [await one.line(kind) for kind in ("unix", "tcp") * 3]
        async with await one.line("unix") as good:
            floods = [asyncio.create_task(_flood(line)) for line in flooders]
            for _ in range(30):
                assert "result" in await good.ask("status")
            await asyncio.gather(*floods)
            await until(lambda: one.counters["cut_too_many_asks"] == 6)
            assert "result" in await good.ask("status")
        for line in flooders:
            line.close()

    go(work, short)


ASK = message_of({"t": "ask", "ask": {"id": 1, "do": "params"}})


async def _flood(line: Line) -> None:
    with contextlib.suppress(ConnectionError):
        while True:
            await line.send_bytes(ASK * 100)
            await asyncio.sleep(0)


def test_eager_client_is_slowed_down_and_others_are_not(short: Path) -> None:
    async def work(one: Served) -> None:
        eager = [await one.line(kind) for kind in ("unix", "tcp") * 3]
        asking = [asyncio.create_task(_ask_on(line)) for line in eager]
        async with await one.line("unix") as good:
            for _ in range(30):
                assert "result" in await good.ask("status")
        await until(lambda: one.counters["throttled"] == 6)
        # Each had its share at once and no more than its rate since.
        assert one.counters["requests"] <= 30 + 6 * (QUIET.asks_at_once + 1)
        for task, line in zip(asking, eager, strict=True):
            task.cancel()
            line.close()
        await asyncio.gather(*asking, return_exceptions=True)

    go(work, short, limits=QUIET)


QUIET = Limits(asks_per_s=0.001, asks_at_once=31)


async def _ask_on(line: Line) -> None:
    while True:
        await line.ask("status")


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_flood_of_connections_does_not_keep_others_out(
    short: Path, tls: Contexts, kind: str
) -> None:
    async def work(one: Served) -> None:
        at = one.listeners[kind].socket.getsockname()
        before = descriptors()
        silent = [Line(*await asyncio.open_connection(at[0], at[1])) for _ in range(100)]
        await until(lambda: one.counters["accepted"] == 100)
        await until(lambda: one.counters["cut_crowded_out"] == 92)
        assert one.server.status()["newcomers"] == 8
        await until(lambda: descriptors() <= before + 100 + 8)
        for other in ("unix", kind):
            async with await one.line(other) as good:
                assert "result" in await good.ask("status")
        for line in silent:
            line.close()

    go(work, short, limits=FREE, tls=tls)


def test_flood_of_connections_leaves_the_loop_to_others(short: Path) -> None:
    async def work(one: Served) -> None:
        at = one.listeners["tcp"].socket.getsockname()
        silent = [Line(*await asyncio.open_connection(at[0], at[1])) for _ in range(40)]
        async with await one.line("unix") as good:
            assert "result" in await good.ask("status")
        assert one.counters["accepted"] <= 1 + 5 + 1  # the rest waits in the kernel
        for line in silent:
            line.close()

    go(work, short, limits=Limits(connects_per_s=0.001, connects_at_once=5))


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_guessing_the_token_is_slow_even_for_the_right_one(
    short: Path, tls: Contexts, kind: str
) -> None:
    async def work(one: Served) -> None:
        reasons = []
        for number in range(12):
            line = await one.raw(kind)
            answer = await line.hello(f"wrong {number}".encode())
            reasons.append(answer["reason"])
            assert await line.is_cut()
            line.close()
        assert reasons == ["wrong_token"] * 5 + ["locked_out"] * 7
        line = await one.raw(kind)
        bye = await line.hello()
        assert bye["reason"] == "locked_out"
        (wait_s,) = re.findall(r"wait (\d+) s", bye["message"])
        assert 0 < int(wait_s) <= 10
        line.close()
        assert one.daemon.events.last == 5  # reported as often as tried, not as often as requested
        async with await one.line("unix") as good:
            assert "result" in await good.ask("status")

    go(work, short, tls=tls)


def test_proof_of_another_connection_is_worth_nothing(short: Path) -> None:
    async def work(one: Served) -> None:
        first, second = await one.raw("tcp"), await one.raw("tcp")
        challenges = [(await line.hear())["challenge"] for line in (first, second)]
        assert len(set(challenges)) == 2
        stolen = {"t": "hello", "version": 1, "proof": proof_of(TOKEN, challenges[0])}
        await second.send(stolen)
        assert (await second.hear())["reason"] == "wrong_token"
        await first.send(stolen)
        assert (await first.hear())["t"] == "welcome"
        first.close()
        second.close()

    go(work, short)


@pytest.mark.slow
def test_nothing_grows_under_all_of_it(short: Path, tls: Contexts) -> None:
    """Hundreds of bad clients on every socket; what the server holds afterwards is as before."""
    rounds = int(os.environ.get("HOSTILE_ROUNDS", "3"))

    async def round_of(one: Served) -> None:
        ways = [(kind, way) for kind in KINDS for way in range(6)]
        await asyncio.gather(*(_misbehave(one, kind, way) for kind, way in ways))
        async with await one.line("unix") as good:
            for _ in range(5):
                assert "result" in await good.ask("status")
        await until(lambda: one.server.status()["clients"] == 0)
        await until(lambda: one.server.status()["newcomers"] == 0)

    async def work(one: Served) -> None:
        tracemalloc.start()  # before: what replaces an entry of a full history is no growth
        for _ in range(12):  # bounded histories and caches fill
            await round_of(one)
        gc.collect()
        files, tasks = descriptors(), len(asyncio.all_tasks())
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(rounds):
            await round_of(one)
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
        await until(lambda: len(asyncio.all_tasks()) <= tasks)
        await until(lambda: descriptors() <= files)
        print(f"{rounds * 18} bad clients: {grown} bytes more are held")  # noqa: T201 measured
        assert grown < 300_000 + 2_000 * rounds

    go(work, short, within_s=300 + 10 * rounds, limits=replace(FREE, operators=32), tls=tls)


async def _misbehave(one: Served, kind: str, way: int) -> None:
    line = await one.line(kind)
    try:
        if way == 0:
            await line.send_bytes(b"x" * 200_000)
        elif way == 1:
            for request in MALFORMED:
                await line.send_bytes(message_of({"t": "ask", "ask": request}))
        elif way == 2:
            await _trickle(line, ASK * 3)
        elif way == 3:
            await line.send_bytes(ASK * 60)
        elif way == 4:
            await line.send_bytes(ASK[:20])
        else:
            await line.send({"t": "change", "wants": ["events"]})
        if way in (0, 1, 3):
            await line.is_cut()
    except (ConnectionError, EOFError):
        pass
    finally:
        line.close()
