"""Messages about the map that overtake each other on two lines, against plain dictionaries."""

from collections import deque
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd.client import EndedError, Interest, MapMirror, StreamError
from mapperd.client import state as module
from mapperd.client.state import Knowledge
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet, encode_blocks
from mapperd.wire.messages import Blocks, Reset, Welcome
from tests.support.stream_server import FACTS

WELCOME = Welcome(
    version=1, server="", vehicle="", session="s", map=FACTS, revision=0, resumed=False, ticket="t"
)
GONE = UNKNOWN
Told = dict[int, int]
"""The first number of a block's key to that of all its cells."""


def block_set(told: Told) -> BlockSet:
    keys = np.zeros((len(told), 3), np.int32)
    keys[:, 0] = list(told)
    cells = np.repeat(np.array(list(told.values()), np.int8)[:, None], CELLS, axis=1)
    return BlockSet(keys, np.zeros(len(told), np.uint32), cells)


def blocks(order: int, told: Told, **more: Any) -> Blocks:
    more = {"revision": order, "stamp_ns": 1} | more
    return Blocks(body=encode_blocks(block_set(told)) if told else b"", order=order, **more)


def held(mirror: MapMirror | None) -> Told:
    assert mirror is not None
    told = mirror.blocks()
    return dict(zip(told.keys[:, 0].tolist(), told.cells[:, 0].tolist(), strict=True))


def known(*, beside: bool = True) -> Knowledge:
    knowledge = Knowledge(Interest(), lambda _: None)
    knowledge.wants_map = True
    knowledge.begin(WELCOME, None)
    if beside:
        knowledge.begin_beside()
    return knowledge


@pytest.mark.parametrize(
    ("first", "second", "result", "taken"),
    [
        ((5, 1), (6, 2), 2, True),
        ((6, 1), (5, 2), 1, False),
        ((5, 1), (5, 2), 2, True),
        ((6, GONE), (5, 2), None, False),
        ((5, GONE), (6, 2), 2, True),
        ((5, GONE), (5, 2), 2, True),
        ((6, 1), (5, GONE), 1, False),
        ((5, 1), (6, GONE), None, True),
        ((0, 1), (0, GONE), None, True),
        ((2**63 - 1, 1), (2**63 - 2, 2), 1, False),
    ],
)
def test_higher_order_holds_whichever_comes_first(
    first: tuple[int, int],
    second: tuple[int, int],
    result: int | None,
    taken: bool,  # noqa: FBT001
) -> None:
    mirror = MapMirror(FACTS, Interest())
    mirror.put(block_set({3: first[1], 4: 7}), 0, first[0])
    keys = mirror.put(block_set({3: second[1], 9: 8}), 0, second[0])
    assert held(mirror) == ({3: result} if result is not None else {}) | {4: 7, 9: 8}
    assert keys[:, 0].tolist() == ([3, 9] if taken else [9])


def test_block_that_came_back_is_as_of_its_newest_message() -> None:
    mirror = MapMirror(FACTS, Interest())
    for order, value in ((5, 1), (7, GONE), (9, 2), (8, GONE), (6, 3)):
        mirror.put(block_set({3: value}), 0, order)
    assert held(mirror) == {3: 2}
    assert mirror.forgotten == 0
    mirror.put(block_set({3: GONE}), 0, 10)
    mirror.put(block_set({4: 1}), 0, 1)  # in the row that is not used any more
    mirror.put(block_set({3: 1}), 0, 9)
    mirror.put(block_set({4: 2}), 0, 1)
    assert held(mirror) == {4: 2}


def test_orders_of_what_is_forgotten_are_kept_no_longer_than_needed() -> None:
    knowledge = known(beside=False)
    mirror = knowledge.mirror
    assert mirror is not None
    knowledge.take(blocks(1, {1: 1, 2: 1}))
    knowledge.take(blocks(2, {1: GONE}))
    assert mirror.forgotten == 0  # the first line alone is in order
    knowledge.begin_beside()
    knowledge.take(blocks(3, {2: GONE}))
    knowledge.take_beside(blocks(6, {3: GONE}))
    assert mirror.forgotten == 2
    knowledge.end_beside()
    assert mirror.forgotten == 1
    knowledge.take(blocks(5, {3: 4, 4: 4}))  # was stuck while the second line said 6
    assert held(mirror) == {4: 4}
    knowledge.take(blocks(7, {}))
    assert mirror.forgotten == 0
    knowledge.take(blocks(8, {3: 5}))
    assert held(mirror) == {3: 5, 4: 4}


def test_orders_of_blocks_stay_in_force_after_the_second_line() -> None:
    knowledge = known()
    knowledge.take_beside(blocks(6, {3: 1}))
    knowledge.end_beside()
    knowledge.take(blocks(5, {3: 2, 4: 2}))
    assert held(knowledge.mirror) == {3: 1, 4: 2}


