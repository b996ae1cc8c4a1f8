"""What part of a map a client is sent, in which order, and what need not be sent again."""

from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.mapping.sonar_map import SonarMap
from mapperd.server import map_source as source_module
from mapperd.server.map_index import distances_m
from mapperd.server.priority_queue import NEAR_M
from mapperd.wire.messages import BlocksMessage, Interest, MapBox
from tests.mapperd.server.sent_state import (
    SECOND_NS,
    Client,
    assert_same,
    expected,
    scatter,
    source_of,
)
from tests.mapperd.store.dive import CONFIG, mapped


def test_the_nearest_is_reported_first_within_the_bytes_that_are_given() -> None:
    """Near the vehicle all of the same age; and few of those that are far away before."""
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 1, 2000, reach_m=5.0)
    source = source_of(sonar_map)
    client = Client(source)
    source.look(SECOND_NS)
    position = (5.0, -4.0, 1.0)
    every = np.array([*expected(sonar_map.core, source.info(), client.interest)], np.int32)
    nearby = (distances_m(every, 0.8, position) <= NEAR_M).sum()
    assert 0 < nearby < len(every)
    farthest = {True: 0.0, False: 0.0}
    before = np.zeros((0, 3), np.int32)
    while client.view.left:
        message = client.view.next_message(position, 2000)
        assert isinstance(message, BlocksMessage)
        assert len(message.body) <= 3000
        assert (message.complete is None) == (message.left > 0)
        client.take(message)
        keys = client.mirror.blocks().keys
        new = keys[~(keys[:, None] == before).all(axis=2).any(axis=1)]
        away = distances_m(new, 0.8, position)
        for near in (True, False):
            these = away[(away <= NEAR_M) == near]
            assert these.min(initial=np.inf) >= farthest[near] - 1e-9
            farthest[near] = max(farthest[near], these.max(initial=0.0))
        if nearby > (away <= NEAR_M).sum():
            assert (away > NEAR_M).sum() == 0
        nearby -= (away <= NEAR_M).sum()
        before = keys
    assert client.sent_messages > 10
    assert_same(client, sonar_map)


def test_a_box_is_reported_and_nothing_else() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 2, 3000)
    source = source_of(sonar_map)
    interest = Interest(box=MapBox((-1.0, -1.0, -1.0), (0.5, 2.0, 1.0)))
    client = Client(source, interest)
    source.look(SECOND_NS)
    client.hear()
    whole = expected(sonar_map.core, source.info(), interest)
    low, high = np.array(interest.box.low_m), np.array(interest.box.high_m)  # type: ignore[union-attr]
    inside = {
        key: sent
        for key, sent in whole.items()
        if ((np.array(key) * 0.8 < high) & (np.array(key) * 0.8 + 0.8 > low)).all()
    }
    assert 0 < len(inside) < len(whole)
    assert client.holds() == inside


def test_another_interest_is_reported_again() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    client = Client(source)
    source.look(SECOND_NS)
    client.hear()
    client.interest = Interest(level=1, detail="classes")
    client.view.change(client.interest)
    source.look(2 * SECOND_NS)
    client.hear()
    assert (client.resets, client.mirror.interest) == (1, client.interest)
    assert_same(client, sonar_map)


def test_resuming_reports_what_changed_meanwhile_and_no_more() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 3, 2000)
    source = source_of(sonar_map)
    client = Client(source)
    source.look(SECOND_NS)
    client.hear()
    sent = client.sent_blocks
    client.view.close()
    for minute in (2, 3, 4):  # long enough that nobody remembers what was sent
        source.look(minute * 60 * SECOND_NS)
    scatter(sonar_map, 4, 3, reach_m=1.0)
    client.reconnect(source)
    assert client.view.resumed
    source.look(300 * SECOND_NS)
    client.hear()
    # Those in the same blocks of the map, at most: eight of the stream each.
    assert client.sent_blocks <= sent + 3 * 8
    assert_same(client, sonar_map)


LIES: dict[str, dict[str, Any]] = {
    "another_map": {"map": "x"},
    "never_told": {"revision": 10**9},
    "unknown_session": {"session": "x"},
    "another_interest": {"level": 2},
}


