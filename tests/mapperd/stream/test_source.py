"""Clients of a map in memory end with what it holds."""

from typing import Any, Literal

import msgspec
import numpy as np
import pytest

from mapperd.mapping import SonarMap
from mapperd.stream import source as source_module
from mapperd.stream.messages import Blocks, Box, Interest
from mapperd.stream.nearest import NEAR_M
from mapperd.stream.region import distances_m
from tests.mapperd.store.dive import CONFIG, integrate, mapped
from tests.mapperd.stream.told import SECOND_NS, Client, expected, scatter, source_of

DETAILS: tuple[Literal["classes", "log_odds", "counts"], ...] = ("classes", "log_odds", "counts")


def assert_same(client: Client, sonar_map: SonarMap) -> None:
    assert client.holds() == expected(sonar_map.core, client.mirror.facts, client.interest)


@pytest.mark.parametrize("level", range(4))
def test_every_level_and_detail_ends_with_the_map(level: int) -> None:
    sonar_map = SonarMap(CONFIG)
    source = source_of(sonar_map)
    clients = [Client(source, Interest(level=level, detail=detail)) for detail in DETAILS]
    for ping in range(3):
        integrate(sonar_map, ping)
        source.look((ping + 1) * SECOND_NS)
        for client in clients:
            client.hear()
    for client in clients:
        assert_same(client, sonar_map)
        assert client.mirror.complete == source.revision == sonar_map.core.revision
        assert client.view.left == 0


def test_who_comes_late_is_told_all_and_then_changes_alone() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    source.look(SECOND_NS)
    client = Client(source)
    source.look(2 * SECOND_NS)
    client.hear()
    assert_same(client, sonar_map)
    told = client.told_blocks
    sonar_map.core.set_log_odds(np.array([[0.05, 0.05, 0.05]]), np.array([5.0]))
    source.look(3 * SECOND_NS)
    client.hear()
    assert client.told_blocks == told + 1
    assert_same(client, sonar_map)


def test_what_changes_without_being_told_otherwise_is_not_told_again() -> None:
    sonar_map = SonarMap(CONFIG)
    source = source_of(sonar_map)
    point = np.array([[0.05, 0.05, 0.05]])
    sonar_map.core.set_log_odds(point, np.array([2.0]))
    client = Client(source)
    source.look(SECOND_NS)
    assert client.hear() == 1
    sonar_map.core.set_log_odds(point, np.array([2.01]))
    source.look(SECOND_NS + 1)
    assert client.hear() == 0
    source.look(2 * SECOND_NS)
    assert (client.hear(), client.told_blocks) == (1, 1)  # that it is complete, and no block
    assert client.mirror.complete == sonar_map.core.revision


def test_a_block_that_changes_twice_before_it_is_told_is_told_once() -> None:
    sonar_map = SonarMap(CONFIG)
    source = source_of(sonar_map)
    client = Client(source)
    for second, value in enumerate((1.0, 2.0, 3.0)):
        sonar_map.core.set_log_odds(np.array([[0.05, 0.05, 0.05]]), np.array([value]))
        source.look(second * SECOND_NS)
    client.hear()
    assert client.told_blocks == 1
    assert_same(client, sonar_map)


@pytest.mark.parametrize("at_look", [2.0, None])
def test_what_was_told_between_two_looks_and_is_as_before_is_told_again(
    at_look: float | None,
) -> None:
    """A block is told as it is; a look compares it with what it was at the look before."""
    sonar_map = SonarMap(CONFIG)
    source = source_of(sonar_map)
    point, beside = np.array([[0.05, 0.05, 0.05]]), np.array([[0.15, 0.05, 0.05]])
    sonar_map.core.set_log_odds(beside, np.array([1.0]))
    if at_look is not None:
        sonar_map.core.set_log_odds(point, np.array([at_look]))
    client = Client(source)
    source.look(SECOND_NS)
    sonar_map.core.set_log_odds(point, np.array([5.0]))
    client.hear()
    assert_same(client, sonar_map)
    other = Client(source, Interest(detail="classes"))
    other.hear()
    for value in (4.0, 3.0, 2.0):
        sonar_map.core.set_log_odds(point, np.array([value]))
    source.look(2 * SECOND_NS)
    for one in (client, other):
        one.hear()
        assert_same(one, sonar_map)
    told = client.told_blocks
    source.look(3 * SECOND_NS)
    client.hear()
    assert client.told_blocks == told


