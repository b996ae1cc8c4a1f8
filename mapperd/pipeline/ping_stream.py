"""From the sonar bytes of a recording to pings."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from mapperd.pipeline.counters import ReplayCounters
from mapperd.reject import Reject
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.sequence import PingSequence
from oculus_driver.stream import Message, StreamParser
from oculus_driver.wire import MessageId

__all__ = ["Arrival", "PingStream"]


@dataclass(frozen=True, slots=True)
class Arrival:
    """A ping message that came, decoded or not.

    Attributes:
        t_ns: when its first byte came, on the recording's clock; None if unknown.
        ping: the ping, or why there is none.
    """

    t_ns: int | None
    ping: Ping | Reject


class PingStream:
    """Cuts each link's bytes into pings; every ping message counts once, whatever it is.

    Args:
        confirm: hold each ping back until what follows it confirms that no byte is missing from
            it: right for a recording, too late for a live picture.
    """

    def __init__(self, *, confirm: bool = False) -> None:
        self._confirm = confirm
        self._parsers: dict[str, StreamParser] = {}
        self._sequence = PingSequence()
        self._owner: str | None = None
        self._unnumbered = 0  # messages that came since the last ping, but gave none
        self._not_lost = 0  # numbers that are missing because of those

    def feed(
        self, link: str, data: bytes, arrival_ns: int | None, *, gap_before: bool = False
    ) -> Iterator[Arrival]:
        """Take the next bytes of a link; yield the ping messages that they complete.

        Args:
            link: name of the link.
            data: its bytes, cut anywhere.
            arrival_ns: when they came.
            gap_before: bytes before them are known to be missing.
        """
        parser = self._parsers.setdefault(link, StreamParser(confirm=self._confirm))
        yield from self._arrivals(link, parser.feed(data, arrival_ns, gap_before=gap_before))

    def finish(self) -> Iterator[Arrival]:
        """Settle what is pending at the end of all links."""
        for link, parser in self._parsers.items():
            yield from self._arrivals(link, parser.finish())

    def count(self, counters: ReplayCounters) -> None:
        """Add what the parsers and the ping numbers say."""
        for parser in self._parsers.values():
            parsed = parser.counters
            counters.bytes_total += parsed.bytes_total
            counters.bytes_rejected += parsed.bytes_rejected
            counters.resyncs += parsed.resyncs
            counters.messages_rejected.update(parsed.rejects)
            counters.messages_doubtful.update(parsed.warnings)
        counters.pings_lost += self._sequence.lost_pings - self._not_lost

    def _arrivals(self, link: str, messages: Iterable[Message]) -> Iterator[Arrival]:
        for message in messages:
            if message.message_id == MessageId.PING_RESULT:
                yield Arrival(message.arrival_ns, self._ping_of(link, message))

    def _ping_of(self, link: str, message: Message) -> Ping | Reject:
        ping = decode_ping(message)
        if not isinstance(ping, Ping):
            self._unnumbered += link == self._owner
            return Reject(ping.reason, ping.detail)
        # One mounting, one sonar: a second one would be drawn in the wrong place.
        self._owner = self._owner or link
        if link != self._owner:
            return Reject("other_link", f"pings of {link!r}; those of {self._owner!r} are mapped")
        if not self._is_new(ping.ping_id):
            return Reject("duplicate", f"ping {ping.ping_id} came twice")
        return ping

    def _is_new(self, ping_id: int) -> bool:
        """Follow the numbers; each message that gave no ping accounts for a missing one."""
        lost = self._sequence.lost_pings
        new = self._sequence.accept(ping_id)
        self._not_lost += min(self._unnumbered, self._sequence.lost_pings - lost)
        self._unnumbered = 0
        return new
