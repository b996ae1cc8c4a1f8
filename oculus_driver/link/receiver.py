"""Turns the bytes of a connection into pings, each once, and counts everything else."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final

from oculus_driver.errors import Reject
from oculus_driver.ping import PingHeader, PingSequence, decode_header
from oculus_driver.stream import Message, StreamCounters, StreamParser
from oculus_driver.wire import MIB, MessageId

MAX_RESYNC_BYTES: Final = 16 * MIB
RESYNC_TIMEOUT_NS: Final = 5_000_000_000
STALL_TIMEOUT_NS: Final = 2_000_000_000


@dataclass(frozen=True, slots=True)
class ReceivedMessage:
    """A complete message, and its ping if it is valid and new; the image is not decoded."""

    message_id: int
    ping: PingHeader | None


class PingReceiver:
    """Parses one sonar's consecutive connections and decides whether to continue.

    Attributes:
        framing: what was found in the last fed bytes.
        sequence: lost, duplicate and restarted ids.
        pings: valid pings, each counted once.
        rejects: unusable ping messages by reason, full_ping among them; bytes outside messages
            count in `stream`.
    """

    def __init__(self) -> None:
        self.sequence = PingSequence()
        self.pings = 0
        self.rejects: Counter[str] = Counter()
        self._parser = StreamParser()
        self.framing = self._parser.framing([], 0)
        self._last: tuple[int, float | None, int | None] | None = None
        self._same_connection = True
        self._received_ns = 0
        self._resync_since_ns: int | None = None

    @property
    def stream(self) -> StreamCounters:
        """Counters of the parser."""
        return self._parser.counters

    @property
    def deadline_ns(self) -> int | None:
        """When to call `fault` if no bytes arrive until then."""
        if self._resync_since_ns is not None:
            return self._resync_since_ns + RESYNC_TIMEOUT_NS
        return self._received_ns + STALL_TIMEOUT_NS if self._parser.pending_bytes else None

    def feed(self, data: bytes, arrival_ns: int) -> list[ReceivedMessage]:
        """Feed the next bytes and return the messages that they complete."""
        self._received_ns = arrival_ns
        messages = self._parser.feed(data, arrival_ns)
        self.framing = self._parser.framing(messages, len(data))
        received = [self._received(one) for one in messages]
        if self._parser.synchronised:
            self._resync_since_ns = None
        elif self._resync_since_ns is None:
            self._resync_since_ns = arrival_ns
        return received

    def finish(self) -> list[ReceivedMessage]:
        """Parse the rest of a connection that has ended; the next connection starts afresh."""
        self._resync_since_ns = None
        received = [self._received(one) for one in self._parser.finish()]
        self._same_connection = False
        return received

    def fault(self, now_ns: int) -> str | None:
        """Return why the connection must be replaced, or None.

        One reason is a message that stops in the middle. The last bytes count, not its beginning:
        over a slow network a large message may take seconds.
        """
        if self._resync_since_ns is None:
            if not self._parser.pending_bytes or now_ns - self._received_ns < STALL_TIMEOUT_NS:
                return None
            return f"message stalled after {self._parser.pending_bytes} bytes"
        lost_bytes = self._parser.bytes_since_lost
        if lost_bytes < MAX_RESYNC_BYTES and now_ns - self._resync_since_ns < RESYNC_TIMEOUT_NS:
            return None
        return f"no message in {lost_bytes} bytes"

    def postpone(self, pause_ns: int) -> None:
        """Do not count a time in which this program did not run."""
        self._received_ns += pause_ns
        if self._resync_since_ns is not None:
            self._resync_since_ns += pause_ns

    def _received(self, message: Message) -> ReceivedMessage:
        if message.message_id == MessageId.FULL_PING_RESULT:
            self.rejects["full_ping"] += 1
        if message.message_id != MessageId.PING_RESULT:
            return ReceivedMessage(message.message_id, None)
        ping = decode_header(message)
        if isinstance(ping, Reject):
            self.rejects[ping.reason] += 1
            if ping.ping_id is not None:
                self.sequence.accept(ping.ping_id)
            return ReceivedMessage(message.message_id, None)
        fresh = self._is_new(ping)
        self.pings += fresh
        return ReceivedMessage(message.message_id, ping if fresh else None)

    def _is_new(self, ping: PingHeader) -> bool:
        """Return whether the ping is no repetition. The same id at another time is a restart.

        The same ping over another connection is a restart, too: nothing is sent twice.
        """
        identity = ping.ping_id, ping.start_time_s, ping.start_ticks
        last, self._last = self._last, identity
        repeats, self._same_connection = self._same_connection and last == identity, True
        if last is not None and last[0] == identity[0] and not repeats:
            self.sequence.restart()
        return self.sequence.accept(ping.ping_id)