@pytest.mark.parametrize("by_first", [False, True])
def test_second_line_ends_where_too_much_is_to_be_remembered(
    monkeypatch: pytest.MonkeyPatch,
    by_first: bool,  # noqa: FBT001
) -> None:
    monkeypatch.setattr(module, "MAX_FORGOTTEN", 5)
    knowledge = known()
    mirror = knowledge.mirror
    assert mirror is not None
    take = knowledge.take if by_first else knowledge.take_beside
    take(blocks(10, dict.fromkeys(range(5), GONE)))
    knowledge.take_beside(blocks(11, {9: 1}))
    take(blocks(12, dict.fromkeys(range(5, 8), GONE)))
    assert mirror.forgotten == (0 if by_first else 8)
    with pytest.raises(EndedError) as caught:
        knowledge.take_beside(blocks(13, {9: 2}))
    assert (caught.value.reason, caught.value.is_final) == ("too_many_forgotten", False)
    knowledge.end_beside()
    if not by_first:
        with pytest.raises(EndedError):
            knowledge.begin_beside()
        knowledge.take(blocks(9, dict.fromkeys(range(8), 1)))  # what the first had not said yet
        knowledge.take(blocks(14, {}))
    knowledge.begin_beside()
    knowledge.take_beside(blocks(15, {10: 1}))
    assert held(mirror) == {9: 1, 10: 1}


def test_orders_begin_anew_with_each_first_connection() -> None:
    knowledge = known()
    knowledge.take(blocks(50, {1: 1, 2: 1}, complete=50))
    knowledge.take(Reset(map=FACTS, revision=50, order=50))
    knowledge.take(blocks(51, {1: 1, 2: 1}, complete=51))
    knowledge.take_beside(blocks(60, {2: GONE}))
    knowledge.end_beside()
    again = msgspec.structs.replace(WELCOME, resumed=True)
    knowledge.begin(again, knowledge.resume())
    assert held(knowledge.mirror) == {1: 1}
    knowledge.begin_beside()
    knowledge.take_beside(blocks(1, {1: 2}))
    knowledge.take(blocks(1, {2: 2}, revision=61, complete=61))
    assert held(knowledge.mirror) == {1: 2, 2: 2}
    assert knowledge.is_complete


def test_blocks_of_before_a_reset_are_passed_over_whole() -> None:
    knowledge = known()
    knowledge.take_beside(blocks(4, {1: 1}))
    knowledge.take(Reset(map=FACTS, revision=9, order=7, interest=Interest(detail="counts")))
    for order in (3, 7):
        knowledge.take_beside(blocks(order, {1: 2}, revision=20, complete=20))
    mirror = knowledge.mirror
    assert (held(mirror), knowledge.is_complete) == ({}, False)
    assert mirror is not None
    assert (mirror.revision, mirror.complete) == (0, None)
    knowledge.take(blocks(7, {}, revision=9, complete=9))
    assert mirror.complete == 9


def test_reset_that_its_own_blocks_overtook_is_refused() -> None:
    knowledge = known()
    knowledge.take_beside(blocks(8, {1: 1}))
    with pytest.raises(StreamError, match="overtook"):
        knowledge.take(Reset(map=FACTS, revision=9, order=7))


def test_older_message_takes_nothing_back() -> None:
    knowledge = known()
    mirror = knowledge.mirror
    assert mirror is not None
    knowledge.take_beside(blocks(6, {1: 1}, revision=16, complete=15))
    assert knowledge.is_complete
    knowledge.take(blocks(5, {1: 2}, revision=14, complete=14))
    assert (mirror.revision, mirror.complete) == (16, 15)
    knowledge.take(blocks(5, {1: 2}, revision=14))
    assert knowledge.is_complete
    resume = knowledge.resume()
    assert resume is not None
    assert (resume.revision, resume.newest) == (15, 16)
    knowledge.take_beside(blocks(8, {1: 3}, revision=17))
    knowledge.take(blocks(7, {1: 4}, revision=17, complete=17))
    assert not knowledge.is_complete
    assert held(mirror) == {1: 3}


def test_changes_are_those_of_blocks_that_were_taken() -> None:
    told: list[Any] = []
    knowledge = Knowledge(Interest(), told.append)
    knowledge.wants_map = True
    knowledge.begin(WELCOME, None)
    knowledge.begin_beside()
    knowledge.take_beside(blocks(6, {1: 1}))
    knowledge.take(blocks(5, {1: 2, 2: 2}))
    assert [change.keys[:, 0].tolist() for change in told[-2:]] == [[1], [2]]


def test_daemon_without_orders_is_followed_as_ever() -> None:
    knowledge = known(beside=False)
    for number in range(1, 20):
        knowledge.take(blocks(0, {number % 3: number}, revision=number, complete=number))
        knowledge.take(blocks(0, {5: number if number % 2 else GONE}, revision=number))
        if number == 10:
            knowledge.take(Reset(map=FACTS, revision=10))
    assert held(knowledge.mirror) == {0: 18, 1: 19, 2: 17, 5: 19}
    assert knowledge.mirror is not None
    assert knowledge.mirror.forgotten == 0


