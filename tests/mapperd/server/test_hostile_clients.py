"""Whatever a client sends, it alone is let go, with a reason that is counted."""

import asyncio
import random
from pathlib import Path

import msgspec
import pytest

from mapperd.wire.auth import Limits
from mapperd.wire.framing import framed
from mapperd.wire.messages import (
    AckMessage,
    AnswerMessage,
    AskMessage,
    ChangeMessage,
    HelloMessage,
    Interest,
    MapBox,
)
from tests.mapperd.server.watched import as_bytes, bed_of
from tests.support.waiting import run

pytestmark = pytest.mark.net

NAN = float("nan")
HELLO = framed(HelloMessage(version=1, wants=["map"]))


def bare(message: object) -> bytes:
    body = msgspec.msgpack.encode(message)
    return len(body).to_bytes(4, "big") + body


@pytest.mark.parametrize(
    ("output", "reason"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "too_long"),
        (b"\x00\x00\x00\x03abc", "bad_message"),
        (b"\x00\x00\x00\x01\xc1", "bad_message"),
        (bare([]), "bad_message"),
        (bare({"t": "welcome"}), "bad_message"),
        (bare({"t": "hello"}), "bad_message"),
        (bare({"t": "hello", "version": 1, "wants": ["gold"]}), "bad_message"),
        (bare({"t": "hello", "version": 1, "wants": ["map"] * 33}), "bad_message"),
        (bare({"t": "hello", "version": 1, "bytes_per_s": -1}), "bad_message"),
        (bare({"t": "hello", "version": 1, "interest": {"level": 4}}), "bad_message"),
        (bare({"t": "hello", "version": 1, "name": "x" * 101}), "bad_message"),
        (framed(HelloMessage(version=2)), "bad_version"),
        (framed(AckMessage(bytes=0)), "no_hello"),
        (framed(ChangeMessage(wants=[])), "no_hello"),
        (HELLO + HELLO, "hello_twice"),
        (HELLO + framed(AckMessage(bytes=1 << 40)), "bad_ack"),
        (HELLO + framed(ChangeMessage(interest=Interest(radius_m=NAN))), "bad_message"),
        (
            framed(HelloMessage(version=1, interest=Interest(box=MapBox((0, 0, 0), (1, -1, 1))))),
            "bad_interest",
        ),
        (
            framed(HelloMessage(version=1, interest=Interest(box=MapBox((0, 0, 0), (1, NAN, 1))))),
            "bad_interest",
        ),
        (
            HELLO
            + 20 * framed(AskMessage(ask=msgspec.Raw(msgspec.msgpack.encode({"do": "status"})))),
            "too_many_asks",
        ),
        (HELLO + 40_000 * framed(ChangeMessage()), "too_many_messages"),
    ],
)
def test_who_breaks_a_rule_is_reported_and_let_go(short: Path, output: bytes, reason: str) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            watcher = await bed.watcher()
            watcher.acks = False
            watcher.writer.write(output)
            bye = await watcher.over()
            assert bye is not None
            assert bye.reason == reason
            counted = [name for name in bed.counters if name.endswith(reason)]
            assert len(counted) == 1
            good = await bed.welcomed()
            assert good.welcome is not None
            await good.leave()

    run(work())


@pytest.mark.parametrize(
    ("ask", "reason"),
    [
        (b"\xc1", None),
        (msgspec.msgpack.encode({"do": "status"}), "bad_request"),
        (msgspec.msgpack.encode({"do": "explode", "id": 1}), "bad_request"),
        (msgspec.msgpack.encode({1: 2}), "bad_request"),
        (msgspec.msgpack.encode({"do": "hello", "id": 1, "version": 1}), "bad_request"),
        (msgspec.msgpack.encode({"do": "events", "id": 1, "follow": True}), "bad_request"),
        (msgspec.msgpack.encode({"do": "get", "id": 1, "names": [b"\xff"]}), "unknown_setting"),
        (b"\x91" * 3000 + b"\x90", None),
        (b"\x91" * 300 + b"\x90", "bad_request"),
    ],
)
def test_a_request_that_is_invalid_is_answered(short: Path, ask: bytes, reason: str | None) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            watcher = await bed.welcomed(wants=[])
            watcher.writer.write(framed(AskMessage(ask=msgspec.Raw(ask))))
            if reason is None:  # the message itself is malformed
                bye = await watcher.over()
                assert bye is not None
                assert bye.reason == "bad_message"
                return
            await watcher.until(lambda: AnswerMessage in watcher.newest)
            answer = watcher.newest[AnswerMessage]
            assert isinstance(answer, AnswerMessage)
            assert answer.error is not None
            assert answer.error["reason"] == reason
            assert (await watcher.ask(do="status", id=9)).result["phase"] == "mapping"
            await watcher.leave()

    run(work())


def test_any_bytes_leave_the_others_alone(short: Path) -> None:
    chance = random.Random(11)  # noqa: S311 a test
    good = [
        HELLO,
        framed(AckMessage(bytes=60)),
        framed(ChangeMessage(wants=["map", "pose"])),
        framed(ChangeMessage()),
    ]

    def spoilt() -> bytes:
        data = bytearray(b"".join(chance.choices(good, k=4)))
        for _ in range(chance.randrange(4)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        return bytes(data[: chance.randrange(len(data) + 1)])

    async def work() -> None:
        async with bed_of(short) as bed:
            watcher = await bed.welcomed()
            for n in range(60):
                hostile = await bed.watcher()
                hostile.writer.write(spoilt())
                if n % 2:
                    hostile.writer.transport.abort()
                bed.source.put((n, 0, 0), n)
            await watcher.until(lambda: watcher.complete == 60)
            assert watcher.cells == as_bytes(bed.source)
            assert bed.counters["failed"] == 0
            assert not [e for e in bed.daemon.events.since(0)[0] if e.code == "stream_failed"]

    run(work())


def test_who_is_silent_is_let_go(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short, limits=Limits(hello_s=0.1)) as bed:
            silent = await bed.watcher()
            half = await bed.watcher()
            half.writer.write(HELLO[:20])
            for watcher in (silent, half):
                bye = await watcher.over()
                assert bye is not None
                assert bye.reason == "late_hello"
            assert bed.counters["refused_late_hello"] == 2

    run(work())


def test_newcomers_do_not_crowd_each_other_out_for_long(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short, limits=Limits(newcomers=3)) as bed:
            crowd = [await bed.watcher() for _ in range(5)]
            for watcher in crowd[:2]:
                await watcher.over()
            assert bed.counters["cut_crowded_out"] == 2
            good = await bed.welcomed()
            assert good.welcome is not None

    run(work())


def test_no_hello_in_tls_costs_nothing(short: Path, tls: tuple[object, object]) -> None:
    async def work() -> None:
        async with bed_of(short, tls[0], limits=Limits(hello_s=0.2)) as bed:  # type: ignore[arg-type]
            address = bed.listeners["tls"].socket.getsockname()
            reader, writer = await asyncio.open_connection(*address)
            writer.write(HELLO)
            assert await reader.read() is not None
            writer.close()
            silent_reader, silent = await asyncio.open_connection(*address)
            assert await silent_reader.read() == b""
            silent.close()
            while bed.counters["connections_lost"] < 2:  # noqa: ASYNC110 no event to await
                await asyncio.sleep(0.01)
            assert bed.server.status()["newcomers"] == 0

    run(work())
