"""Clients that were lost before they were complete, and come back; or others in their name."""

import asyncio
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.map_source import MapSource
from mapperd.server.session import PARKED_S, MessageEnds, ResumeCache, ResumeState
from mapperd.server.subscription import MAX_BLOCKS_IN_FLIGHT, MAX_MESSAGES, InFlight
from mapperd.wire.messages import AckMessage, Interest, Resume
from tests.mapperd.server.sent_state import (
    SECOND_NS,
    Client,
    SentState,
    expected,
    scatter,
    source_of,
)
from tests.mapperd.server.watched import Bed, Watcher, bed_of
from tests.support.waiting import run

MESSAGE = 1000
"""Bytes of one in these tests."""


def mapped(voxels: int = 3000) -> SonarMap:
    sonar_map = SonarMap(Config())
    scatter(sonar_map, 7, voxels)
    return sonar_map


class Parked:
    """A client that heard `used` of `sent` messages, whose connection broke then."""

    def __init__(
        self,
        source: MapSource,
        *,
        interest: Interest | None = None,
        sent: int = 6,
        used: int = 4,
        resume_cache: ResumeCache | None = None,
        ticket: str = "t1",
    ) -> None:
        self.source = source
        self.resume_cache = ResumeCache(8) if resume_cache is None else resume_cache
        self.client = Client(source, interest)
        self.position_m = (0.0, 0.0, 0.0)
        source.look(SECOND_NS)
        self.leave(ticket, sent, used)

    def leave(self, ticket: str, sent: int, used: int, before: Resume | None = None) -> None:
        """The client hears of `sent` messages the first `used`, then the link breaks."""
        client, ends, acked = self.client, MessageEnds(), 0
        view = client.view
        ends.begin(view.number, 0)
        for number in range(sent):
            message = view.next_message(self.position_m, MESSAGE)
            assert message is not None
            ends.note(view.number, (number + 1) * MESSAGE)
            if number < used:
                client.take(message)
            if number < used - 1:
                acked = (number + 1) * MESSAGE
        view.settle(ends.settled(acked))
        resume_state = ResumeState(ticket, acked, sent * MESSAGE, ends, before)
        self.resume_cache.park(view, resume_state, 0.0)
        self.shown = Resume(
            map=self.source.info().id,
            session=self.source.session,
            level=client.interest.level,
            detail=client.interest.detail,
            radius_m=client.interest.radius_m,
            box=client.interest.box,
            ticket=ticket,
            bytes=used * MESSAGE + 500 * (used < sent),
        )

    def back(self, **changes: Any) -> bool:
        shown = msgspec.structs.replace(self.shown, **changes)
        view = self.resume_cache.take(shown, self.client.interest, self.source)
        if view is None:
            return False
        assert view is self.client.view
        return True

    def hear_all(self, now_s: int) -> None:
        self.source.look(now_s * SECOND_NS)
        self.client.hear(position_m=self.position_m)

    def right(self, sonar_map: SonarMap) -> SentState:
        return expected(sonar_map.core, self.source.info(), self.client.interest)


def test_what_was_sent_and_not_received_is_sent_again_and_nothing_else() -> None:
    sonar_map = mapped()
    parked = Parked(source_of(sonar_map))
    assert parked.back()
    parked.hear_all(2)
    right = parked.right(sonar_map)
    assert parked.client.holds() == right
    assert parked.client.sent_blocks == len(right)
    assert parked.client.mirror.complete == sonar_map.core.revision


def test_all_that_was_reported_and_lost_is_sent_again_and_that_it_is_complete() -> None:
    sonar_map = mapped(30)
    parked = Parked(source_of(sonar_map), sent=1, used=1)
    assert parked.back()
    parked.client.hear()
    before = parked.client.sent_blocks
    parked.leave("t2", 0, 0)
    assert parked.back()
    parked.client.mirror.complete = None
    parked.hear_all(3)
    assert parked.client.mirror.complete == sonar_map.core.revision
    assert parked.client.sent_blocks == before


def test_what_changes_meanwhile_is_reported() -> None:
    sonar_map = mapped()
    source = source_of(sonar_map)
    parked = Parked(source)
    scatter(sonar_map, 8, 500)
    for minute in (2, 3, 4):  # nobody else keeps the index alive
        source.look(minute * 60 * SECOND_NS)
    assert parked.back()
    parked.hear_all(300)
    assert parked.client.holds() == parked.right(sonar_map)


def test_that_a_block_is_empty_is_sent_again() -> None:
    """Blocks beyond the radius are sent as empty: the client keeps those that were not sent."""
    sonar_map = mapped()
    source = source_of(sonar_map)
    parked = Parked(source, interest=Interest(radius_m=2.0), sent=0, used=0)
    assert parked.back()
    parked.hear_all(2)
    assert parked.client.holds()
    parked.position_m = (100.0, 0.0, 0.0)
    parked.leave("t2", 1, 0)
    assert parked.back()
    parked.hear_all(3)
    assert parked.client.holds() == {}


def test_a_radius_goes_on() -> None:
    sonar_map = mapped()
    parked = Parked(source_of(sonar_map), interest=Interest(radius_m=1.5), sent=3, used=2)
    fresh = Client(parked.source, Interest(radius_m=1.5))
    assert parked.back()
    parked.hear_all(2)
    fresh.hear(position_m=parked.position_m)
    assert parked.client.holds() == fresh.holds()
    assert parked.client.sent_blocks == fresh.sent_blocks


