"""Changes of localization are reported once."""

from dataclasses import replace

import pytest

from mapperd.daemon.status import LocalizationWatch
from mapperd.events import EventLog
from mapperd.localization.status import LocalizationSnapshot
from tests.mapperd.localization.believed import known, snapshot


def reported(*all_facts: LocalizationSnapshot) -> list[tuple[str, str]]:
    events = EventLog(lambda: 0)
    watch = LocalizationWatch(events)
    for one in all_facts:
        watch.update(one)
    return [(event.code, str(event.severity)) for event in events.since(0)[0]]


def test_a_dive_is_reported_in_order() -> None:
    assert reported(
        snapshot(None, known=None),
        snapshot(None),
        snapshot(0.6),
        snapshot(0.6),
        snapshot(0.2),
        snapshot(0.0),
        snapshot(0.0),
        snapshot(None),
        snapshot(0.0),
    ) == [
        ("map_loaded", "notice"),
        ("lost", "warning"),
        ("ambiguous", "warning"),
        ("localized", "notice"),
        ("localized", "notice"),  # after a new start
    ]


def test_another_map_and_a_level_are_reported() -> None:
    first, other = known("/maps/a.yaml"), known("/maps/b.yaml")
    assert reported(
        snapshot(0.0, known=first),
        snapshot(0.0, known=other),
        snapshot(0.0, known=other, std=0.5),
        snapshot(0.0, known=other, std=0.5),
        snapshot(0.0, known=other, std=0.1),
    ) == [
        ("map_loaded", "notice"),
        ("localized", "notice"),
        ("map_loaded", "notice"),
        ("localization_std", "warning"),
        ("localization_std", "notice"),
    ]


def test_what_the_model_does_not_do_is_reported_once() -> None:
    warned = replace(snapshot(0.0), warning="it compares a slice")
    assert reported(snapshot(0.0), warned, warned, snapshot(0.0), warned)[2:] == [
        ("localization_model", "warning"),
        ("localization_model", "warning"),
    ]


def test_text_reports_what_and_where() -> None:
    events = EventLog(lambda: 0)
    LocalizationWatch(events).update(snapshot(0.7, std=0.5))
    texts = [event.text for event in events.since(0)[0]]
    assert texts[0] == "localizing on tank.yaml"
    assert texts[1].endswith("x 1.00 m, y 2.00 m, 0.500 rad at best")
    assert "std_x 0.5 above 0.2" in texts[2]
    assert events.since(0)[0][1].facts == {"elsewhere": pytest.approx(0.7)}
