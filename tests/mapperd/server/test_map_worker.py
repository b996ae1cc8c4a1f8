"""The map is sent in messages that are worth their heads."""

from types import SimpleNamespace
from typing import Any

import pytest

from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.map_worker import MapWorker, _Order
from mapperd.server.priority_queue import SendRoom
from mapperd.wire.messages import Interest
from tests.mapperd.server.sent_state import SECOND_NS, scatter, source_of
from tests.mapperd.store.dive import CONFIG

ROOM = 10_000


class Sizes:
    """A view whose messages have these sizes."""

    def __init__(self, *sizes: int) -> None:
        self.sizes = [*sizes]
        self.asked: list[int] = []

    near_left = number = 0

    def settle(self, number: int) -> None:
        assert number == 0

    def next(self, _: object, most_bytes: int, part: str) -> bytes | None:
        assert part == "near"
        self.asked.append(most_bytes)
        return bytes(self.sizes.pop(0)) if self.sizes else None


def filled(view: Any, room: int = ROOM) -> list[int]:
    feed: Any = SimpleNamespace(position_m=(0.0, 0.0, 0.0))
    nobody: Any = None
    order = _Order(nobody, view, None, SendRoom(near=room))
    context: Any = SimpleNamespace(limits=SimpleNamespace(clients=1))
    source: Any = SimpleNamespace(info=lambda: None, revision=0, session="s")
    MapWorker(nobody, feed, source, [], context)._fill(order)
    return [len(frame) for frame, *_ in order.frames]


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ([6_000, 3_000, 900, 90], [6_000]),  # the rest of the room waits until there is more
        ([5_000, 3_000], [5_000]),
        ([4_000, 5_000, 900], [4_000, 5_000]),
        ([2_000] * 9, [2_000] * 3),
        ([14_000, 100], [14_000]),
        ([100, 200], [100, 200]),  # all that there was
        ([], []),
    ],
)
def test_the_last_half_of_the_room_is_not_filled_with_small_ones(
    sizes: list[int], expected: list[int]
) -> None:
    view = Sizes(*sizes)
    assert filled(view) == expected
    sent = [sum(expected[:n]) for n in range(len(view.asked))]
    assert view.asked == [ROOM - before for before in sent]


def test_a_real_map_is_reported_in_one_message_each_time() -> None:
    sonar_map = SonarMap(CONFIG)
    scatter(sonar_map, 3, 20_000, reach_m=8.0)
    source = source_of(sonar_map)
    view = source.subscribe(Interest())
    source.look(SECOND_NS)
    turns = [filled(view) for _ in range(6)]
    assert view.left > 0
    assert [len(turn) for turn in turns[2:]] == [1] * 4  # until then sizes are guessed
    assert all(ROOM / 2 <= sum(turn) <= 2 * ROOM for turn in turns)
