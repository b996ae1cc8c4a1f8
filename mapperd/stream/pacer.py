"""How much may be under way to one client, so that what it is told is fresh.

Whatever lies in buffers between us and the client is old when it arrives, and everything after it
waits for it. So no more is sent than the link delivers in its smallest round trip and a little
beyond, which the client's acknowledgements tell: the rate as BBR estimates it (Cardwell et al.,
"BBR: Congestion-Based Congestion Control", ACM Queue 14(5), 2016), from what was delivered between
the sending of something and its acknowledgement. TCP's own window below is left alone: it would
fill any buffer that there is.
"""

from collections import deque
from dataclasses import dataclass

__all__ = ["LEAST_WINDOW", "MOST_WINDOW", "Pacer"]

QUEUE_S = 0.3
"""Of data beyond what the wire itself holds: enough to keep it busy between acknowledgements."""

LEAST_WINDOW, FIRST_WINDOW, MOST_WINDOW = 2048, 4096, 1 << 20
FORGET_S, FORGET_LATE_S = 2.0, 0.5
"""So long the highest rate holds; and so long when what arrives has waited for too long."""

GAIN, GAIN_GROWING, GROWS = 1.4, 2.5, 1.1
"""On the rate, at most: a window that opens at once would be a queue at the narrowest place. More
while the rate has grown by such a factor of late, and is not known yet."""

FIRST_S, AGAIN_S = 2.0, 20.0
"""So often the smallest round trip is measured anew, with the queue drained."""

LEAST_DRAINED, DRAINED = 1500, 0.5
"""Bytes under way then; and the part of what the wire itself holds."""

FULL = 0.8
"""With less than this part of the window under way, it is the sender that is slow."""

TOGETHER_S = 0.005
"""Sent within this, it counts as one piece."""

BURST_S, LEAST_BURST = 0.2, 2048


@dataclass(slots=True)
class _Piece:
    """Bytes up to `end`, and how things stood when they were sent."""

    end: int
    sent_s: float
    delivered: int
    delivered_s: float
    first_sent_s: float
    is_limited: bool
    is_drained: bool


