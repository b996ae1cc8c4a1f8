"""Which of two lines a client is told on, and how much at most."""

from math import inf

import pytest

from mapperd.server.pacer import LOSS_S, Pacer
from mapperd.server.schedule import BLOCKED_S, CALM_S, FAR_S, SLACK_S, STALLS, Lines
from mapperd.server.source_protocol import FIRST, SECOND, Line

TRIP_S = 0.6
HELD_UP_S = 2 * TRIP_S + SLACK_S + 0.01


def two_lines() -> tuple[Lines, Pacer, Pacer]:
    first, second = Pacer(), Pacer()
    first.round_trip_s = first.trip_s = TRIP_S
    lines = Lines(first)
    lines.join(second)
    return lines, first, second


def chosen(lines: Lines, now_s: float, *, in_pass: bool = True) -> tuple[Line, Line | None]:
    again = lines.choose(now_s, in_pass=in_pass)
    return lines.line, again


def test_what_is_held_up_on_the_first_line_is_told_again_on_the_second_once() -> None:
    lines, first, _ = two_lines()
    first.note_sent(1000, 10.0)
    assert chosen(lines, 10.0 + HELD_UP_S - 0.02) == (FIRST, None)
    assert chosen(lines, 10.0 + HELD_UP_S) == (SECOND, FIRST)
    assert chosen(lines, 10.0 + HELD_UP_S + 0.1) == (SECOND, None)
    assert first.note_ack(1000, 11.6)
    assert chosen(lines, 11.7) == (SECOND, None)
    first.note_sent(1000, 12.0)
    assert chosen(lines, 12.0 + HELD_UP_S) == (SECOND, FIRST)  # it was held up anew


def test_it_comes_back_when_the_second_is_held_up_and_the_first_is_not() -> None:
    lines, first, second = two_lines()
    first.note_sent(1000, 10.0)
    assert chosen(lines, 10.0 + HELD_UP_S) == (SECOND, FIRST)
    second.note_sent(700, 12.0)
    assert chosen(lines, 12.0 + HELD_UP_S) == (SECOND, None)  # the first is held up as well
    assert first.note_ack(1000, 13.5)
    assert chosen(lines, 13.6) == (FIRST, SECOND)


def test_a_pass_begins_on_the_line_on_which_nothing_is_overdue_and_stays_there() -> None:
    lines, first, second = two_lines()
    first.note_sent(1000, 10.0)
    overdue_s = 10.0 + TRIP_S + LOSS_S + 0.01
    assert chosen(lines, overdue_s - 0.02, in_pass=False) == (FIRST, None)
    assert chosen(lines, overdue_s, in_pass=True) == (FIRST, None)
    second.note_sent(1000, 10.001)
    assert chosen(lines, overdue_s + 0.01, in_pass=False) == (FIRST, None)  # no better
    assert second.note_ack(1000, 11.0)
    assert chosen(lines, overdue_s + 0.1, in_pass=False) == (SECOND, None)


def test_a_line_on_which_tcp_pauses_is_not_told_on() -> None:
    lines, first, _ = two_lines()
    first.note_sent(3000, 10.0)
    first.note_link(2000, TRIP_S, 10.0, fills=False)
    assert chosen(lines, 10.0 + BLOCKED_S - 0.01) == (FIRST, None)
    assert chosen(lines, 10.0 + BLOCKED_S + 0.01) == (SECOND, None)
    first.note_link(0, TRIP_S, 10.3, fills=False)
    first.note_link(50, TRIP_S, 10.4, fills=False)
    assert first.blocked_s(10.45) == pytest.approx(0.05)


def test_nothing_is_chosen_where_there_is_no_other_line_or_no_round_trip() -> None:
    lines, first, _ = two_lines()
    first.note_sent(1000, 10.0)
    lines.part()
    assert chosen(lines, 20.0, in_pass=False) == (FIRST, None)
    alone = Pacer()
    lines = Lines(alone)
    lines.join(Pacer())
    alone.note_sent(1000, 10.0)
    assert chosen(lines, 20.0, in_pass=False) == (FIRST, None)


def test_a_line_that_is_gone_is_not_told_on() -> None:
    lines, first, _ = two_lines()
    first.note_sent(1000, 10.0)
    assert chosen(lines, 10.0 + HELD_UP_S) == (SECOND, FIRST)
    lines.part()
    assert lines.line == FIRST


def test_both_lines_share_one_budget() -> None:
    first, second = Pacer(2_000), Pacer()
    Lines(first).join(second)
    first.note_sent(first.room(0.0), 0.0)
    assert second.room(0.0) <= 0
    assert 100 <= second.room(0.1) <= 200


def late(pacer: Pacer, times: int, took_s: float) -> None:
    for n in range(times):
        pacer.note_sent(100, 10.0 * n)
        assert pacer.note_ack(pacer.sent, 10.0 * n + took_s)


@pytest.mark.parametrize(
    ("trip_s", "times", "took_s", "expected_advice"),
    [
        (TRIP_S, STALLS, TRIP_S + LOSS_S + 0.01, True),
        (TRIP_S, STALLS - 1, TRIP_S + LOSS_S + 0.01, False),
        (TRIP_S, 10, TRIP_S + LOSS_S - 0.01, False),
        (FAR_S / 2, 10, 3.0, False),  # a near link mends its losses soon enough
        (None, 10, 3.0, False),
    ],
)
def test_a_second_line_is_advised_where_the_link_is_far_and_loses_packets(
    trip_s: float | None, times: int, took_s: float, *, expected_advice: bool
) -> None:
    pacer = Pacer()
    pacer.round_trip_s = trip_s
    lines = Lines(pacer)
    late(pacer, times, took_s)
    assert lines.advised == expected_advice


def test_one_burst_that_comes_late_is_one_stall() -> None:
    pacer = Pacer()
    pacer.round_trip_s = TRIP_S
    for n in range(20):
        pacer.note_sent(100, 0.01 * n)
    for n in range(20):
        assert pacer.note_ack(100 * (n + 1), 1.5 + 0.01 * n)
    assert pacer.stalls == 1


def busy(pacer: Pacer, sent: int, in_network: int, link_rate: float | None) -> None:
    """It was busy, so that its rate is known, and has so many bytes under way."""
    pacer.round_trip_s = TRIP_S
    pacer.rate = 20_000.0
    pacer.note_sent(sent, 0.0)
    pacer.note_link(0, None, 0.0, fills=False, in_network=in_network, link_rate=link_rate)


def test_no_more_is_under_way_on_both_lines_than_the_link_holds() -> None:
    lines, first, second = two_lines()
    busy(first, 50_000, 9_000, 30_000.0)
    busy(second, 50_000, 5_000, 25_000.0)
    holds = 30_000 * (TRIP_S + CALM_S)
    assert lines.calm_room() == pytest.approx(holds - 14_000)
    lines.part()
    assert lines.calm_room() == pytest.approx(holds - 9_000)


def test_a_small_packet_is_no_full_one() -> None:
    lines, first, _ = two_lines()
    busy(first, 600, 1_448, 30_000.0)
    assert lines.calm_room() == pytest.approx(30_000 * (TRIP_S + CALM_S) - 600)


def test_where_tcp_does_not_say_what_the_link_takes_nothing_is_held_back() -> None:
    lines, first, _ = two_lines()
    busy(first, 50_000, 9_000, None)
    assert lines.calm_room() == inf
    idle = Pacer()
    idle.note_link(0, TRIP_S, 0.0, fills=False, in_network=0, link_rate=300.0)
    assert Lines(idle).calm_room() == inf  # of a greeting alone
