"""What one client is sent, and when, in a time of its own."""

from collections import Counter
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.events import EventLog, Severity
from mapperd.server.outbox import SHARES
from mapperd.server.pacer import FIRST_RATE, MIN_UNSENT, UNSENT_S
from mapperd.server.session import ClientSession, MapStart, Newcomer, SessionContext
from mapperd.server.state_feed import Newest, SettingLog
from mapperd.server.state_messages import VehiclePath
from mapperd.wire.auth import FailureLimiter
from mapperd.wire.framing import client_inbox, framed
from mapperd.wire.messages import (
    BlocksMessage,
    ChangeMessage,
    EventMessage,
    FromClient,
    HelloMessage,
    MapInfo,
    PathMessage,
    PoseMessage,
    Resume,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
    WelcomeMessage,
)
from tests.mapperd.server.shaped import MIN_IN_FLIGHT_BYTES, STEP_S, Link

MAP_INFO = MapInfo("m1", 0.1, 0.25, 0.8, 0.0)
TICK_S = 0.05


class PlainFeed(SimpleNamespace):
    """Messages that a test makes: a pose each tick, robots of 3000 bytes."""

    def __init__(self) -> None:
        super().__init__(
            made={}, path=VehiclePath(1000, 1.0), settings=SettingLog({}), pictures=[0] * 3
        )
        self.status = msgspec.Raw(msgspec.msgpack.encode({"phase": "mapping", "long": "x" * 3000}))

    def newest(self, kind: str) -> Newest:
        return self.made.get(kind, Newest())  # type: ignore[no-any-return]

    def make(self, kind: str, message: Any) -> None:
        self.made[kind] = Newest(self.newest(kind).number + 1, framed(message))

    def image(self, coarseness: int) -> Newest:
        return Newest(1, bytes(self.pictures[coarseness]))

    def event(self, happening: Any, lost: int) -> bytes:
        return framed(EventMessage(event={"number": happening.number}, lost=lost))


def pose(n: int) -> PoseMessage:
    at = (float(n), 0.0, 0.0)
    turn = (0.0, 0.0, 0.0, 1.0)
    return PoseMessage(
        stamp_ns=n,
        position_m=at,
        orientation_xyzw=turn,
        sonar_position_m=at,
        sonar_orientation_xyzw=turn,
        covariance=(0.1,) * 36,
    )


class LargeMap:
    """Of which there is always more; messages are as large as there is room, about."""

    left, resumed, reason, number = 1000, False, "", 0

    def settle(self, number: int) -> None:
        assert number <= self.number

    def next(self, room: int) -> bytes:
        self.number += 1
        sizes = (0.7, 1.1, 1.45)
        size = int(room * sizes[room % len(sizes)])
        return framed(
            BlocksMessage(revision=1, stamp_ns=1, left=1, complete=None, body=bytes(size))
        )


class SentState:
    """A session, a link of so many bytes a second, and what came over it."""

    def __init__(self, rate: float, *, has_map: bool = False, limit: int = 0, **hello: Any) -> None:
        self.feed, self.events = PlainFeed(), EventLog(lambda: 1)
        feed: Any = self.feed
        common = SessionContext(feed, self.events, FailureLimiter(), "rov", limit)
        self.session = ClientSession(common, Newcomer("", "", None), may_change=True)
        self.link = Link(
            lambda _: rate, there_s=0.05, back_s=0.05, pacer=self.session.pacer, now_s=100.0
        )
        self.inbox = client_inbox()
        self.heard: list[tuple[float, Any]] = []
        self.way = b""
        self._send(self.session.greeting(self.now_s))
        self.send(HelloMessage(version=1, **hello))
        self.map: Any = None
        if has_map:
            self.map = LargeMap()
        self.session.view_ready(self.map, MapStart(MAP_INFO, 7, "s1"))
        self.session.view_request = None

    @property
    def now_s(self) -> float:
        return self.link.now_s

    def send(self, message: FromClient) -> None:
        self.session.take(framed(message), self.now_s)

    def _send(self, data: bytes) -> None:
        if data:
            self.link.carry(len(data))
            self.way += data

    def tick(self, number: int = 1, *, poses: bool = False) -> None:
        for _ in range(number):
            for _ in range(round(TICK_S / STEP_S)):
                self.link.step()
                came = self.link.delivered - self.inbox.received
                self.heard += [(self.now_s, one) for one in self.inbox.feed(self.way[:came])]
                self.way = self.way[came:]
            if poses:
                self.feed.make("pose", pose(round(self.now_s * 1000)))
            self._send(self.session.next(self.now_s, round(self.now_s * 1e9)))
            room = self.session.map_rooms(self.now_s).far
            if room:
                frame = self.map.next(room)
                self._send(self.session.mapped(frame, self.map.number, 1000, self.now_s))

    def of(self, kind: type) -> list[Any]:
        return [one for _, one in self.heard if isinstance(one, kind)]

    def bytes_of(self, kind: type) -> int:
        return sum(len(framed(one)) for one in self.of(kind))

    def late_s(self) -> list[float]:
        """How old poses were when they came."""
        return [
            at_s - one.stamp_ns / 1000 for at_s, one in self.heard if isinstance(one, PoseMessage)
        ]


