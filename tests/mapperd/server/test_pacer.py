"""Links are busy, and what waits in buffers is little: against a TCP in simulated time."""

import pytest

from mapperd.server.pacer import (
    FIRST_RATE,
    MAX_IN_FLIGHT,
    MAX_SMALLEST_BYTES,
    MIN_BURST,
    MIN_UNSENT,
    MIN_WINDOW,
    QUEUE_S,
    UNSENT_S,
    Pacer,
)
from tests.mapperd.server.shaped import MIN_IN_FLIGHT_BYTES, Link

CALM = pytest.mark.parametrize("calm", [True, False])


def most_waiting_s(rate: float, round_trip_s: float, piece: int, *, calm: bool) -> float:
    """In buffers, beyond the wire.

    A calm TCP has a second round trip on its way, and is given a little beyond. In the network of
    one that fills buffers, `QUEUE_S` waits beyond the wire, or the smallest window.
    """
    unsent_s = max(UNSENT_S, MIN_UNSENT / rate)
    if calm:
        return unsent_s + max(round_trip_s, MIN_IN_FLIGHT_BYTES / rate) + 2 * piece / rate
    return max(2 * QUEUE_S, MIN_WINDOW / rate) + 2 * piece / rate


@CALM
@pytest.mark.parametrize(
    ("rate", "piece"),
    [(8_000, 1_000), (32_000, 1_000), pytest.param(1e6, 10_000, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("there_s", [0.0, 0.15, 0.3])
@pytest.mark.slow
def test_a_steady_link_is_busy_and_little_waits(
    rate: float, piece: int, there_s: float, *, calm: bool
) -> None:
    link = Link(lambda _: rate, there_s=there_s, back_s=there_s, calm=calm)
    link.fill(15.0, piece)
    before = link.delivered
    link.fill(60.0, piece)
    assert link.delivered - before > 0.9 * rate * 45
    assert link.worst_wait_s(15.0, 60.0) < most_waiting_s(rate, 2 * there_s, piece, calm=calm)


@CALM
def test_little_waits_from_the_beginning(*, calm: bool) -> None:
    """When nobody knows yet what the link is."""
    link = Link(lambda _: 8_000, calm=calm)
    link.fill(15.0)
    assert link.worst_wait_s(0.0, 15.0) < 1.4
    assert link.delivered > 0.85 * 8_000 * 15


@CALM
def test_a_link_that_becomes_slower_is_noticed(*, calm: bool) -> None:
    link = Link(lambda t: 32_000 if t < 20 else 6_000, calm=calm)
    link.fill(60.0)
    # Of a TCP that sends all that it is given, Linux keeps the highest rate.
    stale_s = 0.0 if calm else UNSENT_S * 32_000 / 6_000
    assert link.worst_wait_s(40.0, 60.0) < most_waiting_s(6_000, 0.3, 1_000, calm=calm) + stale_s


@CALM
def test_a_link_that_becomes_faster_is_used(*, calm: bool) -> None:
    link = Link(lambda t: 6_000 if t < 20 else 60_000, calm=calm)
    link.fill(27.0)
    before = link.delivered
    link.fill(37.0)
    assert link.delivered - before > 0.85 * 600_000


@CALM
def test_nothing_is_piled_up_in_a_blackout(*, calm: bool) -> None:
    link = Link(lambda t: 0 if 20 <= t < 30 else 32_000, calm=calm)
    link.fill(20.0)
    allowed = max(link.pacer.window + UNSENT_S * 32_000, link.pacer.in_flight)
    link.fill(29.9)
    assert link.unsent <= UNSENT_S * 1.2 * 32_000 + 1_000
    assert link.pacer.in_flight <= allowed + 1_000
    assert link.pacer.quiet_s(link.now_s) > 9
    link.fill(33.0)
    before = link.delivered
    link.fill(43.0)
    assert link.delivered - before > 0.85 * 320_000
    assert link.worst_wait_s(33.0, 43.0) < most_waiting_s(32_000, 0.3, 1_000, calm=calm)


@CALM
@pytest.mark.parametrize("stall_s", [0.3, 0.9])
def test_stalls_again_and_again_do_not_empty_it(stall_s: float, *, calm: bool) -> None:
    """As TCP gives after each lost packet: nothing for a while, then all at once."""
    link = Link(lambda _: 32_000, stalled=lambda t: t % 2.0 < stall_s, calm=calm)
    link.fill(10.0)
    before = link.delivered
    link.fill(40.0)
    used = (link.delivered - before) / (32_000 * 30)
    assert used > 0.85
    bound_s = most_waiting_s(32_000, 0.3, 1_000, calm=calm)
    assert link.worst_wait_s(10.0, 40.0) < stall_s + bound_s


@pytest.mark.parametrize("every_s", [0.1, 0.5])
def test_little_to_report_reports_nothing_against_the_link(every_s: float) -> None:
    """Whether all has arrived before more is sent, or something is always under way."""
    link = Link(lambda _: 32_000)
    link.fill(10.0)
    rate = link.pacer.rate
    assert rate is not None
    link.trickle(60.0, every_s)
    assert link.pacer.rate is not None
    assert link.pacer.rate > 0.9 * rate


def test_a_first_word_is_silent_of_how_fast_a_link_is() -> None:
    link = Link(lambda _: 32_000)
    link.send(100)
    while link.pacer.in_flight:
        link.step()
    assert link.pacer.rate == FIRST_RATE
    link.fill(5.0)
    assert link.pacer.rate == pytest.approx(32_000, rel=0.2)


@pytest.mark.slow
def test_the_wire_may_become_longer() -> None:
    link = Link(lambda _: 32_000, there_s=0.02, back_s=0.02)
    link.fill(10.0)
    assert link.pacer.round_trip_s is not None
    assert link.pacer.round_trip_s < 0.3
    link.there_s = link.back_s = 0.4
    link.fill(60.0)
    before = link.delivered
    link.fill(90.0)
    assert link.delivered - before > 0.85 * 32_000 * 30
    assert 0.8 <= link.pacer.round_trip_s < 0.8 + most_waiting_s(32_000, 0.8, 1_000, calm=True)


def test_a_limit_holds_and_starves_nobody() -> None:
    link = Link(lambda _: 1_000_000, there_s=0.01, back_s=0.01, pacer=Pacer(bytes_per_s=2_000))
    link.fill(60.0, piece=300)
    assert 0.9 * 120_000 < link.delivered < 120_000 + 3_000
    small = Link(lambda _: 1_000_000, pacer=Pacer(bytes_per_s=100))
    small.trickle(60.0, 0.1, piece=1_000)
    assert 5_000 < small.delivered < 6_000 + 4_000


def test_a_silence_saves_nothing_up_for_a_limit() -> None:
    pacer = Pacer(bytes_per_s=10_000)
    assert pacer.room(0.0) <= pacer.room(1000.0) <= MIN_BURST


@pytest.mark.parametrize("limit", [0, 100, 4_000, 1_000_000])
@pytest.mark.parametrize("rate", [None, 1_000.0, 32_000.0, 1e7])
def test_what_is_worth_a_message_always_finds_room(limit: int, rate: float | None) -> None:
    """Of a link that is empty, however small the window has become."""
    pacer = Pacer(bytes_per_s=limit)
    pacer.rate = rate
    assert pacer.least() <= MAX_SMALLEST_BYTES
    for round_trip_s in (None, 0.001, 0.6):
        pacer.note_link(0, round_trip_s, round_trip_s, 0, rate)
        pacer.room(0.0)
        assert 0 < pacer.least() <= pacer.room(1_000.0) * 0.6
    if limit == 0 and rate == 32_000.0:
        assert pacer.least() == 1_920


def test_what_is_large_has_its_turn_though_something_is_always_under_way() -> None:
    link = Link(lambda _: 4_000)
    sent = 0
    while link.now_s < 60.0:
        link.trickle(link.now_s + 0.1, 0.1, piece=50)
        if link.pacer.fits(10_000, link.now_s):
            link.send(10_000)
            sent += 1
        assert link.pacer.in_flight > 0
    assert sent > 15


def test_what_is_larger_than_the_window_is_sent_when_nothing_is_under_way() -> None:
    pacer = Pacer()
    assert pacer.fits(1_000_000, 0.0)
    pacer.note_sent(1_100_000, 0.0)
    assert not pacer.fits(1, 0.0)
    assert pacer.note_ack(1_100_000, 1.0)
    assert pacer.fits(2_000_000, 1.0)


def test_no_client_takes_more_than_the_largest_window() -> None:
    link = Link(lambda _: 1e9, there_s=0.05, back_s=0.05)
    link.fill(5.0, piece=50_000)
    assert link.pacer.window == MAX_IN_FLIGHT
    assert link.pacer.in_flight <= MAX_IN_FLIGHT + 50_000


def test_acknowledgements_that_cannot_be_are_reported() -> None:
    pacer = Pacer()
    pacer.note_sent(100, 0.0)
    assert not pacer.note_ack(101, 0.1)
    assert pacer.note_ack(60, 0.2)
    assert not pacer.note_ack(59, 0.3)
    assert (pacer.in_flight, pacer.quiet_s(10.2)) == (40, 10.0)
    assert pacer.note_ack(100, 11.0)
    assert pacer.quiet_s(99.0) == 0.0
