"""A link that delivers so many bytes a second, after a delay, and may stall; in simulated time."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from mapperd.stream.pacer import Pacer

STEP_S = 0.005


@dataclass
class Link:
    """One direction is slow, the way back takes `back_s`.

    Attributes:
        rate: bytes a second at a time.
        there_s, back_s: of the wire alone.
        stalled: whether nothing comes out at a time, and then all at once what was held.
    """

    rate: Callable[[float], float]
    there_s: float = 0.15
    back_s: float = 0.15
    stalled: Callable[[float], bool] = lambda _: False
    pacer: Pacer = field(default_factory=Pacer)
    now_s: float = 0.0
    delivered: int = 0
    waits_s: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._queue: deque[list[float]] = deque()
        self._wire: deque[tuple[float, float, float]] = deque()
        self._acks: deque[tuple[float, int]] = deque()

    def send(self, size: int) -> None:
        self.pacer.note_sent(size, self.now_s)
        self._queue.append([float(size), self.now_s, float(size)])

    def step(self) -> None:
        """A little time passes."""
        self.now_s += STEP_S
        left = self.rate(self.now_s) * STEP_S
        while self._queue and left > 0:
            head = self._queue[0]
            took = min(head[0], left)
            head[0] -= took
            left -= took
            if head[0] <= 0:
                self._queue.popleft()
                self._wire.append((self.now_s + self.there_s, head[2], head[1]))
        while self._wire and self._wire[0][0] <= self.now_s and not self.stalled(self.now_s):
            _, size, sent_s = self._wire.popleft()
            self.delivered += int(size)
            self.waits_s.append((self.now_s, self.now_s - sent_s - self.there_s))
            self._acks.append((self.now_s + self.back_s, self.delivered))
        while self._acks and self._acks[0][0] <= self.now_s:
            assert self.pacer.note_ack(self._acks.popleft()[1], self.now_s)

    def fill(self, until_s: float, piece: int = 1_000) -> None:
        """Send as much as may be sent."""
        while self.now_s < until_s:
            while self.pacer.fits(piece, self.now_s):
                self.send(piece)
            self.step()

    def trickle(self, until_s: float, every_s: float, piece: int = 300) -> None:
        """Send a little, now and then."""
        next_s = self.now_s
        while self.now_s < until_s:
            if self.now_s >= next_s and self.pacer.fits(piece, self.now_s):
                self.send(piece)
                next_s += every_s
            self.step()

    def worst_wait_s(self, from_s: float, to_s: float) -> float:
        """In buffers."""
        return max(wait for at, wait in self.waits_s if from_s <= at <= to_s)