@pytest.mark.parametrize(
    "lie",
    [
        {"bytes": 6 * MESSAGE + 1},
        {"bytes": 3 * MESSAGE - 1},
        {"map": "x"},
        {"session": "x"},
        {"level": 1},
        {"radius_m": 1.0},
    ],
    ids=str,
)
def test_a_lie_ends_the_ticket(lie: dict[str, Any]) -> None:
    parked = Parked(source_of(mapped()))
    assert not parked.back(**lie)
    assert not parked.back()
    assert parked.resume_cache.counters == {"parked": 1, "parked_resumed": 0, "parked_dropped": 1}


def test_a_ticket_is_good_once_and_another_one_never() -> None:
    parked = Parked(source_of(mapped()))
    assert not parked.back(ticket="t2")
    assert not parked.back(ticket="")
    assert not parked.back(ticket="täuschung")
    assert parked.back()
    assert not parked.back()
    assert parked.resume_cache.counters == {"parked": 1, "parked_resumed": 1, "parked_dropped": 0}


def test_another_map_or_interest_meanwhile_is_not_gone_on_with() -> None:
    sonar_map = mapped()
    emptied = Parked(source_of(sonar_map))
    sonar_map.core.clear()
    emptied.source.look(2 * SECOND_NS)
    assert not emptied.back(map=emptied.source.info().id)
    changed = Parked(source_of(mapped()))
    changed.client.view.change(Interest())  # a reset is due
    assert not changed.back()
    reset_lost = Parked(source_of(mapped()))
    reset_lost.back()
    reset_lost.client.view.change(Interest())
    reset_lost.leave("t2", 2, 0)
    assert not reset_lost.back()
    closed = Parked(source_of(mapped()))
    closed.client.view.close()
    assert not closed.back()


@pytest.mark.parametrize("welcomed", [False, True])
def test_who_never_saw_the_welcome_shows_what_it_showed_before(welcomed: bool) -> None:  # noqa: FBT001
    sonar_map = mapped()
    parked = Parked(source_of(sonar_map))
    first = parked.shown
    assert parked.back()
    parked.leave("t2", 3, 2 if welcomed else 0, first)
    if welcomed:
        first = parked.shown
    parked.shown = first
    assert parked.back()
    parked.hear_all(2)
    assert parked.client.holds() == parked.right(sonar_map)


def test_who_saw_it_shows_that_no_more() -> None:
    parked = Parked(source_of(mapped()))
    first = parked.shown
    assert parked.back()
    parked.leave("t2", 3, 2, first)
    parked.shown = first
    assert not parked.back()


def test_who_stays_away_is_forgotten() -> None:
    parked = Parked(source_of(mapped()))
    parked.resume_cache.expire(PARKED_S)
    assert len(parked.resume_cache) == 1
    parked.resume_cache.expire(PARKED_S + 1)
    assert not parked.back()
    assert parked.resume_cache.counters["parked_dropped"] == 1
    assert not parked.client.view._view.listeners


def test_no_more_are_kept_than_allowed() -> None:
    source, resume_cache = source_of(mapped()), ResumeCache(2)
    first, *others = [Parked(source, resume_cache=resume_cache, ticket=f"t{i}") for i in range(3)]
    assert len(resume_cache) == 2
    assert set(first.client.view._view.listeners) == {one.client.view for one in others}
    assert resume_cache.counters["parked_dropped"] == 1
    assert not first.back()
    assert all(one.back() for one in others)


def test_what_is_remembered_is_bounded() -> None:
    for blocks in (0, 2048):
        way = InFlight()
        for _ in range(2 * MAX_MESSAGES):
            way.note(np.arange(blocks))
        assert way.memory_bytes <= 4 * MAX_BLOCKS_IN_FLIGHT
        assert len(way._messages) <= MAX_MESSAGES
        assert way.beyond(0) is None
        found = way.beyond(way.number - 10)
        assert found is not None
        assert len(found) == blocks
        way.settle(way.number)
        assert way.memory_bytes == 0
    ends = MessageEnds()
    for number in range(1, 100_000):
        ends.note(number, 10 * number)
    assert len(ends._ends) <= 4096
    assert ends.number_at(10) == 0  # more is sent again than need be
    assert ends.number_at(999_990 - 5) == 99_998


@pytest.mark.parametrize(
    ("how", "parked"), [("breaks the rules", 0), ("leaves", 1), ("is silent", 1), ("fault", 0)]
)
def test_who_is_lost_is_kept_and_who_is_cut_is_not(short: Path, how: str, parked: int) -> None:
    async def end(bed: Bed, client: Watcher) -> None:
        if how == "breaks the rules":
            client.send(AckMessage(bytes=10**9))
        elif how == "is silent":
            client.acks = False
            bed.source.put((5, 0, 0), 1)
            await client.until(lambda: (5, 0, 0) in client.cells)
            bed.shift_s = 61.0
        elif how == "fault":
            bed.source.reported_fault = RuntimeError("a fault of ours")
            bed.source.put((5, 0, 0), 1)
        if how == "leaves":
            await client.leave()
        else:
            await client.over()

    async def work() -> None:
        async with bed_of(short) as bed:
            bed.source.put((0, 0, 0), 1)
            client = await bed.welcomed()
            await client.until(lambda: client.complete == 1)
            views = [*bed.source.views]
            await end(bed, client)
            while (bed.counters["parked"], len(bed.source.views)) != (parked, parked):  # noqa: ASYNC110 of another thread
                await asyncio.sleep(0.01)
            assert bed.source.views == views * parked

    run(work())
