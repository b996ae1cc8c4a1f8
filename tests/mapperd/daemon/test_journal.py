import io
import os
from typing import Any

import pytest

from mapperd.daemon.systemd import Journal, goes_to_journal
from mapperd.events import SEPARATE, Event, EventLog, Severity
from tests.support.clocks import StandingClock


def event(text: str, severity: Severity = Severity.NOTICE, code: str = "sonar_link") -> Event:
    return Event(1, 0, severity, code, text)


def journal(**changes: Any) -> tuple[Journal, io.StringIO, StandingClock]:
    stream, clock = io.StringIO(), StandingClock()
    return Journal(stream, clock, **({"priorities": True} | changes)), stream, clock


@pytest.mark.parametrize(
    ("severity", "mark"),
    [
        (Severity.ERROR, "<3>"),
        (Severity.WARNING, "<4>"),
        (Severity.NOTICE, "<5>"),
        (Severity.INFO, "<6>"),
        (Severity.DEBUG, "<7>"),
    ],
)
def test_priorities_are_the_journals(severity: Severity, mark: str) -> None:
    writer, stream, _ = journal(min_severity=Severity.DEBUG)
    writer.write(event("sonar: pinging", severity))
    assert stream.getvalue() == f"{mark}sonar: pinging\n"


def test_people_read_no_priorities() -> None:
    writer, stream, _ = journal(priorities=False)
    writer.write(event("sonar: pinging"))
    assert stream.getvalue() == "mapperd: sonar: pinging\n"


def test_less_severe_is_left_out() -> None:
    writer, stream, _ = journal()
    writer.write(event("detail", Severity.DEBUG))
    assert stream.getvalue() == ""


def test_an_event_is_one_line_and_cannot_forge_another() -> None:
    writer, stream, _ = journal()
    writer.write(event("name\n<3>all is lost"))
    assert stream.getvalue() == "<5>name <3>all is lost\n"


def test_repeats_are_counted_and_reported_once() -> None:
    writer, stream, clock = journal()
    for clock.now_s in (0.0, 1.0, 2.0, 9.9):
        writer.write(event("disk full"))
    writer.write(event("another"))
    clock.now_s = 10.0
    writer.write(event("disk full"))
    clock.now_s = 30.0
    writer.write(event("disk full"))
    assert stream.getvalue().splitlines() == [
        "<5>disk full",
        "<5>another",
        "<5>disk full (repeated 3 times since)",
        "<5>disk full",
    ]


def test_lines_of_an_event_that_goes_on_become_rare() -> None:
    writer, stream, clock = journal()
    for second in range(24 * 3600):
        clock.now_s = float(second)
        writer.write(event("odometry: backing off"))
    assert len(stream.getvalue().splitlines()) < 40


def test_ever_new_texts_take_no_memory() -> None:
    writer, _, _ = journal()
    for i in range(10_000):
        writer.write(event(f"text {i}"))
    assert len(writer._logged) <= 256


class Broken(io.StringIO):
    def write(self, _: str, /) -> int:
        raise BrokenPipeError


def test_nobody_reading_is_no_reason_to_end() -> None:
    Journal(Broken(), StandingClock(), priorities=True).write(event("hello"))


def test_only_the_journals_own_stream_gets_priorities() -> None:
    reader, writer = os.pipe()
    facts = os.fstat(writer)
    named = {"JOURNAL_STREAM": f"{facts.st_dev}:{facts.st_ino}"}
    assert goes_to_journal(named, writer)
    assert not goes_to_journal({}, writer)
    assert not goes_to_journal({"JOURNAL_STREAM": "1:2"}, writer)
    os.close(writer)
    assert not goes_to_journal(named, writer)
    os.close(reader)


def test_events_are_numbered_kept_for_a_while_and_reported() -> None:
    log = EventLog(lambda: 5_000_000_000, kept=3)
    reported: list[int] = []
    end = log.listen(lambda one: reported.append(one.number))
    for i in range(5):
        log.add(Severity.INFO, "code", f"text {i}", range_m=i)
    end()
    log.add(Severity.ERROR, "code", "not reported")
    kept, lost = log.since(1)
    assert reported == [1, 2, 3, 4, 5]
    assert [one.number for one in kept] == [4, 5, 6]
    assert lost == 2
    assert log.since(6) == ([], 0)
    assert log.since(4)[1] == 0
    assert log.last == 6
    assert kept[0].plain() == {
        "number": 4,
        "t_s": 5.0,
        "severity": "info",
        "code": "code",
        "text": "text 3",
        "facts": {"range_m": 3},
        "count": 1,
        "first_s": 5.0,
    }


def test_repeated_events_are_one_entry_with_a_count_and_the_last_time() -> None:
    clock = StandingClock()
    log = EventLog(lambda: round(clock() * 1e9))
    log.add(Severity.NOTICE, "sonar_link", "sonar: pinging")
    for clock.now_s in range(0, 4 * 3600, 5):  # two links that nobody answers
        for name in ("dvl", "imu"):
            for phase in ("opening", "backing off"):
                log.add(Severity.NOTICE, "odometry_link", f"{name}: {phase}")
    events, discarded = log.since(0)
    assert discarded == 0
    assert len(events) == 1 + 4 * SEPARATE
    assert [one.text for one in events[:2]] == ["sonar: pinging", "dvl: opening"]
    assert [one.count for one in events[:-4]] == [1] * 17
    for one in events[-4:]:
        plain = one.plain()
        assert (plain["count"], plain["first_s"], plain["t_s"]) == (2876, 20.0, 14395.0)
    assert log.since(log.last - 1)[0][0].count == 2876  # who follows the log receives repeats


def test_states_of_a_link_repeat_whatever_numbers_are_in_their_texts() -> None:
    clock = StandingClock()
    log = EventLog(lambda: round(clock() * 1e9))
    writer, stream, journal_clock = journal()
    log.listen(writer.write)
    for clock.now_s in range(0, 4 * 3600, 5):
        journal_clock.now_s = float(clock.now_s)
        for address in ("10.0.0.1", "10.0.0.2"):
            text = f"sonar: silent: no ping for {5 + clock.now_s / 7000:.1f} s"
            facts = {"state": "silent", "address": address}
            log.add(Severity.NOTICE, "sonar_link", text, **facts)
    events, discarded = log.since(0)
    assert (len(events), discarded) == (2 * SEPARATE, 0)
    assert "no ping for 7.1 s" in events[-1].text
    assert len(stream.getvalue().splitlines()) < 40


def test_an_event_long_after_another_is_its_own_entry() -> None:
    clock = StandingClock()
    log = EventLog(lambda: round(clock() * 1e9))
    for clock.now_s in (*range(10), 610):
        log.add(Severity.WARNING, "behind", "pings come faster than they can be mapped")
    assert [one.count for one in log.since(0)[0]] == [1, 1, 1, 1, 6, 1]


def test_no_code_displaces_the_others() -> None:
    log = EventLog(lambda: 0, kept=10)
    log.add(Severity.ERROR, "store_damaged", "the map is damaged")
    for i in range(1000):
        log.add(Severity.WARNING, "lost", f"localization is lost at x {i} m")
    log.add(Severity.NOTICE, "map_saved", "written")
    found, missed, after = [], 0, 0
    while after < log.last:  # as one that follows the log
        events, discarded = log.since(after)
        found += events
        missed += discarded
        after = events[-1].number
    assert [one.code for one in found] == ["store_damaged", *["lost"] * 8, "map_saved"]
    assert missed == 1002 - 10