def test_an_empty_map_is_complete_at_once() -> None:
    source = source_of(SonarMap(CONFIG))
    client = Client(source)
    source.look(SECOND_NS)
    assert client.hear() == 1
    assert (client.mirror.complete, len(client.mirror)) == (0, 0)


def test_the_nearest_is_told_first_within_the_bytes_that_are_given() -> None:
    """Near the vehicle all of the same age; and few of those that are far away before."""
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 1, 2000, reach_m=5.0)
    source = source_of(sonar_map)
    client = Client(source)
    source.look(SECOND_NS)
    position = (5.0, -4.0, 1.0)
    every = np.array([*expected(sonar_map.core, source.facts(), client.interest)], np.int32)
    nearby = (distances_m(every, 0.8, position) <= NEAR_M).sum()
    assert 0 < nearby < len(every)
    farthest = {True: 0.0, False: 0.0}
    before = np.zeros((0, 3), np.int32)
    while client.view.left:
        message = client.view.next_message(position, 2000)
        assert isinstance(message, Blocks)
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
    assert client.told_messages > 10
    assert_same(client, sonar_map)


def test_one_block_is_told_however_few_bytes_there_are() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 1, 300, reach_m=1.0)
    source = source_of(sonar_map)
    client = Client(source)
    source.look(SECOND_NS)
    client.hear(most_bytes=1)
    assert client.told_messages == client.told_blocks > 4
    assert_same(client, sonar_map)


def test_clients_that_are_told_the_same_are_told_the_same_object() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    first, second = (source.subscribe(Interest()) for _ in range(2))
    source.look(SECOND_NS)
    while (one := first.next(None, 5000)) is not None:
        assert second.next(None, 5000) is one


def test_ages_are_those_of_the_last_change() -> None:
    sonar_map = SonarMap(CONFIG)
    source = source_of(sonar_map)
    for second, x in enumerate((0.05, 1.65)):
        sonar_map.core.set_log_odds(np.array([[x, 0.05, 0.05]]), np.array([3.0]))
        source.look((second + 1) * SECOND_NS)
    source.look(10 * SECOND_NS)
    client = Client(source)
    source.look(10 * SECOND_NS)
    client.hear()
    cells = client.mirror.cells("known")
    order = np.argsort(cells.centres_m[:, 0])
    assert cells.changed_ns[order].tolist() == [SECOND_NS, 2 * SECOND_NS]


def test_a_box_is_told_and_nothing_else() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 2, 3000)
    source = source_of(sonar_map)
    interest = Interest(box=Box((-1.0, -1.0, -1.0), (0.5, 2.0, 1.0)))
    client = Client(source, interest)
    source.look(SECOND_NS)
    client.hear()
    whole = expected(sonar_map.core, source.facts(), interest)
    low, high = np.array(interest.box.low_m), np.array(interest.box.high_m)  # type: ignore[union-attr]
    inside = {
        key: told
        for key, told in whole.items()
        if ((np.array(key) * 0.8 < high) & (np.array(key) * 0.8 + 0.8 > low)).all()
    }
    assert 0 < len(inside) < len(whole)
    assert client.holds() == inside


def test_another_interest_is_told_anew() -> None:
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


def test_a_cleared_map_is_another_one() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    clients = [Client(source), Client(source, Interest(level=2))]
    source.look(SECOND_NS)
    clients[0].hear()
    before, resume = source.facts().id, clients[0].resume()
    sonar_map.core.clear()
    integrate(sonar_map, 40)
    source.look(2 * SECOND_NS)
    assert source.facts().id != before
    for client in clients:
        client.hear()
        assert client.resets == 1
        assert_same(client, sonar_map)
    assert source.subscribe(Interest(), resume).reason == "another_map"