class Pacer:
    """Of one connection; whoever calls says what time it is, in seconds that never go back.

    Args:
        bytes_per_s: never more, in the long run; 0 has no limit.

    Attributes:
        bytes_per_s: as given; may be changed.
        sent, acked: bytes so far.
        rate: bytes a second that the link delivers at its best; None before it is known.
        round_trip_s: smallest of late; None before it is known.
    """

    def __init__(self, bytes_per_s: int = 0) -> None:
        self.bytes_per_s = bytes_per_s
        self.sent = self.acked = 0
        self.rate: float | None = None
        self.round_trip_s: float | None = None
        self._pieces: deque[_Piece] = deque()
        self._rates: deque[tuple[float, float]] = deque()
        self._delivered_s = self._first_sent_s = 0.0
        self._measured_s, self._again_s = 0.0, FIRST_S
        self._drains = False
        self._grew_s = 0.0
        self._quiet_since_s = 0.0
        self._tokens = self._turns = float(LEAST_BURST)
        self._filled_s: float | None = None

    @property
    def in_flight(self) -> int:
        """Bytes that were sent and are not acknowledged."""
        return self.sent - self.acked

    @property
    def window(self) -> int:
        """Bytes that may be in flight."""
        if self.rate is None or self.round_trip_s is None:
            return FIRST_WINDOW
        if self._drains:
            return int(max(self.rate * self.round_trip_s * DRAINED, LEAST_DRAINED))
        wanted = self.rate * (self.round_trip_s + QUEUE_S)
        return int(min(max(wanted, LEAST_WINDOW), MOST_WINDOW))

    def room(self, now_s: float) -> int:
        """Bytes that may be sent now; 0 or less is none."""
        self._refill(now_s)
        return int(min(self.window - self.in_flight, self._allowed))

    def fits(self, size: int, now_s: float) -> bool:
        """Whether so much may be sent now: half of it has room, or it would never have more."""
        self._refill(now_s)
        if self._allowed <= 0:
            return False
        free = self.window - self.in_flight
        return size // 2 <= free or 4 * free >= 3 * self.window

    def note_sent(self, size: int, now_s: float) -> None:
        """So much was sent."""
        self._refill(now_s)
        self._turns -= size
        if self.bytes_per_s:
            self._tokens -= size
        if not self.in_flight:
            self._delivered_s = self._first_sent_s = self._quiet_since_s = now_s
        self.sent += size
        is_limited = self.in_flight < FULL * self.window
        last = self._pieces[-1] if self._pieces else None
        if last is not None and now_s - last.sent_s < TOGETHER_S:
            last.end = self.sent
            last.is_limited = is_limited
            return
        piece = _Piece(
            self.sent,
            now_s,
            self.acked,
            self._delivered_s,
            self._first_sent_s,
            is_limited,
            self._drains and self.in_flight - size <= self.window,
        )
        self._pieces.append(piece)

    def note_ack(self, acked: int, now_s: float) -> bool:
        """So many bytes have arrived since the beginning; returns whether that can be."""
        if not self.acked <= acked <= self.sent:
            return False
        if acked == self.acked:
            return True
        self.acked = acked
        self._delivered_s = self._quiet_since_s = now_s
        newest = None
        while self._pieces and self._pieces[0].end <= acked:
            newest = self._pieces.popleft()
        if newest is not None:
            self._first_sent_s = newest.sent_s
            self._learn_round_trip(newest, now_s)
            self._learn_rate(newest, now_s)
        return True

    def quiet_s(self, now_s: float) -> float:
        """How long nothing was acknowledged though something is under way."""
        return now_s - self._quiet_since_s if self.in_flight else 0.0

    def _learn_rate(self, piece: _Piece, now_s: float) -> None:
        took_s = max(now_s - piece.delivered_s, piece.sent_s - piece.first_sent_s)
        if took_s <= 0:
            return
        rate = (self.acked - piece.delivered) / took_s
        if piece.is_limited and self.rate is not None and rate < self.rate:
            return  # there was no more to send: that says nothing against the link
        waited_s = now_s - piece.sent_s - (self.round_trip_s or 0.0)
        forget_s = FORGET_LATE_S if waited_s > 2 * QUEUE_S else FORGET_S
        while self._rates and self._rates[0][0] < now_s - forget_s:
            self._rates.popleft()
        while self._rates and self._rates[-1][1] <= rate:
            self._rates.pop()
        self._rates.append((now_s, rate))
        if self._rates[0][1] > GROWS * (self.rate or 0.0):
            self._grew_s = now_s
        self.rate = self._rates[0][1]

    def _learn_round_trip(self, piece: _Piece, now_s: float) -> None:
        round_trip_s = now_s - piece.sent_s
        least = self.round_trip_s
        was_drained = self._drains and piece.is_drained
        if least is None or round_trip_s <= least or was_drained:
            self.round_trip_s, self._measured_s = round_trip_s, now_s
            if was_drained:
                self._again_s = AGAIN_S
            self._drains = False
        elif now_s - self._measured_s > self._again_s:
            self._drains = True

    @property
    def _allowed(self) -> float:
        """What the limit, and the rate, allow at once."""
        return min(self._turns, self._tokens) if self.bytes_per_s else self._turns

    def _refill(self, now_s: float) -> None:
        passed_s = 0.0 if self._filled_s is None else max(0.0, now_s - self._filled_s)
        self._filled_s = now_s
        limit = self.bytes_per_s
        self._tokens = min(max(limit * BURST_S, LEAST_BURST), self._tokens + passed_s * limit)
        if self.rate is None:
            self._turns = FIRST_WINDOW
            return
        burst = max(self.rate * BURST_S, LEAST_BURST)
        grows = now_s - self._grew_s < 2 * (self.round_trip_s or 0.0) + QUEUE_S
        gain = GAIN_GROWING if grows else GAIN
        self._turns = min(burst, self._turns + passed_s * self.rate * gain)
