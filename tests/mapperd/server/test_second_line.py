"""A client has a second connection beside its first, and is told of the map on either."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.connection import Connection
from mapperd.server.schedule import SLACK_S
from mapperd.wire.auth import Limits
from mapperd.wire.messages import Ack, Ask, Bye, Change, FromClient, Interest, Resume, Status
from tests.mapperd.server.told import expected, scatter, source_of
from tests.mapperd.server.watched import Bed, Watcher, bed_of, run

REACH_M = 4.0
"""All of the map is near the vehicle."""


@asynccontextmanager
async def mapped_bed(folder: Path, limits: Limits | None = None) -> AsyncIterator[tuple[Bed, Any]]:
    """With a map as a daemon has it."""
    sonar_map = SonarMap(Config())
    scatter(sonar_map, 1, 500, REACH_M)
    async with bed_of(folder, limits=limits, source=source_of(sonar_map)) as bed:
        bed.feed.position_m = (0.0, 0.0, 0.0)
        yield bed, sonar_map


def right(bed: Bed, sonar_map: SonarMap) -> dict[tuple[int, ...], bytes]:
    told = expected(sonar_map.core, bed.source.facts(), Interest())
    return {key: cells for key, (cells, _) in told.items()}


def held(first: Watcher, second: Watcher) -> dict[tuple[int, ...], bytes]:
    """What a client has of its lines: of each block what has the highest order."""
    newer = {
        key
        for key, order in second.orders.items()
        if order > first.floor and order >= first.orders.get(key, 0)
    }
    cells: dict[tuple[int, ...], bytes] = {key: first.cells[key] for key in first.cells}
    return cells | {key: second.cells[key] for key in newer}


def client_of(bed: Bed) -> Connection:
    (client,) = [one for one in bed.server._clients if one.first is None]
    return client


def all_is_told(bed: Bed, sonar_map: SonarMap) -> bool:
    is_seen = bool(bed.source.revision == sonar_map.core.revision)
    return is_seen and not bed.server.status()["blocks_left"]


async def until(done: Callable[[], bool]) -> None:
    while not done():  # noqa: ASYNC110 it tells nobody
        await asyncio.sleep(0.02)


async def both(bed: Bed) -> tuple[Watcher, Watcher]:
    first = await bed.welcomed("open")
    await first.until(lambda: first.complete is not None)
    assert first.welcome is not None
    second = await bed.welcomed("open", wants=["map", "pose"], beside=first.welcome.ticket)
    assert second.bye is None
    return first, second


async def hold_up(bed: Bed, sonar_map: SonarMap, first: Watcher, *, whole: bool = True) -> None:
    """The first line takes what it is told, perhaps, and nobody hears that it did."""
    first.acks = False
    scatter(sonar_map, 2, 500, REACH_M)
    async with asyncio.timeout(5):
        while whole and first.complete != sonar_map.core.revision:
            await first.read()
    pacer = client_of(bed).session.pacer
    await until(lambda: pacer.waits_s(time.monotonic()) > 2 * SLACK_S)


def test_a_second_line_is_welcome_and_counts_as_nobody(short: Path) -> None:
    async def work() -> None:
        async with mapped_bed(short, Limits(clients=1)) as (bed, _):
            first, second = await both(bed)
            assert second.welcome is not None
            assert first.welcome is not None
            assert second.welcome.session == first.welcome.session
            assert second.welcome.resumed
            assert second.welcome.ticket == ""
            status = bed.server.status()
            assert status["clients"] == len(status["watching"]) == 1
            assert status["counters"]["second_lines"] == 1
            await second.until(lambda: Status in second.newest)
            assert {*second.newest} == {Status}
            assert not second.cells
            crowd = await bed.welcomed("open")
            assert crowd.bye is not None
            assert crowd.bye.reason == "too_many_clients"

    run(work())


def test_what_is_stuck_on_the_first_line_comes_on_the_second(short: Path) -> None:
    async def work() -> None:
        async with mapped_bed(short) as (bed, sonar_map):
            first, second = await both(bed)
            before = {**first.cells}
            await hold_up(bed, sonar_map, first)
            stuck = {key for key, cells in first.cells.items() if before.get(key) != cells}
            assert len(stuck) > 100
            await second.until(lambda: stuck <= {*second.cells})
            assert all(second.cells[key] == first.cells[key] for key in stuck)
            scatter(sonar_map, 3, 500, REACH_M)
            await second.until(lambda: held(first, second) == right(bed, sonar_map))
            assert second.complete is None  # the first line may not have all
            first.acks = True
            first.say(Ack(bytes=first.inbox.received))
            await second.until(lambda: second.complete == sonar_map.core.revision)

    run(work())


def test_what_was_under_way_on_a_second_line_that_is_lost_is_told_again(short: Path) -> None:
    async def work() -> None:
        async with mapped_bed(short) as (bed, sonar_map):
            first, second = await both(bed)
            await hold_up(bed, sonar_map, first)
            await second.until(lambda: len(second.cells) > 100)
            second.acks = False
            scatter(sonar_map, 3, 500, REACH_M)
            await until(lambda: all_is_told(bed, sonar_map))
            await second.leave()  # of this it has used nothing
            first.acks = True
            first.say(Ack(bytes=first.inbox.received))
            await first.until(lambda: first.complete == sonar_map.core.revision)
            assert first.cells == right(bed, sonar_map)

    run(work())


def test_a_client_that_comes_back_has_what_was_under_way_on_both_lines(short: Path) -> None:
    async def work() -> None:
        async with mapped_bed(short) as (bed, sonar_map):
            first, second = await both(bed)
            used, revision, cells = first.inbox.received, first.complete, {**first.cells}
            await hold_up(bed, sonar_map, first)
            await second.until(lambda: len(second.cells) > 100)
            scatter(sonar_map, 3, 500, REACH_M)
            await until(lambda: all_is_told(bed, sonar_map))
            assert first.welcome is not None
            facts = bed.source.facts()
            shown = Resume(
                map=facts.id,
                session=bed.source.session,
                revision=revision,
                newest=revision,
                ticket=first.welcome.ticket,
                bytes=used,
            )
            again = await bed.welcomed("open", resume=shown)
            assert again.welcome is not None
            assert again.welcome.resumed
            await second.over()
            await again.until(lambda: again.complete == sonar_map.core.revision)
            assert cells | again.cells == right(bed, sonar_map)
            assert bed.counters["parked_resumed"] == 1

    run(work())


def test_who_comes_back_with_a_second_line_is_one_client(short: Path) -> None:
    async def work() -> None:
        async with mapped_bed(short, Limits(clients=1)) as (bed, _):
            first, _ = await both(bed)
            assert first.welcome is not None
            shown = Resume(
                map=bed.source.facts().id,
                session=bed.source.session,
                revision=first.complete,
                newest=first.complete,
                ticket=first.welcome.ticket,
                bytes=first.inbox.received,
            )
            again = await bed.welcomed("open", resume=shown)
            assert again.bye is None
            assert again.welcome is not None
            assert again.welcome.resumed

    run(work())


@pytest.mark.slow
def test_a_map_that_begins_anew_does_not_pile_up_on_the_first_line(short: Path) -> None:
    """It may begin on no other, whose room is not this one's."""

    async def work() -> None:
        async with mapped_bed(short) as (bed, sonar_map):
            first, second = await both(bed)
            random = np.random.default_rng(5)
            sonar_map.core.set_log_odds(
                random.uniform(20.0, 45.0, (200_000, 3)), random.uniform(-6.0, 6.0, 200_000)
            )
            await hold_up(bed, sonar_map, first, whole=False)
            client = client_of(bed)
            pacer = client.session.pacer
            reading = asyncio.create_task(second.over())
            first.say(Change(interest=Interest(detail="classes")))
            for _ in range(40):
                await asyncio.sleep(0.05)
                assert pacer.in_flight <= 1.5 * pacer.window
            assert not client.is_over
            reading.cancel()

    run(work())