def test_the_welcome_comes_first_and_reports_what_there_is() -> None:
    reported = SentState(1e6, wants=["pose"])
    reported.tick(20, poses=True)
    kinds = [type(one) for _, one in reported.heard]
    assert kinds[1] is WelcomeMessage
    (welcome,) = reported.of(WelcomeMessage)
    assert (welcome.revision, welcome.session, welcome.vehicle) == (7, "s1", "rov")
    assert welcome.map == MAP_INFO
    assert len(reported.of(PoseMessage)) >= 5
    assert reported.of(RobotsMessage) == []


def test_a_slow_link_has_fresh_poses_and_skips_the_others() -> None:
    reported = SentState(6_000, wants=["pose"])
    reported.tick(1200, poses=True)
    # The wire, what is not sent yet, and a calm TCP's last packets; more until the rate is known.
    wire_s = 0.1 + TICK_S + (MIN_IN_FLIGHT_BYTES + 500) / 6_000
    assert max(reported.late_s()) < wire_s + UNSENT_S * FIRST_RATE / 6_000
    assert max(reported.late_s()[50:]) < wire_s + MIN_UNSENT / 6_000
    assert len(reported.late_s()) > 60
    assert reported.session.outbox.skipped["pose"] + len(reported.of(PoseMessage)) > 1150


def test_heartbeats_come_each_second_and_the_whole_status_when_there_is_room() -> None:
    quick, slow = SentState(1e6, wants=["status"]), SentState(4_000, wants=["status"])
    silent = SentState(1e6)
    for reported in (quick, slow, silent):
        reported.tick(400)
        beats = [at_s for at_s, one in reported.heard if isinstance(one, StatusMessage)]
        assert 18 <= len(beats) <= 20
        assert np.diff(beats).max() < 2.1
    whole = [
        len([one for one in reported.of(StatusMessage) if one.status])
        for reported in (quick, slow, silent)
    ]
    assert whole[0] >= 18
    assert 1 <= whole[1] <= 5  # 3 kB each, of a twentieth of the link
    assert whole[2] == 0
    link = quick.of(StatusMessage)[-1].link
    assert link["bytes"] > 50_000
    assert {"bytes_per_s", "round_trip_s", "in_flight", "left", "skipped"} <= link.keys()


@pytest.mark.parametrize(
    ("rate", "limit"), [(32_000, 0), (8_000, 0), (4_000, 0), (1e6, 8_000), (1e6, 2_000)]
)
def test_poses_come_while_the_map_takes_all_it_can(rate: float, limit: int) -> None:
    reported = SentState(rate, has_map=True, limit=limit, wants=["map", "pose"])
    reported.tick(100, poses=True)
    begun_s = reported.now_s
    reported.heard.clear()
    reported.tick(800, poses=True)
    bytes_per_s = min(rate, limit or rate)
    of_all = bytes_per_s * (reported.now_s - begun_s)
    assert reported.bytes_of(PoseMessage) > 0.8 * SHARES["pose"] * of_all
    assert reported.bytes_of(BlocksMessage) > 0.7 * of_all
    each_s = len(framed(reported.of(PoseMessage)[0])) / (SHARES["pose"] * bytes_per_s)
    gaps_s = np.diff([at_s for at_s, one in reported.heard if isinstance(one, PoseMessage)])
    assert gaps_s.max() < 1.5 * each_s + 2 * max(UNSENT_S, MIN_UNSENT / bytes_per_s)


