"""The order in which blocks wait, against sorting all of them."""

import tracemalloc
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.server import priority_queue as nearest_module
from mapperd.server.map_index import LEAVE, distances_m, vector_of, within
from mapperd.server.priority_queue import NEAR_M, WAITING, BlockQueue, Part
from mapperd.wire.messages import Interest

BLOCK_M = 0.8
ALL = 1 << 14
PARTS: tuple[Part, ...] = ("near", "far", "any")


class Queue:
    """With an oracle beside it, that knows since when each block waits."""

    def __init__(self, keys: NDArray[np.int32]) -> None:
        self.keys, self.since, self.turn = keys, dict[int, int](), 0
        self.pass_turn = 0
        self.queue = BlockQueue(lambda numbers: keys[numbers], BLOCK_M)
        self.queue.make_room(len(keys))
        self.position = np.zeros(3)

    def add(self, numbers: Iterable[int], *, together: bool = False) -> None:
        coming = sorted(set(numbers))
        self.turn += not together
        self.queue.add(np.array(coming, np.int64), self.turn)
        for number in coming:
            self.since.setdefault(number, self.turn)

    def of_pass(self) -> list[tuple[float, ...]]:
        """Near ones of the pass; another begins where none is left."""
        near = self.order(ALL, "near")
        if not any(one[0] <= self.pass_turn for one in near):
            self.pass_turn = self.turn
        return [one for one in near if one[0] <= self.pass_turn]

    def take(self, most: int, part: Part = "any") -> list[int]:
        found = self.nearest(most, part)
        self.queue.remove(np.array(found, np.int64))
        for number in found:
            del self.since[number]
        return found

    def nearest(self, most: int, part: Part = "any") -> list[int]:
        found: list[int] = self.queue.nearest(most, vector_of(self.position), part).tolist()
        return found

    def away_m(self, numbers: Iterable[int]) -> list[float]:
        at = vector_of(self.position)
        assert at is not None
        away: list[float] = distances_m(self.keys[[*numbers]], BLOCK_M, at).tolist()
        return away

    def order(self, most: int, part: Part = "any") -> list[tuple[float, ...]]:
        """What those are like that are to come: far ones have a distance, near ones a turn too."""
        waiting = sorted(self.since)
        found = zip(waiting, self.away_m(waiting), strict=True)
        every: list[tuple[float, ...]] = [
            (self.since[n], away) if away <= NEAR_M else (away,) for n, away in found
        ]
        near: list[tuple[float, ...]] = sorted(one for one in every if len(one) == 2)
        far: list[tuple[float, ...]] = sorted(one for one in every if len(one) == 1)
        if part == "any":
            return (near + far)[:most]
        return (near if part == "near" else far)[:most]


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng([44, 1])


def test_what_waits_longest_nearby_and_then_the_nearest(random: np.random.Generator) -> None:
    every = Queue(random.integers(-20, 20, (600, 3)).astype(np.int32))
    kinds, passes = set(), 0
    for _ in range(400):
        if random.random() < 0.3:
            coming = random.integers(0, 600, int(random.integers(0, 60))).tolist()
            every.add(coming, together=random.random() < 0.3)
        every.position = every.position + random.normal(0.0, 0.5, 3)
        most = int(random.integers(1, 20))
        part = PARTS[int(random.integers(0, 3))]
        expected, since = every.order(most, part), dict(every.since)
        of_pass = [] if part == "far" else every.of_pass()
        found = every.take(most, part)
        if part != "far":
            assert every.queue.near_left == len(of_pass[most:])
            passes += not of_pass[most:]
        away = every.away_m(found)
        sent = zip(found, away, strict=True)
        assert [(since[n], far) if far <= NEAR_M else (far,) for n, far in sent] == expected
        kinds.add((min(away, default=0) <= NEAR_M, max(away, default=99) > NEAR_M))
        waiting = (every.queue.flags & WAITING != 0).nonzero()[0].tolist()
        assert len(every.queue) == len(every.since)
        assert waiting == sorted(every.since)
    assert kinds >= {(True, True), (True, False), (False, True)}
    assert 20 < passes < 250