@pytest.mark.parametrize("reason", LIES)
def test_a_lie_is_reported_all(reason: str) -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    honest = Client(source)
    source.look(SECOND_NS)
    honest.hear()
    resume = honest.resume()
    assert resume is not None
    lying = Client(source, resume=msgspec.structs.replace(resume, **LIES[reason]))
    assert (lying.view.resumed, lying.view.reason) == (False, reason)
    source.look(2 * SECOND_NS)
    lying.hear()
    assert_same(lying, sonar_map)
    newest = msgspec.structs.replace(resume, newest=10**9)
    assert source.subscribe(Interest(), newest).reason == "never_told"


def test_a_radius_is_not_resumed() -> None:
    source = source_of(mapped(2))
    client = Client(source, Interest(radius_m=2.0))
    source.look(SECOND_NS)
    client.hear(position_m=(0.0, 0.0, 0.0))
    client.reconnect(source)
    assert (client.view.resumed, client.view.reason) == (False, "moving_interest")


def test_a_radius_without_a_position_reports_nothing() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    client = Client(source, Interest(radius_m=2.0))
    source.look(SECOND_NS)
    client.hear()
    assert (len(client.mirror), client.mirror.complete) == (0, None)
    client.hear(position_m=(1.0, 0.0, -3.0))
    assert len(client.mirror) > 0
    assert client.mirror.complete == source.revision


def test_blocks_are_reported_as_the_vehicle_comes_and_forgotten_as_it_goes() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 5, 3000, reach_m=4.0)
    source = source_of(sonar_map)
    client = Client(source, Interest(radius_m=1.5))
    source.look(SECOND_NS)
    whole = expected(sonar_map.core, source.info(), client.interest)
    keys = np.array(list(whole), np.int32)
    before = 0
    for x in np.arange(-4.0, 4.0, 0.1):
        position = (float(x), 0.3, -0.2)
        client.hear(position_m=position)
        away = dict(zip(whole, distances_m(keys, 0.8, position), strict=True))
        holds = client.holds()
        assert {key for key, far in away.items() if far <= 1.5 * 0.98} <= holds.keys()
        assert holds.keys() <= {key for key, far in away.items() if far <= 1.5 * 1.12}
        assert all(whole[key] == sent for key, sent in holds.items())
        before = max(before, len(holds))
    assert 10 < before < len(whole) / 3
    assert client.sent_blocks < 2.5 * len(whole)  # there and gone, each once


def test_much_that_changed_is_found_in_pieces_nearest_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sonar_map = mapped(1)
    source = source_of(sonar_map)
    client = Client(source)
    source.look(SECOND_NS)
    client.hear()
    settled = client.mirror.complete
    monkeypatch.setattr(source_module, "BLOCKS_AT_ONCE", 64)
    scatter(sonar_map, 6, 2000)
    position = (2.0, 2.0, 2.0)
    source.look(2 * SECOND_NS, position)
    assert client.view.left > source.indexing > 0
    client.hear()
    assert client.mirror.complete == settled
    far = [distances_m(np.array([key]), 0.8, position)[0] for key in client.holds()]
    assert np.median(far) < 3.0
    looks = 0
    while source.indexing:
        source.look(3 * SECOND_NS, position)
        looks += 1
    assert looks > 4
    client.hear()
    assert client.mirror.complete == sonar_map.core.revision
    assert_same(client, sonar_map)


def test_what_was_reported_before_its_turn_and_is_as_before_is_sent_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its change was seen by a look, and not indexed yet, when the block was sent."""
    sonar_map = SonarMap(CONFIG)
    source = source_of(sonar_map)
    near, far = np.array([[0.05, 0.05, 0.05]]), np.array([[9.05, 0.05, 0.05]])
    for point in (near, far):
        sonar_map.core.set_log_odds(point, np.array([2.0]))
    Client(source)
    source.look(SECOND_NS)
    monkeypatch.setattr(source_module, "BLOCKS_AT_ONCE", 8)
    for point in (near, far):
        sonar_map.core.set_log_odds(point, np.array([5.0]))
    source.look(2 * SECOND_NS, (0.0, 0.0, 0.0))
    assert source.indexing > 0
    late = Client(source)
    late.hear()
    assert_same(late, sonar_map)
    for value in (4.0, 3.0, 2.0):
        sonar_map.core.set_log_odds(far, np.array([value]))
    for second in range(3, 6):
        source.look(second * SECOND_NS, (0.0, 0.0, 0.0))
        late.hear()
    assert_same(late, sonar_map)