def test_a_map_that_is_wanted_again_is_told_whole_on_both_lines(short: Path) -> None:
    async def work() -> None:
        async with mapped_bed(short) as (bed, sonar_map):
            first, second = await both(bed)
            await hold_up(bed, sonar_map, first)
            await second.until(lambda: len(second.cells) > 100)
            first.acks = True
            client = client_of(bed)
            first.say(Change(wants=[]))
            await until(lambda: client.session.view is None)
            first.say(Change(wants=["map"]), Ack(bytes=first.inbox.received))
            await first.until(lambda: first.resets == 1)
            async with asyncio.timeout(5):
                reading = asyncio.create_task(second.over())
                await first.until(lambda: held(first, second) == right(bed, sonar_map))
                newest = sonar_map.core.revision
                await first.until(lambda: newest in (first.complete, second.complete))
                reading.cancel()

    run(work())


def test_another_second_line_takes_the_place_of_the_one_before(short: Path) -> None:
    async def work() -> None:
        async with mapped_bed(short) as (bed, _):
            first, second = await both(bed)
            assert first.welcome is not None
            third = await bed.welcomed("open", beside=first.welcome.ticket)
            assert third.bye is None
            await second.over()
            assert bed.server.status()["clients"] == 1
            await third.until(lambda: Status in third.newest)

    run(work())


def test_a_second_line_ends_with_the_first(short: Path) -> None:
    async def work() -> None:
        async with mapped_bed(short) as (bed, _):
            first, second = await both(bed)
            await first.leave()
            await second.over()
            assert bed.server.status()["clients"] == 0

    run(work())


@pytest.mark.parametrize("ticket", ["0" * 32, "of its own", "of a second line"])
def test_nobody_is_beside_a_connection_that_is_none(short: Path, ticket: str) -> None:
    async def work() -> None:
        async with mapped_bed(short) as (bed, _):
            first, second = await both(bed)
            assert first.welcome is not None
            wrong = ticket
            if ticket == "of its own":
                await first.leave()
                await second.over()
                wrong = first.welcome.ticket
            if ticket == "of a second line":
                (client,) = [one for one in bed.server._clients if one.first is not None]
                wrong = client.session.ticket
            stranger = await bed.welcomed("open", beside=wrong)
            assert stranger.welcome is None
            assert stranger.bye is not None
            assert stranger.bye.reason == "no_such_connection"
            assert bed.counters["refused_no_such_connection"] == 1

    run(work())


@pytest.mark.parametrize(
    "word", [Change(wants=["pose"]), Ask(ask=msgspec.Raw(msgspec.msgpack.encode({"do": "status"})))]
)
def test_a_second_line_says_nothing_but_what_it_used(short: Path, word: FromClient) -> None:
    async def work() -> None:
        async with mapped_bed(short) as (bed, sonar_map):
            first, second = await both(bed)
            second.say(word)
            bye = await second.over()
            assert isinstance(bye, Bye)
            assert bye.reason == "second_line"
            scatter(sonar_map, 2, 500, REACH_M)
            await first.until(lambda: first.complete == sonar_map.core.revision)

    run(work())
