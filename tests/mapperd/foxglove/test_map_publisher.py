"""When the map is published, and how often."""

import math
from typing import Any

import numpy as np
import pytest

from mapperd.client.changes import MapChanged
from mapperd.client.mirror import MapMirror
from mapperd.foxglove import map_publisher
from mapperd.foxglove.channels import ChannelMessage
from mapperd.foxglove.map_publisher import LIVE, RECORDING, MapPublisher, PublishPace
from mapperd.wire.messages import Interest
from tests.mapperd.foxglove.foxglove_fakes import MAP_INFO, T0, block, points_of_cloud
from tests.mapperd.foxglove.test_channels import decoded

KEY = (1, -2, 3)


class ChangingMap:
    """A map that changes, and its publisher."""

    def __init__(self, pace: PublishPace) -> None:
        self.mirror = MapMirror(MAP_INFO, Interest())
        self.publisher = MapPublisher(pace)

    def change(self, cells: dict[int, int], key: tuple[int, int, int] = KEY) -> None:
        self.mirror.put(block(key, cells), T0)
        self.publisher.note(MapChanged(np.array([key], np.int32), T0, 0))

    def topics(self, now_s: float, **more: Any) -> list[str]:
        return [message.topic for message in self.publisher.due(self.mirror, now_s, 5, **more)]


def test_a_viewer_gets_the_whole_map_once_a_second_while_it_changes() -> None:
    changing = ChangingMap(LIVE)
    assert changing.topics(0.0) == ["/map"]
    changing.change({0: 8})
    assert changing.topics(0.9) == []
    assert changing.topics(1.0) == ["/map"]
    assert changing.topics(9.0) == []


def test_a_large_map_is_reported_more_seldom_and_its_changes_meanwhile() -> None:
    changing = ChangingMap(PublishPace(bytes_per_s=24 * 100))
    for x in range(4):
        changing.change(dict.fromkeys(range(100), 8), (x, 0, 0))
    assert changing.topics(0.0) == ["/map"]
    changing.change({5: 8})
    assert changing.topics(1.0) == ["/map_changes"]
    assert changing.topics(2.0) == []
    assert changing.topics(4.0) == ["/map"]


def test_a_recording_gets_changes_until_they_are_as_many_as_the_map() -> None:
    changing = ChangingMap(RECORDING)
    changing.change(dict.fromkeys(range(10), 8))
    assert changing.topics(0.0) == ["/map"]
    topics = []
    for k in range(1, 6):
        changing.change(dict.fromkeys(range(4), 8), (k, 9, 9))
        topics += changing.topics(float(k))
    assert topics == ["/map_changes", "/map_changes", "/map_changes", "/map", "/map_changes"]
    changing.change({1: 8})
    assert changing.topics(5.5) == []
    assert changing.topics(64.0) == ["/map"]
    assert changing.topics(200.0, last=True) == []
    changing.change({2: 8})
    assert changing.topics(200.1, last=True) == ["/map"]


def test_changes_of_what_is_not_occupied_are_not_reported() -> None:
    changing = ChangingMap(PublishPace(share=math.inf))
    changing.topics(0.0)
    changing.change({0: -8})
    assert changing.topics(1.0) == []


def test_a_new_map_and_a_new_listener_are_reported_all() -> None:
    changing = ChangingMap(RECORDING)
    changing.change({0: 8})
    changing.topics(0.0)
    changing.publisher.renew()
    assert changing.topics(0.1) == ["/map"]
    changing.mirror.forget()
    changing.publisher.reset()
    (message,) = changing.publisher.due(changing.mirror, 0.2, 77)
    assert (message.topic, message.stamp_ns) == ("/map", 77)


def test_a_large_map_is_read_in_slices_and_what_changes_meanwhile_is_reported_after(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(map_publisher, "SLICE", 2)
    changing = ChangingMap(PublishPace(bytes_per_s=24 * 2))
    for x in range(5):
        changing.change({0: 8, 1: 8}, (x, 0, 0))
    assert changing.topics(0.0) == []
    changing.change({1: 8}, (0, 0, 0))
    changing.change({0: 8}, (9, 0, 0))
    changing.change({}, (4, 0, 0))
    assert changing.topics(0.1) == []
    changing.publisher.renew()
    (whole,) = changing.publisher.due(changing.mirror, 0.2, 5)
    assert whole.topic == "/map"
    seen = _centres(whole)
    assert len(seen) == 8
    (changes,) = changing.publisher.due(changing.mirror, 1.3, 5)
    assert changes.topic == "/map_changes"
    for *place, occupied in _centres(changes, "occupied"):
        seen = seen | {tuple(place)} if occupied else seen - {tuple(place)}
    centres = changing.mirror.cells().centres_m.astype(np.float32)
    assert seen == {tuple(row) for row in centres.tolist()}
    assert [changing.topics(4.3 + k / 10) for k in range(4)] == [[], [], ["/map"], []]
    assert changing.topics(99.0) == []


def test_a_map_that_is_half_read_is_left_for_another_and_ended_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(map_publisher, "SLICE", 1)
    changing = ChangingMap(LIVE)
    for x in range(3):
        changing.change({0: 8}, (x, 0, 0))
    assert changing.topics(0.0) == []
    changing.mirror.forget()
    changing.publisher.reset()
    changing.change({7: 8}, (8, 8, 8))
    (message,) = changing.publisher.due(changing.mirror, 0.1, 5)
    assert len(_centres(message)) == 1
    for x in range(3):
        changing.change({0: 8}, (x, 0, 0))
    assert changing.topics(2.0) == []
    changing.change({1: 8})
    (message,) = changing.publisher.due(changing.mirror, 2.1, 5, last=True)
    assert len(_centres(message)) == 5


def _centres(message: ChannelMessage, *more: str) -> set[tuple[Any, ...]]:
    rows = points_of_cloud(decoded(message.message))
    return {tuple(row[name].item() for name in ("x", "y", "z", *more)) for row in rows}