def test_what_was_distrusted_is_not_gone_on_from_although_the_connection_lives() -> None:
    knowledge = known()
    knowledge.take(blocks(1, {1: 1}, complete=1))
    knowledge.distrust()
    knowledge.take(blocks(2, {1: 2}, complete=2))
    assert (knowledge.resume(), knowledge.ticket) == (None, "")
    knowledge.begin(WELCOME, None)
    knowledge.take(blocks(1, {1: 1}, complete=1))
    assert knowledge.resume() is not None


class TwoLines:
    """A daemon that says what it should, and lines that hold it back for any time."""

    def __init__(self) -> None:
        self.knowledge = known(beside=False)
        self.map: Told = {}
        self.lines: tuple[deque[Blocks | Reset], deque[Blocks | Reset]] = (deque(), deque())
        self.is_open = False
        self.order = 0
        self.floor = -1
        self.heard: dict[int, tuple[int, int]] = {}
        self.told: dict[int, Told] = {}

    def tell(self, line: int, keys: list[int]) -> None:
        """Of a reset that is under way the second line says nothing."""
        waits = any(isinstance(message, Reset) for message in self.lines[0])
        self.order += 1
        told = {key: self.map.get(key, GONE) for key in keys}
        self.told[self.order] = told
        self.lines[line and self.is_open and not waits].append(blocks(self.order, told))

    def tell_again(self, line: int) -> None:
        """What is stuck on the other one."""
        for stuck in list(self.lines[1 - line]):
            if isinstance(stuck, Blocks):
                self.tell(line, list(self.told[stuck.order]))

    def reset(self) -> None:
        self.map.clear()
        self.lines[0].append(Reset(map=FACTS, revision=self.order, order=self.order))

    def open(self) -> None:
        if not self.is_open:
            self.knowledge.begin_beside()
            self.is_open = True

    def cut(self) -> None:
        lost = list(self.lines[1])
        self.lines[1].clear()
        self.is_open = False
        self.knowledge.end_beside()
        for message in lost:
            assert isinstance(message, Blocks)
            self.tell(0, list(self.told[message.order]))

    def hear(self, line: int) -> None:
        if not self.lines[line]:
            return
        message = self.lines[line].popleft()
        mirror = self.knowledge.mirror
        assert mirror is not None
        before = mirror.revision
        if isinstance(message, Reset):
            self.knowledge.take(message)
            self.heard = {}
            self.floor = message.order
            return
        (self.knowledge.take_beside if line else self.knowledge.take)(message)
        if message.order > self.floor:
            for key, value in self.told[message.order].items():
                self.heard[key] = max((message.order, value), self.heard.get(key, (-1, 0)))
        assert mirror.revision >= before
        newest = {key: value for key, (_, value) in self.heard.items() if value != GONE}
        assert held(mirror) == newest


KEYS = st.integers(0, 5)
DOINGS = st.one_of(
    st.tuples(st.just("put"), st.integers(0, 1), st.dictionaries(KEYS, st.integers(-9, 9))),
    st.tuples(st.just("remove"), st.integers(0, 1), st.lists(KEYS, unique=True)),
    st.tuples(st.just("again"), st.integers(0, 1)),
    st.tuples(st.just("hear"), st.integers(0, 1)),
    st.tuples(st.just("hear"), st.integers(0, 1)),
    st.tuples(st.sampled_from(["reset", "open", "open", "cut"])),
)


@given(st.lists(DOINGS, max_size=40), st.lists(st.integers(0, 1), max_size=20))
@settings(max_examples=300, deadline=None, derandomize=True)
def test_map_is_the_daemons_however_two_lines_bring_it(
    doings: list[tuple[Any, ...]], ending: list[int]
) -> None:
    daemon = TwoLines()
    daemon.open()
    for what, *more in doings:
        if what == "put":
            line, changes = more
            daemon.map.update(changes)
            daemon.tell(line, list(changes))
        elif what == "remove":
            line, keys = more
            for key in keys:
                daemon.map.pop(key, None)
            daemon.tell(line, keys)
        elif what == "again":
            daemon.tell_again(more[0])
        elif what == "hear":
            daemon.hear(more[0])
        else:
            getattr(daemon, what)()
    for line in ending:
        daemon.hear(line)
    while any(daemon.lines):
        daemon.hear(0)
        daemon.hear(1)
    assert held(daemon.knowledge.mirror) == daemon.map
    daemon.cut()
    daemon.tell(0, [])
    daemon.hear(0)
    assert daemon.knowledge.mirror is not None
    assert daemon.knowledge.mirror.forgotten == 0
