import io
import os
from typing import Any

import pytest

from mapperd.daemon.journal import Journal, goes_to_journal
from mapperd.events import Event, EventLog, Severity


def event(text: str, severity: Severity = Severity.NOTICE, code: str = "sonar_link") -> Event:
    return Event(1, 0, severity, code, text)


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def journal(**changes: Any) -> tuple[Journal, io.StringIO, Clock]:
    stream, clock = io.StringIO(), Clock()
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
        "<5>disk full (and 3 times more since)",
        "<5>disk full",
    ]


def test_ever_new_texts_take_no_memory() -> None:
    writer, _, _ = journal()
    for i in range(10_000):
        writer.write(event(f"text {i}"))
    assert len(writer._logged) <= 256


class Broken(io.StringIO):
    def write(self, _: str, /) -> int:
        raise BrokenPipeError


def test_nobody_reading_is_no_reason_to_end() -> None:
    Journal(Broken(), Clock(), priorities=True).write(event("hello"))


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
    }
