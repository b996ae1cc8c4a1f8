"""However much a client sends at once, the event loop has its turns."""

import asyncio
from pathlib import Path

import msgspec
import pytest

from mapperd.server import connection
from mapperd.server.session import CHANGES_AT_ONCE, CHANGES_PER_S, ClientSession
from mapperd.wire.auth import Limits
from mapperd.wire.framing import framed
from mapperd.wire.messages import AckMessage, AskMessage, ChangeMessage, Interest
from tests.mapperd.server.test_session import SentState
from tests.mapperd.server.watched import bed_of
from tests.support.waiting import run


@pytest.mark.parametrize("listener", ["unix", "tls"])
def test_many_messages_are_heard_in_many_turns(
    short: Path, tls: tuple[object, object], listener: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[int] = []
    take = ClientSession.take

    def noted(session: ClientSession, data: bytes, now_s: float) -> None:
        taken.append(len(data))
        take(session, data, now_s)

    async def work() -> None:
        async with bed_of(short, tls[0]) as bed:  # type: ignore[arg-type]
            watcher = await bed.watcher(listener, tls[1] if listener == "tls" else None)  # type: ignore[arg-type]
            await watcher.hello(b"correct-horse-battery-staple" if listener == "tls" else None)
            monkeypatch.setattr(ClientSession, "take", noted)
            output = 10_000 * framed(ChangeMessage()) + framed(ChangeMessage(bytes_per_s=77_777))
            watcher.writer.write(output)
            (client,) = bed.server._clients
            while client.session.pacer.bytes_per_s != 77_777:  # noqa: ASYNC110 no event to await
                await asyncio.sleep(0)
            assert max(taken) <= 8192
            await watcher.leave()

    run(work())


def test_of_many_changes_the_newest_is_heeded_in_its_time() -> None:
    reported = SentState(1e6, wants=["map"])
    session, heeded = reported.session, []

    def look() -> None:
        if session.view_request is not None:
            assert session.view_request.interest is not None
            heeded.append(session.view_request.interest.radius_m)
            session.view_request = None

    for n in range(100):
        reported.send(ChangeMessage(interest=Interest(radius_m=float(n + 1))))
        look()
    assert heeded == [float(n + 1) for n in range(CHANGES_AT_ONCE)]
    for _ in range(8):
        reported.link.now_s += 0.05
        session.look(reported.now_s)
        look()
    assert heeded[CHANGES_AT_ONCE:] == [100.0]
    for n in range(400):
        reported.link.now_s += 0.01
        reported.send(ChangeMessage(interest=Interest(radius_m=1000.0 + n)))
        session.look(reported.now_s)
        look()
    assert 4 * CHANGES_PER_S - 1 <= len(heeded) - CHANGES_AT_ONCE - 1 <= 4 * CHANGES_PER_S + 2


def test_who_acknowledges_and_asks_but_never_reads_is_cut(
    short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    most = 300_000
    monkeypatch.setattr(connection, "MAX_UNSENT", most)

    async def work() -> None:
        async with bed_of(short, limits=Limits(asks_per_s=1e6, asks_at_once=10**6)) as bed:
            monkeypatch.setattr(bed.daemon, "status", lambda: {"phase": "x" * 20_000})
            watcher = await bed.welcomed(wants=[])
            (client,) = bed.server._clients
            longest = 0
            while not client.is_over:
                if not client.session.asks:
                    ask = msgspec.msgpack.encode({"do": "status", "id": 1})
                    watcher.send(
                        AskMessage(ask=msgspec.Raw(ask)),
                        AckMessage(bytes=client.session.pacer.sent),
                    )
                await asyncio.sleep(0.001)
                assert client._transport is not None
                longest = max(longest, client._transport.get_write_buffer_size())
            assert most < longest < most + 100_000
            assert bed.counters["cut_unread"] == 1

    run(work())
