"""Clients of a map in memory end with what it holds."""

from typing import Literal

import msgspec
import numpy as np
import pytest

from mapperd.config.live import with_values
from mapperd.mapping.sonar_map import SonarMap
from mapperd.wire.messages import Interest
from tests.mapperd.server.sent_state import SECOND_NS, Client, assert_same, scatter, source_of
from tests.mapperd.store.dive import CONFIG, integrate, mapped

DETAILS: tuple[Literal["classes", "log_odds", "counts"], ...] = ("classes", "log_odds", "counts")


@pytest.mark.parametrize("rule", ["iwlo", "arc"])
@pytest.mark.parametrize("level", range(4))
def test_every_level_and_detail_ends_with_the_map(level: int, rule: str) -> None:
    sonar_map = SonarMap(with_values(CONFIG, {"mapping.rule": rule}))
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


@pytest.mark.parametrize("rule", ["iwlo", "arc"])
def test_thresholds_are_those_of_the_rule(rule: str) -> None:
    config = with_values(CONFIG, {"mapping.rule": rule})
    info = source_of(SonarMap(config)).info()
    limits = np.array([config.free_threshold, config.occupied_threshold])
    free, occupied = np.log(limits / (1 - limits))
    assert (info.free_log_odds, info.occupied_log_odds) == pytest.approx((free, occupied))
    prior = config.arc.prior_log_odds if rule == "arc" else 0.0
    assert info.prior_log_odds == prior


def test_who_comes_late_is_reported_all_and_then_changes_alone() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    source.look(SECOND_NS)
    client = Client(source)
    source.look(2 * SECOND_NS)
    client.hear()
    assert_same(client, sonar_map)
    sent = client.sent_blocks
    sonar_map.core.set_log_odds(np.array([[0.05, 0.05, 0.05]]), np.array([5.0]))
    source.look(3 * SECOND_NS)
    client.hear()
    assert client.sent_blocks == sent + 1
    assert_same(client, sonar_map)


def test_what_changes_without_being_reported_otherwise_is_not_sent_again() -> None:
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
    assert (client.hear(), client.sent_blocks) == (1, 1)  # that it is complete, and no block
    assert client.mirror.complete == sonar_map.core.revision


def test_a_block_that_changes_twice_before_it_is_reported_is_reported_once() -> None:
    sonar_map = SonarMap(CONFIG)
    source = source_of(sonar_map)
    client = Client(source)
    for second, value in enumerate((1.0, 2.0, 3.0)):
        sonar_map.core.set_log_odds(np.array([[0.05, 0.05, 0.05]]), np.array([value]))
        source.look(second * SECOND_NS)
    client.hear()
    assert client.sent_blocks == 1
    assert_same(client, sonar_map)


@pytest.mark.parametrize("at_look", [2.0, None])
def test_what_was_reported_between_two_looks_and_is_as_before_is_sent_again(
    at_look: float | None,
) -> None:
    """A block is sent as it is; a look compares it with what it was at the look before."""
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
    sent = client.sent_blocks
    source.look(3 * SECOND_NS)
    client.hear()
    assert client.sent_blocks == sent


def test_an_empty_map_is_complete_at_once() -> None:
    source = source_of(SonarMap(CONFIG))
    client = Client(source)
    source.look(SECOND_NS)
    assert client.hear() == 1
    assert (client.mirror.complete, len(client.mirror)) == (0, 0)


def test_one_block_is_reported_however_few_bytes_there_are() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 1, 300, reach_m=1.0)
    source = source_of(sonar_map)
    client = Client(source)
    source.look(SECOND_NS)
    client.hear(most_bytes=1)
    assert client.sent_messages == client.sent_blocks > 4
    assert_same(client, sonar_map)


def test_clients_that_are_reported_the_same_are_reported_the_same_object() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    first, second = (source.subscribe(Interest()) for _ in range(2))
    source.look(SECOND_NS)
    messages = 0
    while (one := first.next(None, 5000)) is not None:
        assert second.next(None, 5000) is one
        messages += 1
    assert messages > 1


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


def test_a_cleared_map_is_another_one() -> None:
    sonar_map = mapped(2)
    source = source_of(sonar_map)
    clients = [Client(source), Client(source, Interest(level=2))]
    source.look(SECOND_NS)
    clients[0].hear()
    before, resume = source.info().id, clients[0].resume()
    sonar_map.core.clear()
    integrate(sonar_map, 40)
    source.look(2 * SECOND_NS)
    assert source.info().id != before
    for client in clients:
        client.hear()
        assert client.resets == 1
        assert_same(client, sonar_map)
    assert source.subscribe(Interest(), resume).reason == "another_map"


def test_other_thresholds_are_reported_again() -> None:
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