def test_more_than_are_put_in_order_at_a_time(
    random: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of so many only the nearest are looked at: all that are returned are of them."""
    monkeypatch.setattr(nearest_module, "FRONT", 8)
    every = Queue(random.integers(-40, 40, (600, 3)).astype(np.int32))
    for _ in range(300):
        if random.random() < 0.3:
            every.add(random.integers(0, 600, int(random.integers(0, 60))).tolist())
        every.position = every.position + random.normal(0.0, 0.5, 3)
        most = int(random.integers(1, 7))
        all_m = np.sort(every.away_m(sorted(every.since)))
        found = every.nearest(most)
        assert len(set(found)) == min(most, len(every.since))
        assert set(found) <= every.since.keys()
        away = np.array(every.away_m(found))
        assert (
            np.sort(away[away > NEAR_M]).tolist()
            == [m for m in all_m if m > NEAR_M][: np.count_nonzero(away > NEAR_M)]
        )
        assert np.count_nonzero(away <= NEAR_M) == min(np.count_nonzero(all_m <= NEAR_M), most)
        every.take(most)


def test_what_changes_all_the_time_does_not_starve_what_waits_beside_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Neither where more wait than are put in order at a time, and the vehicle moves."""
    monkeypatch.setattr(nearest_module, "FRONT", 64)
    near = [(x, 0, 0) for x in range(10)]
    far = [(100 + n, n % 7, 0) for n in range(600)]
    every = Queue(np.array(near + far, np.int32))
    every.add(range(len(every.keys)))
    sent: list[int] = []
    for n in range(6):
        every.position = np.array([0.0, 0.2 * n, 0.0])
        every.queue._reach_m = -np.inf  # as if many had come in between
        sent += every.take(2)
        every.add([0, 1])
    assert set(sent) >= set(range(10))


def test_a_pass_ends_though_the_same_blocks_change_all_the_time() -> None:
    every = Queue(np.array([(n, 0, 0) for n in range(8)], np.int32))
    every.add(range(8))
    left = []
    for _ in range(4):
        sent = every.take(2, "near")
        left.append(every.queue.near_left)
        every.add(sent)  # they have changed again
    assert left == [6, 4, 2, 0]
    assert every.take(8, "near") == [0, 1, 2, 3, 4, 5, 6, 7]
    assert every.queue.near_left == 0


def test_what_was_found_together_waits_equally_long() -> None:
    every = Queue(np.array([(n, 0, 0) for n in range(4)], np.int32))
    every.add([3])
    every.add([2, 1], together=True)
    every.add([0])
    assert every.take(4) == [1, 2, 3, 0]


def test_twice_the_front_at_once_hides_nothing_that_is_nearer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(nearest_module, "FRONT", 8)
    every = Queue(np.array([(100 + n, 0, 0) for n in range(40)] + [(20, 0, 0), (15, 0, 0)]))
    every.add(range(30))
    assert every.take(1) == [0]
    every.add(range(30, 42))
    assert every.take(2) == [41, 40]


def test_what_was_reported_goes_later_than_it_came() -> None:
    keys, here = np.array([[10, 0, 0]] * 2, np.int32), (0.5, 0.5, 0.5)
    away_m = distances_m(keys, 1.0, here)[0]
    held = np.array([False, True])
    for radius_m, sent in ((away_m, [True, True]), (away_m - 0.1, [False, True])):
        assert within(keys, 1.0, Interest(radius_m=radius_m), here, held).tolist() == sent
    beyond = Interest(radius_m=away_m / LEAVE - 0.1)
    assert within(keys, 1.0, beyond, here, held).tolist() == [False, False]


MANY, SOME_BYTES = 1 << 18, 4 << 20


def most_bytes(work: Callable[[], object]) -> int:
    """Return the memory that a piece of work takes at most."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_the_nearest_of_many_are_found_in_little_memory(random: np.random.Generator) -> None:
    every = Queue(random.integers(-500, 500, (MANY, 3)).astype(np.int32))
    every.queue.add(np.arange(MANY), 1)
    assert most_bytes(lambda: every.nearest(100)) < SOME_BYTES


def test_distances_take_little_memory_beside_themselves(random: np.random.Generator) -> None:
    keys = random.integers(-500, 500, (MANY, 3)).astype(np.int32)
    assert most_bytes(lambda: distances_m(keys, 1.0, (0.0, 0.0, 0.0))) < 8 * MANY + SOME_BYTES
