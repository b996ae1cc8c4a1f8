"""A slow reader of changes gets what matters, in bounded memory."""

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.client import ConnectionStatus, LinkChanged, MapChanged, MapReset
from mapperd.client import change_queue as module
from mapperd.client.change_queue import ChangeQueue
from mapperd.client.changes import ClientChange
from mapperd.client.state import ClientState
from mapperd.client.validation import places_of
from mapperd.wire.blocks import path_message
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import (
    WANTS,
    EventMessage,
    Interest,
    PathMessage,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
    WelcomeMessage,
)
from tests.support.stream_server import MAP_INFO, Served, a_block

LINK = LinkChanged(ConnectionStatus("connected", "here", "", 0.0))
WELCOME = WelcomeMessage(
    version=1, server="", vehicle="", session="s", map=MAP_INFO, revision=0, resumed=False
)


class Reader:
    """A client state, and a queue of its changes that nobody has read yet."""

    def __init__(self) -> None:
        self.client_state = ClientState(Interest(), lambda one: self.pending.add(one))  # noqa: PLW0108 later
        self.pending = ChangeQueue(self.client_state, LINK, lambda: None)
        self.client_state.wants_map = True
        self.client_state.begin(WELCOME, None)
        self.take_all()

    def take_all(self) -> list[ClientChange]:
        taken = []
        while (change := self.pending.take()) is not None:
            taken.append(change)
        return taken


def keys(*first: int) -> NDArray[np.int32]:
    return np.array([[one, 0, 0] for one in first], np.int32)


def changed(*first: int, left: int = 0) -> MapChanged:
    return MapChanged(keys(*first), 1, left)


def test_blocks_are_joined_and_the_newest_of_others_stays() -> None:
    reader = Reader()
    for change in (
        changed(1, 2, left=5),
        RobotsMessage(seen=[]),
        changed(2, 3, left=1),
        RobotsMessage(seen=[(1, 2.0, 3.0, 4.0)]),
    ):
        reader.pending.add(change)
    first, second = reader.take_all()
    assert isinstance(first, MapChanged)
    assert first.keys.tolist() == [[1, 0, 0], [2, 0, 0], [3, 0, 0]]
    assert first.left == 1
    assert second == RobotsMessage(seen=[(1, 2.0, 3.0, 4.0)])


def test_reset_drops_the_blocks_before_it() -> None:
    reader = Reader()
    for change in (changed(1), MapReset(MAP_INFO), changed(2)):
        reader.pending.add(change)
    kinds = [(type(one), one) for one in reader.take_all()]
    assert [kind for kind, _ in kinds] == [MapReset, MapChanged]
    assert isinstance(kinds[1][1], MapChanged)
    assert kinds[1][1].keys.tolist() == [[2, 0, 0]]


def test_too_many_blocks_are_the_whole_map_reported_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_KEYS", 10)
    reader = Reader()
    served = Served()
    served.put((5, 5, 5), a_block(1))
    assert reader.client_state.mirror is not None
    reader.client_state.mirror.put(served.since(0), 0)
    for first in range(0, 1000, 5):
        reader.pending.add(changed(*range(first, first + 5)))
        assert len(reader.pending._keys) <= 15
    reset, sent = reader.take_all()
    assert isinstance(reset, MapReset)
    assert isinstance(sent, MapChanged)
    assert sent.keys.tolist() == [[5, 5, 5]]


def test_pieces_of_the_path_are_joined() -> None:
    reader = Reader()
    points = np.arange(12, dtype="<f4").reshape(4, 3)
    reader.client_state.take(PathMessage(first=0, points=points[:3].tobytes()))
    reader.take_all()
    reader.client_state.take(PathMessage(first=3, points=points[3:].tobytes()))
    reader.client_state.take(PathMessage(first=2, points=points[:1].tobytes()))
    (path,) = reader.take_all()
    assert path == PathMessage(first=2, points=points[:1].tobytes())
    assert reader.client_state.path.tolist() == [*points[:2].tolist(), points[0].tolist()]


def test_pieces_of_a_path_far_away_are_joined_with_all_their_digits() -> None:
    reader = Reader()
    far_m = np.array([[5e5 + 0.1, 4.6e6 + 0.2, 0.3], [5e5 + 0.2, 4.6e6 + 0.3, 0.4]])
    reader.client_state.take(path_message(0, far_m[:1]))
    reader.client_state.take(path_message(1, far_m[1:]))
    (path,) = reader.take_all()
    assert isinstance(path, PathMessage)
    np.testing.assert_allclose(places_of(path), far_m, rtol=0, atol=1e-6)


def test_events_that_were_too_many_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_EVENTS", 3)
    reader = Reader()
    for number in range(1, 11):
        reader.client_state.take(
            EventMessage(event={"number": number}, lost=1 if number == 2 else 0)
        )
    taken = [one for one in reader.take_all() if isinstance(one, EventMessage)]
    assert [(one.event["number"], one.lost) for one in taken] == [(8, 8), (9, 0), (10, 0)]
    assert reader.client_state.last_event == 10


def test_waiting_events_are_bounded_by_their_bytes() -> None:
    reader = Reader()
    for number in range(1, 41):
        event = {"number": number, "facts": "x" * 100_000}
        reader.client_state.take(EventMessage(event=event))
        waiting = [(size, event) for event, size in reader.pending._events]
        assert sum(size for size, _ in waiting) <= module.MAX_EVENT_BYTES
        assert len(waiting) == min(number, 10)
    taken = [one for one in reader.take_all() if isinstance(one, EventMessage)]
    assert [one.event["number"] for one in taken] == [*range(31, 41)]
    assert [one.lost for one in taken] == [30] + 9 * [0]
    for number in (41, 42):
        reader.client_state.take(EventMessage(event={"number": number, "facts": "x" * 3_000_000}))
    (newest,) = reader.take_all()
    assert isinstance(newest, EventMessage)
    assert (newest.event["number"], newest.lost) == (42, 1)
    assert reader.pending._event_bytes == 0


def test_events_that_are_nested_as_deeply_as_can_be_are_taken() -> None:
    deep: list[object] = []
    for _ in range(100_000):
        deep = [deep]
    reader = Reader()
    reader.client_state.take(EventMessage(event={"number": 1, "facts": deep}))
    assert len(reader.take_all()) == 1


def test_settings_are_bounded_by_their_bytes() -> None:
    reader = Reader()
    for _ in range(3):  # the same again is no more
        reader.client_state.take(SettingsMessage(facts={"a": "x" * 500_000}))
    reader.client_state.take(SettingsMessage(facts={"b": "x" * 500_000}))
    with pytest.raises(StreamError, match="bytes"):
        reader.client_state.take(SettingsMessage(facts={"c": "x" * 500_000}))
    assert [*reader.client_state.settings] == ["a", "b"]
    reader.client_state.take(SettingsMessage(facts={"a": 1}))
    reader.client_state.take(SettingsMessage(facts={"c": "x" * 500_000}))


def test_settings_are_joined() -> None:
    reader = Reader()
    reader.client_state.take(SettingsMessage(facts={"a": 1, "b": 1}))
    reader.client_state.take(SettingsMessage(facts={"b": 2}))
    assert reader.take_all() == [SettingsMessage(facts={"a": 1, "b": 2})]
    assert reader.client_state.settings == {"a": 1, "b": 2}


def test_every_kind_that_can_be_wanted_has_its_place() -> None:
    assert len(WANTS) == 11
    reader = Reader()
    for _ in range(1000):
        reader.pending.add(StatusMessage(stamp_ns=1))
        reader.pending.add(LINK)
    assert len(reader.take_all()) == 2
