"""A client with two lines of which either may be held up, and the daemon's end of them."""

from collections import deque

import numpy as np

from mapperd.server.map_source import MapSource
from mapperd.server.source_protocol import FIRST, SECOND, Line
from mapperd.wire.blocks import BlockSet, decode_blocks
from mapperd.wire.messages import Blocks, Interest, Reset
from tests.mapperd.server.told import SECOND_NS, Client, scatter

Delivery = tuple[Blocks | Reset, int]


class TwoLines:
    """Of each block it keeps the order of what it holds, as docs/reference/map-stream.md says."""

    def __init__(self, source: MapSource, interest: Interest, most_bytes: int = 1500) -> None:
        self.source = source
        self.most_bytes = most_bytes
        self.client = Client(source, interest)
        self.way: list[deque[Delivery]] = [deque(), deque()]
        self.used = [0, 0]
        self.has_second = self.is_complete = False
        self.orders: dict[tuple[int, ...], int] = {}
        self.floor = self.told_order = 0
        self.place = (0.0, 0.0, 0.0)

    def tell(self, line: Line, messages: int) -> None:
        view = self.client.view
        view.settle(self.used[FIRST], FIRST)
        view.settle(self.used[SECOND], SECOND)
        line = view.tell_on(line if self.has_second else FIRST)
        for _ in range(messages):
            message = view.next_message(self.place, self.most_bytes)
            if message is None:
                return
            assert line == FIRST or isinstance(message, Blocks)
            assert message.order >= self.told_order
            self.told_order = message.order
            self.way[line].append((message, view.number))

    def deliver(self, line: Line, messages: int) -> None:
        for _ in range(min(messages, len(self.way[line]))):
            message, number = self.way[line].popleft()
            self.take(message)
            self.used[line] = number

    def take(self, message: Blocks | Reset) -> None:
        if isinstance(message, Reset):
            self.orders, self.floor = {}, message.order
            self.client.take(message)
            return
        blocks = decode_blocks(message.body, counts=self.client.interest.detail == "counts")
        keys = [tuple(key) for key in blocks.keys.tolist()]
        is_new = np.array([message.order >= self.orders.get(key, 0) for key in keys], bool)
        is_new &= message.order > self.floor
        self.orders |= {key: message.order for key, new in zip(keys, is_new, strict=True) if new}
        counts = None if blocks.counts is None else blocks.counts[is_new]
        new = BlockSet(blocks.keys[is_new], blocks.ages_ms[is_new], blocks.cells[is_new], counts)
        self.client.mirror.put(new, message.stamp_ns)
        if message.order <= self.floor:
            return
        if message.complete is not None:
            self.client.mirror.complete = message.complete
        if message.order >= max(self.orders.values(), default=0):
            self.is_complete = message.complete is not None

    def lose_second(self) -> None:
        if not self.has_second:
            return
        self.way[SECOND].clear()
        self.used[SECOND] = 0
        self.has_second = False
        self.client.view.lose_second()

    def break_and_come_back(self) -> None:
        """Of what was under way nothing arrives; no line of before lives."""
        self.way[FIRST].clear()
        self.way[SECOND].clear()
        self.has_second = False
        if not self.client.view.go_on(self.client.interest, self.used[FIRST]):
            self.client.view.close()
            self.client.connect(self.source)
            self.used[FIRST] = 0
        self.used[SECOND] = 0
        self.orders, self.floor, self.told_order = {}, 0, 0

    def hear_all(self) -> None:
        for _ in range(3):  # what is under way is used, then all is told, then it is complete
            self.tell(SECOND, 10_000)
            for line in (FIRST, SECOND):
                self.deliver(line, 10_000)


class AnyLuck(TwoLines):
    """Whatever may happen to them, at random."""

    def __init__(self, source: MapSource, interest: Interest, seed: int) -> None:
        super().__init__(source, interest)
        self.random = np.random.default_rng([7, seed])
        self.acts = {
            self.change: 0.15,
            self.move: 0.05,
            self.open_second: 0.05,
            self.lose_second: 0.02,
            self.tell_again: 0.05,
            self.begin_anew: 0.02,
            self.break_and_come_back: 0.02,
            self.tell_some: 0.35,
            self.deliver_some: 0.35,
        }

    def act(self) -> None:
        weights = np.array([*self.acts.values()])
        acts = [*self.acts]
        acts[int(self.random.choice(len(acts), p=weights / weights.sum()))]()

    def line(self) -> Line:
        return SECOND if self.random.random() < 0.5 else FIRST

    def change(self) -> None:
        voxels = int(self.random.integers(1, 300))
        scatter(self.source._map, int(self.random.integers(1 << 30)), voxels)
        self.source.look(SECOND_NS)

    def move(self) -> None:
        x, y, z = self.random.uniform(-2.0, 2.0, 3).tolist()
        self.place = x, y, z

    def open_second(self) -> None:
        self.has_second = True

    def tell_again(self) -> None:
        self.client.view.tell_again(self.line(), self.place)

    def begin_anew(self) -> None:
        self.client.view.restart()

    def tell_some(self) -> None:
        self.tell(self.line(), int(self.random.integers(1, 6)))

    def deliver_some(self) -> None:
        self.deliver(self.line(), int(self.random.integers(1, 8)))
