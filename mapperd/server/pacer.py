"""Limits on bytes in flight and bytes per second, so that a client's data is fresh.

Whatever lies in buffers between us and the client is old when it arrives, and everything after it
waits for it. How fast packets may go, and which to send again, is TCP's business; ours is to give
it no more than it sends within moments. Two rules do that:

- What TCP has been given and has not sent yet stays below a fraction of a second of what the link
  delivers.
- A TCP that fills the buffers of the network, as all but BBR do, is held by a window in bytes that
  the client has not acknowledged: when packets take much longer than they must, it shrinks so far
  that the queue drains, which also shows how long they must take. TCP's own round trips say so; a
  packet that was lost and comes again delays all that the client can use behind it, but not the
  packets.
"""

from collections import deque
from math import inf

__all__ = ["FIRST_RATE", "FIRST_WINDOW", "MAX_WINDOW", "MIN_WINDOW", "Budget", "Pacer"]

BURST_S, MIN_BURST = 0.2, 2048


class Budget:
    """Fills up as time passes, which whoever calls says in seconds that never go back.

    Args:
        bytes_per_s: never more, in the long run; 0 has no limit.

    Attributes:
        bytes_per_s: as given; may be changed.
    """

    def __init__(self, bytes_per_s: int = 0) -> None:
        self.bytes_per_s = bytes_per_s
        self._left = float(MIN_BURST)
        self._filled_s: float | None = None

    @property
    def burst(self) -> float:
        """Bytes that it holds at most."""
        return max(BURST_S * self.bytes_per_s, MIN_BURST)

    def left(self, now_s: float) -> float:
        """Bytes that may be sent now, if there is a limit; less than 0 are owed."""
        passed_s = 0.0 if self._filled_s is None else max(0.0, now_s - self._filled_s)
        self._filled_s = now_s
        self._left = min(self.burst, self._left + passed_s * self.bytes_per_s)
        return self._left

    def spend(self, size: int, now_s: float) -> None:
        """So many were sent."""
        self._left = self.left(now_s) - (size if self.bytes_per_s else 0)


UNSENT_S, MIN_UNSENT = 0.3, 2048
"""Not sent yet at most, of what the link delivers; more than the time between two rounds."""

CALM_UNSENT_S = 0.12
"""The same where TCP sends at once what the link takes: it needs no store, and what lies there when
it pauses, as BBR does, is late."""

MIN_WINDOW, FIRST_WINDOW, MAX_WINDOW = 4096, 1 << 16, 1 << 20

FIRST_OF_FILLING = 8192
"""The first window of a TCP that fills buffers: all of it is in them at once."""

QUEUE_S = 0.4
"""That packets may wait in the network."""

TURN_S = 0.2
"""The window is judged once a round trip, and no more often than this; and it grows only when all
that was sent before it grew last has arrived: until then nobody knows what became of that."""

FORGET_S = 30.0
"""So long a round trip may be that of an empty link."""

GROWTH, DRAINED = 1.25, 0.8
"""Of the window, a turn; and what it becomes, of what the wire alone holds."""

FULL = 0.7
"""With less than this part of the window under way, it is not the window that holds anything."""

NEARLY_ALL = 0.75
"""Of all the room that there could be: what is too large for that is sent now, or never."""

SPAN_S, RATE_S = 1.5, 6.0
"""The rate is the highest over such a span, of those of so long."""

SHORTEST_S = 0.001

FIRST_RATE = 16_000

MIN_S, MAX_LEAST = 0.12, 16_384
"""Below the burst of a budget, and the smallest of windows."""

LOSS_S = 0.35
"""So much beyond a round trip what was sent is acknowledged late: a packet was lost, or waited."""


