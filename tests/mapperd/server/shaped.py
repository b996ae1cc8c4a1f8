"""A TCP connection over a link with a rate and a delay, which may stall; in simulated time."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from mapperd.server.pacer import Pacer

STEP_S = 0.005


@dataclass
class Mark:
    """When a packet was sent, and how much had passed by then."""

    sent_s: float
    passed: float
    passed_s: float
    is_limit: bool


MIN_IN_FLIGHT_BYTES = 3_000
"""Bytes that a calm TCP sends without an acknowledgement."""


@dataclass
class Link:
    """One direction is slow, the way back takes `back_s`.

    Attributes:
        rate: bytes a second at a time.
        there_s, back_s: of the wire alone.
        stalled: whether nothing comes out at a time, and then all at once what was held: as after
            a packet that is lost and sent again. Packets behind it arrive, and are not given out.
        calm: TCP has at most twice in flight what the wire holds, as BBR; otherwise all that
            it is given, which waits at the narrowest place.

    Rates and round trips are those that Linux reports: the last rate that is not limited by what
    TCP was given, or a higher one; of BBR the highest of ten round trips, and the smallest round
    trip of 10 s.
    """

    rate: Callable[[float], float]
    there_s: float = 0.15
    back_s: float = 0.15
    stalled: Callable[[float], bool] = lambda _: False
    calm: bool = True
    pacer: Pacer = field(default_factory=Pacer)
    now_s: float = 0.0
    delivered: int = 0
    waits_s: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._unsent: deque[tuple[int, float]] = deque()
        self._queue: deque[tuple[list[float], Mark]] = deque()
        self._round_trip_s = self.there_s + self.back_s  # of the handshake
        self._trips = deque([(self.now_s, self._round_trip_s)])
        self._passed, self._passed_s = 0.0, self.now_s
        self._samples: deque[tuple[float, float, Mark]] = deque()
        self._best: deque[tuple[float, float]] = deque()
        self.tcp_rate = 0.0
        self._wire: deque[tuple[float, float, float]] = deque()
        self._acks: deque[tuple[float, int]] = deque()
        self._note_link()

    @property
    def unsent(self) -> int:
        return sum(size for size, _ in self._unsent)

    def send(self, size: int) -> None:
        self.pacer.note_sent(size, self.now_s)
        self.carry(size)

    def carry(self, size: int) -> None:
        """Carry bytes that the pacer has noted already."""
        self._unsent.append((size, self.now_s))

    def step(self) -> None:
        """A little time passes."""
        self.now_s += STEP_S
        self._put_in_flight()
        left = self.rate(self.now_s) * STEP_S
        while self._queue and left > 0:
            head, mark = self._queue[0]
            took = min(head[0], left)
            head[0] -= took
            left -= took
            if head[0] <= 0:
                self._queue.popleft()
                self._wire.append((self.now_s + self.there_s, head[1], head[2]))
                self._measure(head[1], mark)
        while self._wire and self._wire[0][0] <= self.now_s and not self.stalled(self.now_s):
            _, size, given_s = self._wire.popleft()
            self.delivered += int(size)
            self.waits_s.append((self.now_s, self.now_s - given_s - self.there_s))
            self._acks.append((self.now_s + self.back_s, self.delivered))
        self._note_link()
        while self._acks and self._acks[0][0] <= self.now_s:
            assert self.pacer.note_ack(self._acks.popleft()[1], self.now_s)

    def _put_in_flight(self) -> None:
        wire = self.rate(self.now_s) * (self.there_s + self.back_s)
        while self._unsent:
            in_flight = sum(head[0] for head, _ in self._queue) + wire * bool(self._queue)
            if self.calm and in_flight > max(2 * wire, MIN_IN_FLIGHT_BYTES):
                return
            size, given_s = self._unsent.popleft()
            is_limit = self.calm and bool(self._unsent)
            passed_s = self._passed_s if self._samples or self._queue else self.now_s
            mark = Mark(self.now_s, self._passed, passed_s, is_limit=is_limit)
            self._queue.append(([float(size), float(size), given_s], mark))

    def _measure(self, size: float, mark: "Mark") -> None:
        """A packet leaves the narrowest place; its acknowledgement reports it later."""
        trip_s = self.there_s + self.back_s
        round_trip_s = self.now_s - mark.sent_s + trip_s
        self._round_trip_s += (round_trip_s - self._round_trip_s) / 8
        self._samples.append((self.now_s + trip_s, size, mark))
        self._trips.append((self.now_s, round_trip_s))

    def _note_link(self) -> None:
        while self._samples and self._samples[0][0] <= self.now_s:
            at_s, size, mark = self._samples.popleft()
            self._passed, self._passed_s = self._passed + size, at_s
            rate = (self._passed - mark.passed) / max(at_s - mark.passed_s, STEP_S)
            rate = min(rate, max(self.rate(mark.sent_s), self.rate(at_s)))  # steps are coarse
            if mark.is_limit or rate >= self.tcp_rate:
                self.tcp_rate = rate
                self._best.append((at_s, rate))
        while len(self._best) > 1 and self._best[0][0] < self.now_s - 10 * self._round_trip_s:
            self._best.popleft()
        while len(self._trips) > 1 and self._trips[0][0] < self.now_s - (10 if self.calm else 300):
            self._trips.popleft()
        best = max((rate for _, rate in self._best), default=0.0)
        in_flight = sum(head[0] for head, _ in self._queue)
        in_flight += sum(size for at_s, size, _ in self._wire if at_s > self.now_s)
        self.pacer.note_link(
            self.unsent,
            min(trip for _, trip in self._trips),
            self._round_trip_s,
            int(in_flight) + int(self.tcp_rate * self.back_s),
            best if self.calm else self.tcp_rate,
        )

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
