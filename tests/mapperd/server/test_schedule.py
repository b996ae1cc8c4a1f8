"""The near map is sent in passes with pauses, and the rest of the map in between."""

import numpy as np
import pytest

from mapperd.server.pacer import MAX_IN_FLIGHT, Pacer
from mapperd.server.priority_queue import (
    ASIDE_S,
    DUTY,
    EACH,
    MAX_REST_S,
    MIN,
    QUIET_S,
    SendRoom,
    SendSchedule,
)

RATE = 25_000.0


def turns(rate: float = RATE, bytes_per_s: int = 0) -> tuple[SendSchedule, Pacer]:
    pacer = Pacer(bytes_per_s)
    pacer.rate, pacer.round_trip_s = rate, 0.6
    return SendSchedule(pacer), pacer


def test_at_first_all_room_is_for_both() -> None:
    rooms = turns()[0].rooms(0.0)
    assert rooms.near == rooms.far > 1000


def test_after_a_pass_the_link_rests_for_what_is_near() -> None:
    some, _ = turns()
    some.sent_near(4000, 5, 10.0)
    assert some.rooms(10.0).near  # the pass goes on
    some.sent_near(4000, 0, 10.2)
    rest_s = 8_000 / (DUTY * RATE)
    assert rest_s < MAX_REST_S
    assert not some.rooms(10.0 + rest_s - 0.01).near
    assert some.rooms(10.0 + rest_s + 0.01).near


def test_no_rest_is_longer_than_what_keeps_the_map_fresh() -> None:
    some, _ = turns()
    some.sent_near(500_000, 0, 10.0)
    assert not some.rooms(10.0 + MAX_REST_S - 0.01).near
    assert some.rooms(10.0 + MAX_REST_S + 0.01).near


def test_a_fast_link_hardly_rests() -> None:
    some, _ = turns(rate=10e6)
    some.sent_near(12_000, 0, 10.0)
    assert some.rooms(10.01).near


def test_a_limit_counts_as_the_link() -> None:
    some, _ = turns(rate=10e6, bytes_per_s=20_000)
    some.sent_near(6_000, 0, 10.0)
    assert not some.rooms(10.4).near


def test_what_is_far_goes_aside_and_only_while_little_is_under_way() -> None:
    some, pacer = turns()
    some.sent_near(3000, 0, 10.0)
    assert some.rooms(10.0).far > 0
    pacer.note_sent(int(0.7 * RATE * (0.6 + ASIDE_S)), 10.0)
    pacer.note_link(0, 0.6, 0.6, 0, RATE)
    assert some.rooms(10.1).far == 0


def test_a_busy_pass_lets_one_of_some_messages_be_far() -> None:
    some, pacer = turns()
    pacer.note_sent(int(RATE), 10.0)
    pacer.note_link(0, 0.6, 0.6, 0, RATE)
    for _ in range(EACH - 1):
        some.sent_near(100, 99, 10.0)
    assert some.rooms(10.0).far == 0
    some.sent_near(100, 99, 10.0)
    assert some.rooms(10.0).far > 0
    some.sent_far()
    assert some.rooms(10.0).far == 0


def test_where_nothing_near_changes_the_link_is_for_what_is_far() -> None:
    some, pacer = turns()
    some.sent_near(3000, 0, 10.0)
    assert some.rooms(10.0 + QUIET_S + 0.1).far > 0
    pacer.note_sent(int(RATE), 10.0)
    pacer.note_link(0, 0.6, 0.6, 0, RATE)
    assert some.rooms(10.0 + QUIET_S + 0.1).far > 0


@pytest.mark.parametrize("link_rate", [500.0, 8_000.0, 37_815.0, 1e6, 1e9])
def test_an_idle_tcp_always_has_room(link_rate: float) -> None:
    """Whatever rate it reports."""
    random = np.random.default_rng(8)
    for factor in random.uniform(0.7, 1.4, 200):
        some, pacer = turns()
        pacer.note_link(0, 0.6, 0.6, 0, factor * link_rate)
        assert some.rooms(0.0).near >= MIN


def test_a_pass_whose_rest_is_not_near_any_more_ends() -> None:
    some, _ = turns()
    some.sent_near(3_000, 40, 10.0)
    assert some.rooms(10.1).near
    some.end_pass()
    assert not some.rooms(10.1).near
    assert some.rooms(10.0 + 3_000 / (DUTY * RATE) + 0.01).near
    some.end_pass()
    assert some.rooms(10.3).near


def test_no_room_is_no_room() -> None:
    some, pacer = turns()
    pacer.note_sent(MAX_IN_FLIGHT, 0.0)
    assert some.rooms(0.0) == SendRoom()
    assert not some.rooms(0.0)


@pytest.mark.parametrize("left", [1, 0])
def test_a_pass_ends_when_nothing_near_is_left(left: int) -> None:
    some, _ = turns()
    some.sent_near(15_000, left, 10.0)
    assert bool(some.rooms(10.1).near) is bool(left)