class Pacer:
    """Of one connection; whoever calls says what time it is, in seconds that never go back.

    Args:
        bytes_per_s: never more, in the long run; 0 has no limit.

    Attributes:
        budget: of the client; its connections may share one.
        sent, acked: bytes so far.
        rate: bytes a second that the link has delivered at its best of late, or that TCP says; None
            before it was ever busy.
        round_trip_s: the smallest of late of a packet; None where nobody knows it.
        trip_s: that of now, as TCP has it.
        window: bytes that may be in flight.
        stalls: how often something was acknowledged late, once a round trip.
        in_network: bytes that are under way, of what was sent and not acknowledged.
        link_rate: bytes a second that the network delivers, as TCP sees it: it is not misled by
            what comes at once after a lost packet came again. None where it does not say.
    """

    def __init__(self, bytes_per_s: int = 0) -> None:
        self.budget = Budget(bytes_per_s)
        self.sent = self.acked = 0
        self.rate: float | None = None
        self.round_trip_s: float | None = None
        self.window = FIRST_WINDOW
        self.stalls = 0
        self.trip_s: float | None = None
        self.in_network = 0
        self.link_rate: float | None = None
        self._stalled_s = -inf
        self._unsent_since_s = inf
        self._unsent = 0
        self._turned_s = -inf
        self._grown_at = 0
        self._was_full = False
        self._round_trips: deque[tuple[float, float]] = deque()
        self._pieces: deque[tuple[int, float]] = deque()
        self._rates: deque[tuple[float, float]] = deque()
        self._span = (0.0, 0)
        self._quiet_since_s = 0.0

    @property
    def bytes_per_s(self) -> int:
        """Of the budget."""
        return self.budget.bytes_per_s

    @property
    def in_flight(self) -> int:
        """Bytes that were sent and are not acknowledged."""
        return self.sent - self.acked

    @property
    def _allowed_rate(self) -> float:
        rate = self.rate or FIRST_RATE
        return min(rate, self.bytes_per_s) if self.bytes_per_s else rate

    @property
    def _most_unsent(self) -> float:
        unsent_s = UNSENT_S if self.link_rate is None else CALM_UNSENT_S
        return max(unsent_s * (self.rate or FIRST_RATE), MIN_UNSENT)

    @property
    def _fills_window(self) -> bool:
        return self.in_flight >= FULL * self.window

    def room(self, now_s: float) -> int:
        """Bytes that may be sent now; 0 or less is none."""
        room = min(self.window - self.in_flight, self._most_unsent - self._unsent)
        return int(min(room, self.budget.left(now_s)) if self.bytes_per_s else room)

    def fits(self, size: int, now_s: float) -> bool:
        """Whether so much may be sent now: half of it has room, or it would hardly have more."""
        room = self.room(now_s)
        most = min(self.window, self._most_unsent)
        if self.bytes_per_s:
            most = min(most, self.budget.burst)
        return room > 0 and (size // 2 <= room or room >= NEARLY_ALL * most)

    def least(self) -> int:
        """Bytes that are worth a message where more are to come: a while of what the link takes."""
        ever = min(self.window, self._most_unsent)
        return int(min(MIN_S * self._allowed_rate, MAX_LEAST, ever / 2))

    def is_idle_for(self, size: int) -> bool:
        """Whether so much is no more than the link takes in moments, and little is under way."""
        moments_s = (self.round_trip_s or 0.0) + UNSENT_S
        most = min(max(moments_s * self._allowed_rate, MIN_UNSENT), self.window)
        return self.in_flight <= most / 2 and size <= most

    def note_sent(self, size: int, now_s: float) -> None:
        """So much was sent."""
        self.budget.spend(size, now_s)
        if not self.in_flight:
            self._quiet_since_s = now_s
            self._span = (now_s, self.acked)
        self.sent += size
        self._unsent += size
        self._pieces.append((self.sent, now_s))

    def note_link(
        self,
        unsent: int,
        round_trip_s: float | None,
        now_s: float,
        *,
        fills: bool,
        in_network: int | None = None,
        link_rate: float | None = None,
    ) -> None:
        """How the connection stands.

        Args:
            unsent: bytes that it was given and has not sent.
            round_trip_s: of its packets, of late; None where it has none.
            now_s: now.
            fills: it sends as fast as buffers take it.
            in_network: bytes of packets that were sent and have neither arrived nor been lost; None
                is all that is not acknowledged.
            link_rate: bytes a second, as it has seen the network deliver; None where unknown.
        """
        self._unsent = unsent
        self._unsent_since_s = min(self._unsent_since_s, now_s) if unsent else inf
        self.trip_s = round_trip_s
        # Small packets were taken for full ones.
        most = max(self.in_flight - unsent, 0)
        self.in_network = most if in_network is None else min(in_network, most)
        self.link_rate = link_rate
        if self.rate is not None and link_rate is not None:
            self.rate = link_rate
        self._was_full |= unsent > 0 or self._fills_window
        if round_trip_s is None or now_s - self._turned_s < max(round_trip_s, TURN_S):
            return
        if fills and self.round_trip_s is None:
            self.window = FIRST_OF_FILLING
        self._turned_s = now_s
        self._learn_round_trip(round_trip_s, now_s)
        assert self.round_trip_s is not None  # noqa: S101 it was just learnt
        if fills and round_trip_s - self.round_trip_s > QUEUE_S:
            wire = (self.rate or FIRST_RATE) * self.round_trip_s
            self.window = min(max(int(wire * DRAINED), MIN_WINDOW), self.window)
        elif self._fills_window and self.acked >= self._grown_at:
            self.window = min(int(self.window * GROWTH), MAX_WINDOW)
            self._grown_at = self.sent

    def note_ack(self, acked: int, now_s: float) -> bool:
        """So many bytes have arrived since the beginning; returns whether that can be."""
        if not self.acked <= acked <= self.sent:
            return False
        if acked == self.acked:
            return True
        self.acked = acked
        self._unsent = min(self._unsent, self.in_flight)
        self._quiet_since_s = now_s
        late_s = 2 * (self.round_trip_s or 0.0) + TURN_S
        while self._pieces and self._pieces[0][0] <= acked:
            _, sent_s = self._pieces.popleft()
            self._was_full |= now_s - sent_s > late_s
            self._note_stall(now_s - sent_s, now_s)
        self._learn_rate(now_s)
        return True

    def waits_s(self, now_s: float) -> float:
        """How long ago the oldest was sent of what is not acknowledged; 0 where all is."""
        return now_s - self._pieces[0][1] if self._pieces else 0.0

    def blocked_s(self, now_s: float) -> float:
        """How long TCP has not sent all that it was given."""
        return max(now_s - self._unsent_since_s, 0.0)

    def quiet_s(self, now_s: float) -> float:
        """How long nothing was acknowledged though something is under way."""
        return now_s - self._quiet_since_s if self.in_flight else 0.0

    def _learn_round_trip(self, round_trip_s: float, now_s: float) -> None:
        while self._round_trips and self._round_trips[0][0] < now_s - FORGET_S:
            self._round_trips.popleft()
        while self._round_trips and self._round_trips[-1][1] >= round_trip_s:
            self._round_trips.pop()
        self._round_trips.append((now_s, round_trip_s))
        self.round_trip_s = self._round_trips[0][1]

    def _note_stall(self, took_s: float, now_s: float) -> None:
        trip_s = self.round_trip_s or inf
        if took_s > trip_s + LOSS_S and now_s - self._stalled_s > trip_s:
            self.stalls, self._stalled_s = self.stalls + 1, now_s

    def _learn_rate(self, now_s: float) -> None:
        """From the first of a busy time on, again and again; and at its end."""
        began_s, acked = self._span
        if now_s - began_s < SPAN_S and self.in_flight:
            return
        rate = (self.acked - acked) / max(now_s - began_s, SHORTEST_S)
        was_full, self._was_full = self._was_full, False
        self._span = (now_s, self.acked)
        if self.rate is not None and self.link_rate is not None:
            return  # TCP knows it better
        if not was_full and rate < (self.rate or FIRST_RATE):
            return  # there was no more to send: that says nothing against the link
        while self._rates and self._rates[0][0] < now_s - RATE_S:
            self._rates.popleft()
        while self._rates and self._rates[-1][1] <= rate:
            self._rates.pop()
        self._rates.append((now_s, rate))
        self.rate = self._rates[0][1]
