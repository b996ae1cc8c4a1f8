"""Little is under way, and the link is busy all the same."""

import pytest

from mapperd.stream.pacer import MOST_WINDOW, Pacer
from tests.mapperd.stream.shaped import Link

PIECE = 1000
"""Bytes that are sent at once; one more than there is room for may be under way."""


@pytest.mark.parametrize("rate", [8_000, 12_500, 32_000, 1_000_000])
@pytest.mark.parametrize("there_s", [0.0, 0.15, 0.3])
def test_a_steady_link_is_busy_and_its_queue_short(rate: float, there_s: float) -> None:
    link = Link(lambda _: rate, there_s=there_s, back_s=there_s)
    link.fill(15.0)
    before = link.delivered
    link.fill(60.0)
    assert link.delivered - before > 0.9 * rate * 45
    assert link.worst_wait_s(15.0, 60.0) < 0.5 + PIECE / rate


def test_a_link_that_becomes_slower_is_learnt_at_once() -> None:
    link = Link(lambda t: 32_000 if t < 20 else 6_000)
    link.fill(60.0)
    assert link.worst_wait_s(25.5, 60.0) < 0.5 + PIECE / 6_000


def test_a_link_that_becomes_faster_is_used_at_once() -> None:
    link = Link(lambda t: 6_000 if t < 20 else 60_000)
    link.fill(25.0)
    before = link.delivered
    link.fill(35.0)
    assert link.delivered - before > 0.85 * 600_000


def test_it_recovers_from_a_stall() -> None:
    link = Link(lambda _: 32_000, stalled=lambda t: 20 <= t < 30)
    link.fill(20.0)
    assert link.pacer.in_flight <= link.pacer.window + PIECE
    link.fill(29.9)
    assert link.pacer.in_flight <= 32_000  # nothing was piled up meanwhile
    assert link.pacer.quiet_s(link.now_s) > 9
    link.fill(32.0)
    before = link.delivered
    link.fill(42.0)
    assert link.delivered - before > 0.85 * 320_000
    assert link.worst_wait_s(33.0, 42.0) < 0.5


def test_stalls_again_and_again_do_not_empty_it() -> None:
    """As TCP gives after each lost packet: nothing for a while, then all at once."""
    link = Link(lambda _: 32_000, stalled=lambda t: t % 1.0 < 0.3)
    link.fill(10.0)
    before = link.delivered
    link.fill(40.0)
    assert link.delivered - before > 0.85 * 32_000 * 30
    assert link.worst_wait_s(10.0, 40.0) < 1.0


def test_little_to_say_tells_nothing_against_the_link() -> None:
    link = Link(lambda _: 32_000)
    link.fill(10.0)
    rate = link.pacer.rate
    assert rate is not None
    link.trickle(60.0, 0.5)
    assert link.pacer.rate is not None
    assert link.pacer.rate > 0.9 * rate


def test_the_wire_may_become_longer() -> None:
    link = Link(lambda _: 32_000, there_s=0.02, back_s=0.02)
    link.fill(10.0)
    link.there_s = link.back_s = 0.4
    link.fill(40.0)
    before = link.delivered
    link.fill(70.0)
    assert link.delivered - before > 0.8 * 32_000 * 30
    assert link.pacer.round_trip_s == pytest.approx(0.8, abs=0.1)


def test_a_limit_holds_and_starves_nobody() -> None:
    link = Link(lambda _: 1_000_000, there_s=0.01, back_s=0.01, pacer=Pacer(bytes_per_s=2_000))
    link.fill(60.0, piece=300)
    assert 0.9 * 120_000 < link.delivered < 120_000 + 3_000
    small = Link(lambda _: 1_000_000, pacer=Pacer(bytes_per_s=100))
    small.trickle(60.0, 0.1, piece=1_000)
    assert 5_000 < small.delivered < 6_000 + 4_000


def test_what_is_larger_than_the_window_is_sent_when_little_is_under_way() -> None:
    pacer = Pacer()
    assert pacer.fits(100_000, 0.0)
    pacer.note_sent(100_000, 0.0)
    assert not pacer.fits(1, 0.0)
    assert pacer.note_ack(100_000, 1.0)
    assert pacer.fits(200_000, 1.0)


def test_no_client_takes_more_than_the_largest_window() -> None:
    link = Link(lambda _: 1e9, there_s=0.05, back_s=0.05)
    link.fill(3.0, piece=50_000)
    assert link.pacer.window == MOST_WINDOW
    assert link.pacer.in_flight <= MOST_WINDOW + 50_000


def test_acknowledgements_that_cannot_be_are_told() -> None:
    pacer = Pacer()
    pacer.note_sent(100, 0.0)
    assert not pacer.note_ack(101, 0.1)
    assert pacer.note_ack(60, 0.2)
    assert not pacer.note_ack(59, 0.3)
    assert (pacer.in_flight, pacer.quiet_s(10.2)) == (40, 10.0)
    assert pacer.note_ack(100, 11.0)
    assert pacer.quiet_s(99.0) == 0.0
