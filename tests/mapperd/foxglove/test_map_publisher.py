"""When the map is told, and how often."""

import math
from typing import Any

import numpy as np
import pytest

from mapperd.client.changes import MapChanged
from mapperd.client.mirror import MapMirror
from mapperd.foxglove import map_publisher
from mapperd.foxglove.channels import ChannelMessage
from mapperd.foxglove.map_publisher import LIVE, RECORDING, MapPublisher, Pace
from mapperd.wire.messages import Interest
from tests.mapperd.foxglove.foxglove_fakes import FACTS, T0, block, points_of_cloud
from tests.mapperd.foxglove.test_channels import decoded

KEY = (1, -2, 3)


class Told:
    """A map that changes, and who tells of it."""

    def __init__(self, pace: Pace) -> None:
        self.mirror = MapMirror(FACTS, Interest())
        self.teller = MapPublisher(pace)

    def change(self, cells: dict[int, int], key: tuple[int, int, int] = KEY) -> None:
        self.mirror.put(block(key, cells), T0)
        self.teller.note(MapChanged(np.array([key], np.int32), T0, 0))

    def topics(self, now_s: float, **more: Any) -> list[str]:
        return [said.topic for said in self.teller.due(self.mirror, now_s, 5, **more)]


def test_a_viewer_gets_the_whole_map_once_a_second_while_it_changes() -> None:
    told = Told(LIVE)
    assert told.topics(0.0) == ["/map"]
    told.change({0: 8})
    assert told.topics(0.9) == []
    assert told.topics(1.0) == ["/map"]
    assert told.topics(9.0) == []


def test_a_large_map_is_told_more_seldom_and_its_changes_meanwhile() -> None:
    told = Told(Pace(bytes_per_s=24 * 100))
    for x in range(4):
        told.change(dict.fromkeys(range(100), 8), (x, 0, 0))
    assert told.topics(0.0) == ["/map"]
    told.change({5: 8})
    assert told.topics(1.0) == ["/map_changes"]
    assert told.topics(2.0) == []
    assert told.topics(4.0) == ["/map"]


def test_a_recording_gets_changes_until_they_are_as_many_as_the_map() -> None:
    told = Told(RECORDING)
    told.change(dict.fromkeys(range(10), 8))
    assert told.topics(0.0) == ["/map"]
    said = []
    for k in range(1, 6):
        told.change(dict.fromkeys(range(4), 8), (k, 9, 9))
        said += told.topics(float(k))
    assert said == ["/map_changes", "/map_changes", "/map_changes", "/map", "/map_changes"]
    told.change({1: 8})
    assert told.topics(5.5) == []
    assert told.topics(64.0) == ["/map"]
    assert told.topics(200.0, last=True) == []
    told.change({2: 8})
    assert told.topics(200.1, last=True) == ["/map"]


def test_changes_of_what_is_not_occupied_are_not_told() -> None:
    told = Told(Pace(share=math.inf))
    told.topics(0.0)
    told.change({0: -8})
    assert told.topics(1.0) == []


def test_a_new_map_and_a_new_listener_are_told_all() -> None:
    told = Told(RECORDING)
    told.change({0: 8})
    told.topics(0.0)
    told.teller.renew()
    assert told.topics(0.1) == ["/map"]
    told.mirror.forget()
    told.teller.reset()
    (said,) = told.teller.due(told.mirror, 0.2, 77)
    assert (said.topic, said.stamp_ns) == ("/map", 77)


def test_a_large_map_is_read_in_slices_and_what_changes_meanwhile_is_told_after(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(map_publisher, "SLICE", 2)
    told = Told(Pace(bytes_per_s=24 * 2))
    for x in range(5):
        told.change({0: 8, 1: 8}, (x, 0, 0))
    assert told.topics(0.0) == []
    told.change({1: 8}, (0, 0, 0))
    told.change({0: 8}, (9, 0, 0))
    told.change({}, (4, 0, 0))
    assert told.topics(0.1) == []
    told.teller.renew()
    (whole,) = told.teller.due(told.mirror, 0.2, 5)
    assert whole.topic == "/map"
    seen = _centres(whole)
    assert len(seen) == 8
    (changes,) = told.teller.due(told.mirror, 1.3, 5)
    assert changes.topic == "/map_changes"
    for *place, occupied in _centres(changes, "occupied"):
        seen = seen | {tuple(place)} if occupied else seen - {tuple(place)}
    centres = told.mirror.cells().centres_m.astype(np.float32)
    assert seen == {tuple(row) for row in centres.tolist()}
    assert [told.topics(4.3 + k / 10) for k in range(4)] == [[], [], ["/map"], []]
    assert told.topics(99.0) == []


def test_a_map_that_is_half_read_is_left_for_another_and_ended_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(map_publisher, "SLICE", 1)
    told = Told(LIVE)
    for x in range(3):
        told.change({0: 8}, (x, 0, 0))
    assert told.topics(0.0) == []
    told.mirror.forget()
    told.teller.reset()
    told.change({7: 8}, (8, 8, 8))
    (said,) = told.teller.due(told.mirror, 0.1, 5)
    assert len(_centres(said)) == 1
    for x in range(3):
        told.change({0: 8}, (x, 0, 0))
    assert told.topics(2.0) == []
    told.change({1: 8})
    (said,) = told.teller.due(told.mirror, 2.1, 5, last=True)
    assert len(_centres(said)) == 5


def _centres(said: ChannelMessage, *more: str) -> set[tuple[Any, ...]]:
    rows = points_of_cloud(decoded(said.message))
    return {tuple(row[name].item() for name in ("x", "y", "z", *more)) for row in rows}
