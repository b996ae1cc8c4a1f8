"""The server of the map stream, over real sockets."""

import asyncio
import random
import ssl
from pathlib import Path
from typing import Any

import pytest

from mapperd.events import Severity
from mapperd.server.pacer import LOCAL_WINDOW
from mapperd.wire.auth import Limits
from mapperd.wire.messages import (
    ChangeMessage,
    EventMessage,
    HelloMessage,
    Interest,
    Resume,
    SettingsMessage,
    StatusMessage,
)
from tests.mapperd.server.watched import Watcher, as_bytes, bed_of
from tests.support.control_server import TOKEN
from tests.support.waiting import run

pytestmark = pytest.mark.net


def fill(bed: object, blocks: int, layer: int = 0) -> None:
    for n in range(blocks):
        bed.source.put((n, layer, 0), n)  # type: ignore[attr-defined]


def test_a_client_has_the_map_and_sees_it_grow(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            fill(bed, 50)
            watcher = await bed.welcomed()
            assert watcher.welcome is not None
            assert watcher.welcome.may_change
            await watcher.until(lambda: watcher.complete == 50)
            assert watcher.cells == as_bytes(bed.source)
            fill(bed, 20, layer=1)
            fill(bed, 70)
            await watcher.until(lambda: watcher.complete == 140)
            assert watcher.cells == as_bytes(bed.source)
            await watcher.leave()

    run(work())


def test_twenty_clients_come_and_go_and_have_the_map(short: Path) -> None:
    chance = random.Random(5)  # noqa: S311 a test

    async def watch(bed: object) -> None:
        for _ in range(3):
            watcher = await bed.welcomed()  # type: ignore[attr-defined]
            for _ in range(chance.randrange(4)):
                await watcher.read(chance.choice([100, 65536]))
            await watcher.leave()
        watcher = await bed.welcomed()  # type: ignore[attr-defined]
        await watcher.until(lambda: watcher.complete == 500)
        assert watcher.cells == as_bytes(bed.source)  # type: ignore[attr-defined]
        await watcher.leave()

    async def work() -> None:
        async with bed_of(short) as bed:
            watchers = [asyncio.create_task(watch(bed)) for _ in range(20)]
            for layer in range(5):
                fill(bed, 100, layer)
                await asyncio.sleep(0.02)
            await asyncio.gather(*watchers)
            while bed.server.status()["clients"]:  # noqa: ASYNC110 no event to await
                await asyncio.sleep(0.01)
            bed.shift_s = 121.0  # by then nobody comes back
            while bed.source.views:  # noqa: ASYNC110 those who left cost nothing
                await asyncio.sleep(0.01)
            assert bed.counters["accepted"] == 80
            assert bed.counters["failed"] == 0

    run(work())


def test_a_client_that_never_reads_costs_the_others_nothing(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            fill(bed, 2000)
            lazy = await bed.watcher(size=4096)
            lazy.send(HelloMessage(version=1, wants=["map", "status", "events", "settings"]))
            watcher = await bed.welcomed()
            await watcher.until(lambda: watcher.complete == 2000)
            assert watcher.cells == as_bytes(bed.source)
            link = next(one for one in bed.server.status()["watching"] if one["left"])
            assert link["in_flight"] <= LOCAL_WINDOW
            assert link["left"] > 1800
            for _ in range(500):  # until the other has acknowledged all
                links = bed.server.status()["watching"]
                if not any(one["in_flight"] and not one["left"] for one in links):
                    break
                await asyncio.sleep(0.01)
            bed.shift_s = 61.0  # it is let go; who has acknowledged all is not
            await asyncio.sleep(0.2)
            assert bed.counters["cut_no_acks"] == 1
            assert bed.server.status()["clients"] == 1
            lazy.acks = False
            bye = await lazy.over()
            assert bye is not None
            assert bye.reason == "no_acks"
            fill(bed, 10)
            await watcher.until(lambda: watcher.complete == 2010)
            await watcher.leave()

    run(work())


def test_a_client_that_reads_slowly_is_reported_the_newest(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            watcher, quick = await bed.watcher(), await bed.welcomed()
            watcher.acks = False  # no more than a window is under way
            await watcher.hello()
            for round_ in range(20):  # so long it reads nothing
                for n in range(12):
                    bed.source.put((n, 0, 0), round_)
                bed.source.put((round_, 1, 0), 0)
                await quick.until(lambda: quick.complete == bed.source.written)
            watcher.acks = True
            await watcher.until(lambda: watcher.complete == bed.source.written)
            assert watcher.cells == quick.cells == as_bytes(bed.source)
            assert quick.inbox.received > 2 * LOCAL_WINDOW
            assert watcher.inbox.received < LOCAL_WINDOW + 40_000
            for one in (watcher, quick):
                await one.leave()

    run(work())


def test_a_map_that_is_emptied_is_empty_at_the_client(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            fill(bed, 30)
            watcher = await bed.welcomed()
            await watcher.until(lambda: watcher.complete == 30)
            bed.source.clear("m2")
            bed.source.put((7, 7, 7), 7)
            await watcher.until(lambda: watcher.complete == 31)
            assert watcher.resets == 1
            assert watcher.cells == as_bytes(bed.source)
            await watcher.leave()

    run(work())


def test_another_interest_is_reported_again(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            fill(bed, 30)
            watcher = await bed.welcomed(wants=["pose"])
            watcher.send(ChangeMessage(wants=["map"]))
            await watcher.until(lambda: watcher.complete == 30)
            watcher.send(ChangeMessage(interest=Interest(radius_m=5.0)))
            resets = watcher.resets
            await watcher.until(lambda: watcher.resets > resets)
            await watcher.until(lambda: watcher.complete == 30)
            assert watcher.cells == as_bytes(bed.source)
            watcher.send(ChangeMessage(wants=[]))
            while bed.source.views:  # noqa: ASYNC110 no event to await
                await asyncio.sleep(0.01)
            fill(bed, 5)
            watcher.newest.clear()
            await watcher.until(lambda: StatusMessage in watcher.newest)
            assert watcher.complete == 30
            await watcher.leave()

    run(work())


def test_a_client_goes_on_where_it_was(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            fill(bed, 500)
            first = await bed.welcomed()
            await first.until(lambda: first.complete == 500)
            await first.leave()
            fill(bed, 3, layer=1)
            again = await bed.welcomed(resume=Resume(map="m1", session="s1", revision=500))
            assert again.welcome is not None
            assert again.welcome.resumed
            await again.until(lambda: again.complete == 503)
            assert len(again.cells) == 3
            await again.leave()
            liar = await bed.welcomed(resume=Resume(map="m0", session="s1", revision=500))
            assert liar.welcome is not None
            assert not liar.welcome.resumed
            assert liar.welcome.reason
            await liar.until(lambda: liar.complete == 503)
            assert liar.cells == as_bytes(bed.source)
            await liar.leave()

    run(work())


def test_who_knows_the_token_may_come_in(
    short: Path, tls: tuple[ssl.SSLContext, ssl.SSLContext]
) -> None:
    async def work() -> None:
        async with bed_of(short, tls[0]) as bed:
            fill(bed, 3)
            for kind, trusted in (("token", None), ("tls", tls[1])):
                watcher = await bed.watcher(kind, trusted)
                await watcher.hello(TOKEN)
                assert watcher.welcome is not None
                assert watcher.welcome.may_change
                await watcher.until(lambda w=watcher: w.complete == 3)  # type: ignore[misc]
                await watcher.leave()

    run(work())


@pytest.mark.parametrize("token", [None, b"another-horse-battery"])
def test_who_does_not_stays_outside(short: Path, token: bytes | None) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            for attempt in range(7):
                watcher = await bed.watcher("token")
                await watcher.hello(token)
                bye = await watcher.over()
                assert watcher.welcome is None
                assert bye is not None
                assert bye.reason == ("wrong_token" if attempt < 5 else "locked_out")
            assert bed.counters["refused_wrong_token"] == 5
            assert bed.counters["refused_locked_out"] == 2
            sent = [e for e in bed.daemon.events.since(0)[0] if e.code == "stream_wrong_token"]
            assert len(sent) == 5

    run(work())


def test_without_a_token_one_may_look_and_change_nothing(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            watcher = await bed.welcomed("open")
            assert watcher.welcome is not None
            assert not watcher.welcome.may_change
            assert (await watcher.ask(do="status", id=1)).result["phase"] == "mapping"
            asks: list[dict[str, Any]] = [
                {"do": "set", "changes": {"filtering.min_range": 2.0}},
                {"do": "reset"},
                {"do": "save", "name": "a.ply"},
                {"do": "reload"},
                {"do": "snapshot"},
                {"do": "global_localization"},
            ]
            for number, ask in enumerate(asks):
                answer = await watcher.ask(id=10 + number, **ask)
                assert answer.error["reason"] == "needs_token"
            assert bed.daemon.done == []
            assert bed.daemon.settings.current.filtering.min_range == 0.5
            await watcher.leave()

    run(work())


def test_a_setting_that_one_changes_is_seen_by_another(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            one = await bed.welcomed(wants=["settings", "events"])
            two = await bed.welcomed(wants=["map"])
            facts: dict[str, object] = {}

            def known() -> int:
                for message in one.heard:
                    if isinstance(message, SettingsMessage):
                        facts.update(message.facts)
                return len(facts)

            everything = len(bed.feed.settings.since(0, 1 << 30)[1])
            await one.until(lambda: known() == everything)
            assert facts["filtering.min_range"]["value"] == 0.5  # type: ignore[index]
            one.heard.clear()
            answer = await two.ask(do="set", id=4, changes={"filtering.min_range": 2.0})
            assert answer.result == {"changed": {"filtering.min_range": [0.5, 2.0]}}
            await one.until(lambda: any(isinstance(sent, SettingsMessage) for sent in one.heard))
            sent = one.newest[SettingsMessage]
            assert isinstance(sent, SettingsMessage)
            assert [*sent.facts] == ["filtering.min_range"]
            assert sent.facts["filtering.min_range"]["value"] == 2.0
            refused = await two.ask(do="set", id=5, changes={"filtering.min_range": -1})
            assert refused.error["reason"] == "refused"
            for each in (one, two):
                await each.leave()

    run(work())


def test_events_come_as_they_happen_and_since_a_number(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            bed.daemon.events.add(Severity.NOTICE, "before", "before")
            new = await bed.welcomed(wants=["events"])
            old = await bed.welcomed(wants=["events"], events_since=0)
            bed.daemon.events.add(Severity.NOTICE, "after", "after")

            def codes(watcher: Watcher) -> list[str]:
                return [m.event["code"] for m in watcher.heard if isinstance(m, EventMessage)]

            await new.until(lambda: codes(new) == ["after"])
            await old.until(lambda: codes(old) == ["before", "after"])
            for each in (new, old):
                await each.leave()

    run(work())


def test_no_more_clients_than_allowed(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short, limits=Limits(clients=2)) as bed:
            first, second = await bed.welcomed(), await bed.welcomed()
            third = await bed.welcomed()
            bye = await third.over()
            assert bye is not None
            assert bye.reason == "too_many_clients"
            await first.leave()
            while bed.server.status()["clients"] == 2:  # noqa: ASYNC110 no event to await
                await asyncio.sleep(0.01)
            fourth = await bed.welcomed()
            assert fourth.welcome is not None
            for each in (second, fourth):
                await each.leave()

    run(work())


def test_the_end_is_reported(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            fill(bed, 100)
            watchers = [await bed.welcomed() for _ in range(3)]
            newcomer = await bed.watcher()
            ends = [asyncio.create_task(one.over()) for one in (*watchers, newcomer)]
            await asyncio.sleep(0.1)
        for end in ends:
            bye = await end
            assert bye is not None
            assert bye.reason == "closing"

    run(work())
