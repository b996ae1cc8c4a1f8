"""Ping ids in order."""

from __future__ import annotations

from oculus_driver.ping import PingSequence


def taken(*ids: int) -> tuple[list[bool], int, int, int]:
    sequence = PingSequence()
    accepted = [sequence.accept(ping_id) for ping_id in ids]
    return accepted, sequence.lost_pings, sequence.duplicates, sequence.restarts


def test_pings_in_order_lose_nothing() -> None:
    assert taken(5, 6, 7) == ([True] * 3, 0, 0, 0)


def test_a_gap_counts_the_pings_that_never_came() -> None:
    assert taken(5, 9) == ([True, True], 3, 0, 0)


def test_a_ping_that_comes_twice_is_delivered_once() -> None:
    assert taken(5, 5, 6) == ([True, False, True], 0, 1, 0)


def test_a_smaller_id_is_a_restart() -> None:
    assert taken(5000, 1, 2) == ([True] * 3, 0, 0, 1)


def test_ids_wrap_without_a_loss() -> None:
    assert taken(2**32 - 1, 0, 1) == ([True] * 3, 0, 0, 0)