def test_the_map_gives_way_to_what_is_due_and_asks_for_no_crumbs() -> None:
    reported = SentState(32_000, has_map=True, wants=["map"])
    reported.tick(100)
    session, pacer = reported.session, reported.session.pacer
    pacer.note_ack(pacer.sent, reported.now_s)
    room = session.map_rooms(reported.now_s).far
    assert room > pacer.least()
    session.outbox.waits = True
    assert session.map_rooms(reported.now_s).far == 0
    session.outbox.waits = False
    pacer.note_sent(pacer.room(reported.now_s) - pacer.least() // 2, reported.now_s)
    assert pacer.room(reported.now_s) > 600
    assert session.map_rooms(reported.now_s).far == 0


@pytest.mark.parametrize("rate", [4_000, 32_000])
def test_the_map_starves_nothing_that_comes_to_an_end(rate: float) -> None:
    """Settings are large messages, for which little room is left beside the map."""
    reported = SentState(rate, has_map=True, wants=["map", "pose", "settings", "status"])
    reported.feed.settings = SettingLog({f"a.b{n}": {"text": "x" * 300} for n in range(50)})
    reported.tick(20 * 80, poses=True)
    facts = {name for one in reported.of(SettingsMessage) for name in one.facts}
    assert len(facts) == 50
    assert sum(1 for one in reported.of(StatusMessage) if one.status) > 2
    assert reported.bytes_of(BlocksMessage) > 0.4 * rate * 80


def test_settings_come_in_pieces_and_poses_between_them() -> None:
    reported = SentState(20_000, wants=["settings", "pose"])
    reported.feed.settings = SettingLog(
        {f"a.b{n}": {"value": n, "text": "x" * 300} for n in range(300)}
    )
    reported.tick(240, poses=True)
    facts: dict[str, Any] = {}
    for one in reported.of(SettingsMessage):
        facts |= one.facts
    assert len(facts) == 300
    at_s = [at_s for at_s, one in reported.heard if isinstance(one, PoseMessage)]
    assert np.diff(at_s).max() < 0.7
    reported.feed.settings.put({"a.b7": {"value": 8}})
    reported.tick(20)
    assert reported.of(SettingsMessage)[-1].facts == {"a.b7": {"value": 8}}


def test_events_are_reported_once_and_those_that_are_forgotten_counted() -> None:
    reported = SentState(1e6, wants=["events"], events_since=0)
    for n in range(1200):
        reported.events.add(Severity.INFO, "n", str(n))
    reported.tick(200)
    numbers = [one.event["number"] for one in reported.of(EventMessage)]
    assert numbers == [*range(201, 1201)]
    assert [one.lost for one in reported.of(EventMessage)][:2] == [200, 0]


def test_a_path_grows_goes_on_and_is_sent_again_where_it_was_thinned() -> None:
    reported = SentState(1e6, wants=["path"])
    for n in range(500):
        reported.feed.path.add(np.array([2.0 * n, 0, 0]))
    reported.tick(20)
    assert points_of(reported)[:, 0].tolist() == [2.0 * n for n in range(500)]
    resume = Resume(map="m1", session="s1", revision=1, path=498)
    again = SentState(1e6, wants=["path"], resume=resume)
    again.feed.path = reported.feed.path
    again.tick(20)
    assert [one.first for one in again.of(PathMessage)] == [498]
    other = SentState(
        1e6, wants=["path"], resume=Resume(map="m1", session="s0", revision=1, path=498)
    )
    other.feed.path = reported.feed.path
    other.tick(20)
    assert not other.of(WelcomeMessage)[0].resumed
    assert other.of(PathMessage)[0].first == 0
    for n in range(500, 1001):
        reported.feed.path.add(np.array([2.0 * n, 0, 0]))
    reported.tick(20)
    assert reported.of(PathMessage)[-1].version == 1
    assert points_of(reported)[:, 0].tolist() == [4.0 * n for n in range(501)]


def points_of(reported: SentState) -> Any:
    points = np.zeros((0, 3))
    for one in reported.of(PathMessage):
        points = np.vstack([points[: one.first], np.frombuffer(one.points, "<f4").reshape(-1, 3)])
    return points


def test_what_is_not_wanted_any_more_is_not_reported() -> None:
    reported = SentState(1e6, wants=["pose"])
    reported.tick(10, poses=True)
    reported.send(ChangeMessage(wants=["robots"]))
    reported.tick(5)
    reported.heard.clear()
    reported.feed.make("robots", RobotsMessage(seen=[(1, 2.0, 3.0, 4.0)]))
    reported.tick(10, poses=True)
    assert not reported.of(PoseMessage)
    assert len(reported.of(RobotsMessage)) == 1


def test_pictures_are_as_fine_as_the_link_has_room_for() -> None:
    reported = SentState(1e6, wants=["pose"])
    reported.feed.pictures = [80_000, 20_000, 5_000]
    found: Counter[int] = Counter()
    for rate in (5e6, 2e5, 1e4):
        reported.session.pacer.rate = rate
        found[reported.session.outbox.coarseness()] += 1
    assert found == {0: 1, 1: 1, 2: 1}