def test_other_thresholds_are_told_anew() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    client = Client(source, Interest(detail="classes"))
    source.look(SECOND_NS)
    client.hear()
    mapping = msgspec.structs.replace(CONFIG.mapping, occupied_threshold=0.9)
    sonar_map.reconfigure(msgspec.structs.replace(CONFIG, mapping=mapping))
    source.look(2 * SECOND_NS)
    client.hear()
    assert client.resets == 1
    assert_same(client, sonar_map)


def test_resuming_tells_what_changed_meanwhile_and_no_more() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 3, 2000)
    source = source_of(sonar_map)
    client = Client(source)
    source.look(SECOND_NS)
    client.hear()
    told = client.told_blocks
    client.view.close()
    for minute in (2, 3, 4):  # long enough that nobody remembers what was told
        source.look(minute * 60 * SECOND_NS)
    scatter(sonar_map, 4, 3, reach_m=1.0)
    client.reconnect(source)
    assert client.view.resumed
    source.look(300 * SECOND_NS)
    client.hear()
    # Those in the same blocks of the map, at most: eight of the stream each.
    assert client.told_blocks <= told + 3 * 8
    assert_same(client, sonar_map)


LIES: dict[str, dict[str, Any]] = {
    "another_map": {"map": "x"},
    "never_told": {"revision": 10**9},
    "unknown_session": {"session": "x"},
    "another_interest": {"level": 2},
}


@pytest.mark.parametrize("reason", LIES)
def test_a_lie_is_told_all(reason: str) -> None:
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


def test_a_radius_without_a_position_tells_nothing() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    client = Client(source, Interest(radius_m=2.0))
    source.look(SECOND_NS)
    client.hear()
    assert (len(client.mirror), client.mirror.complete) == (0, None)
    client.hear(position_m=(1.0, 0.0, -3.0))
    assert len(client.mirror) > 0
    assert client.mirror.complete == source.revision


def test_blocks_are_told_as_the_vehicle_comes_and_forgotten_as_it_goes() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 5, 3000, reach_m=4.0)
    source = source_of(sonar_map)
    client = Client(source, Interest(radius_m=1.5))
    source.look(SECOND_NS)
    whole = expected(sonar_map.core, source.facts(), client.interest)
    keys = np.array(list(whole), np.int32)
    before = 0
    for x in np.arange(-4.0, 4.0, 0.1):
        position = (float(x), 0.3, -0.2)
        client.hear(position_m=position)
        away = dict(zip(whole, distances_m(keys, 0.8, position), strict=True))
        holds = client.holds()
        assert {key for key, far in away.items() if far <= 1.5 * 0.98} <= holds.keys()
        assert holds.keys() <= {key for key, far in away.items() if far <= 1.5 * 1.12}
        assert all(whole[key] == told for key, told in holds.items())
        before = max(before, len(holds))
    assert 10 < before < len(whole) / 3
    assert client.told_blocks < 2.5 * len(whole)  # there and gone, each once


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


def test_what_was_told_before_its_turn_and_is_as_before_is_told_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its change was seen by a look, and not indexed yet, when it was told as it is."""
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


def test_memory_of_an_index_and_of_clients() -> None:
    sonar_map = mapped(20)
    source = source_of(sonar_map)
    clients = [Client(source) for _ in range(10)]
    source.look(SECOND_NS)
    blocks = len(clients[0].view._view)
    assert source.memory_bytes - 10 * clients[0].view.memory_bytes <= 60 * blocks + 40_000
    assert clients[0].view.memory_bytes <= 2 * blocks
    assert source.memory_bytes < 0.1 * sonar_map.memory_bytes


def test_a_client_that_is_forgotten_costs_nothing() -> None:
    source = source_of(mapped(1))
    client = Client(source)
    source.look(SECOND_NS)
    with_client = source.memory_bytes
    del client
    source.look(2 * SECOND_NS)
    source.look(90 * SECOND_NS)
    assert source.memory_bytes == 0 < with_client
