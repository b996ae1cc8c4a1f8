"""From the bytes of all links to pings with their poses, live and recorded.

What comes out depends on the chunks and their order alone: nothing in here asks a clock. So what
was mapped live and what its recording gives are equal by construction.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import astuple, dataclass
from typing import NamedTuple

from mapperd.config.changes import with_values
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.odometry.bridge import ENCODING_PREFIX
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.pose_lookup import PoseLookup, PoseLookupState, ping_time_ns
from mapperd.session_log import (
    DECISIONS,
    Gap,
    Request,
    Reset,
    Settings,
    Skip,
    decision_of,
    is_remark,
)
from oculus_driver.clock import SonarClock, SonarClockState
from oculus_driver.ping import Ping, PingSequence, decode_ping
from oculus_driver.recording import OCULUS, Chunk
from oculus_driver.stream import Message, StreamParser, StreamParserState
from oculus_driver.wire import MessageId

__all__ = [
    "Arrival",
    "NewSettings",
    "PingStream",
    "PosedPing",
    "SessionDecoder",
    "SessionDecoderState",
    "Work",
]


@dataclass(frozen=True, slots=True)
class Arrival:
    """A ping message that came, decoded or not.

    Attributes:
        t_ns: when its first byte came, on the recording's clock; None if unknown.
        ping: the ping, or why there is none.
    """

    t_ns: int | None
    ping: Ping | Reject


class PingStreamState(NamedTuple):
    """State of a `PingStream`.

    Attributes:
        parsers: link to the state of its parser.
        sequence: of the ping numbers.
        owner: link whose pings are mapped; None before the first ping.
        unnumbered: messages since the last ping that gave none.
        not_lost: numbers that are missing because of those.
    """

    parsers: dict[str, StreamParserState]
    sequence: tuple[int, int, int, int | None]
    owner: str | None
    unnumbered: int
    not_lost: int


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

    def state(self) -> PingStreamState:
        """Everything that `restore` needs to continue exactly."""
        return PingStreamState(
            {link: parser.state() for link, parser in self._parsers.items()},
            self._sequence.state(),
            self._owner,
            self._unnumbered,
            self._not_lost,
        )

    def restore(self, state: PingStreamState) -> None:
        """Continue as the one of which `state` was taken; the arguments must be the same."""
        for link, parser in state.parsers.items():
            self._parsers[link] = StreamParser(confirm=self._confirm)
            self._parsers[link].restore(parser)
        self._sequence.restore(state.sequence)
        self._owner, self._unnumbered = state.owner, state.unnumbered
        self._not_lost = state.not_lost

    def finish(self) -> Iterator[Arrival]:
        """Settle what is pending at the end of all links."""
        for link, parser in self._parsers.items():
            yield from self._arrivals(link, parser.finish())

    def count(self, counters: PipelineCounters) -> None:
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


@dataclass(frozen=True, slots=True, eq=False)
class PosedPing:
    """A ping whose pose is known, or known to be unknown.

    Attributes:
        number: of the ping, from 0; every ping message of the session counts.
        ping: what the sonar heard.
        pose: at its time, or why there is none.
        complete_ns: when its last byte had come, on the clock of the arrivals; None if unknown.
        t_ns: when the sound met the middle of the image, on that clock; None if unknown.
    """

    number: int
    ping: Ping
    pose: FusedPose | Reject
    complete_ns: int | None
    t_ns: int | None = None


@dataclass(frozen=True, slots=True)
class NewSettings:
    """Pings after this are mapped with other settings."""

    config: Config


Work = PosedPing | NewSettings | Reset | Request


@dataclass(frozen=True, slots=True)
class _Ticket:
    number: int
    complete_ns: int | None
    t_ns: int | None


class SessionDecoderState(NamedTuple):
    """State of a `SessionDecoder`, without settings and counters.

    Attributes:
        pings, bytes_taken, orders_taken: its attributes.
        clocks: source id to the state of that sonar's clock.
        poses, stream: of its parts.
        tickets: number, time of the last byte and time of each ping that waits for its pose.
        whole: pings that were complete so far.
        gaps: links of which bytes are missing before the next ones.
    """

    pings: int
    bytes_taken: int
    orders_taken: int
    clocks: dict[int, SonarClockState]
    poses: PoseLookupState
    stream: PingStreamState
    tickets: list[tuple[int, int | None, int | None]]
    whole: int
    gaps: list[str]


class SessionDecoder:
    """Parses, fuses and pairs one session.

    Args:
        config: the settings at its beginning.
        poses: fixed, or from odometry; fresh.
        counters: of the pings.
        confirm: hold each ping back until what follows confirms it: right for recordings that do
            not say where bytes are missing.
        obey: do what the decisions among the chunks say; else only gaps are believed.
        within: whether a ping that came at a time is wanted; None is all.

    Attributes:
        config: the settings that chunks are taken with.
        counters: as given.
        pings: ping messages so far: the number of the next one.
        bytes_taken, orders_taken: where in the session's stream it is: bytes of all links, skipped
            ones too, and orders other than `Skip`. However a log cuts bytes into pieces and files,
            the place is the same.
        clocks: of the sonars, by source id.
        poses: as given.
    """

    def __init__(
        self,
        config: Config,
        poses: PoseLookup,
        counters: PipelineCounters,
        *,
        confirm: bool,
        obey: bool,
        within: Callable[[int | None], bool] | None = None,
    ) -> None:
        self.config = config
        self.counters = counters
        self.pings = 0
        self.bytes_taken = self.orders_taken = 0
        self.clocks: dict[int, SonarClock] = {}
        self.poses = poses
        self._obey = obey
        self._within = within
        self._stream = PingStream(confirm=confirm)
        self._tickets: deque[_Ticket] = deque()
        self._whole = 0
        self._gaps: set[str] = set()

    @property
    def waiting(self) -> int:
        """Pings that wait for their poses."""
        return len(self._tickets)

    def state(self) -> SessionDecoderState:
        """Everything that `restore` needs to continue exactly; between two chunks."""
        return SessionDecoderState(
            self.pings,
            self.bytes_taken,
            self.orders_taken,
            {source_id: clock.state() for source_id, clock in self.clocks.items()},
            self.poses.state(),
            self._stream.state(),
            [astuple(ticket) for ticket in self._tickets],
            self._whole,
            sorted(self._gaps),
        )

    def restore(self, state: SessionDecoderState) -> None:
        """Continue as the decoder of which `state` was taken, with the settings then in force.

        Raises:
            ValueError: the state does not belong to these settings.
        """
        self.pings = state.pings
        self.bytes_taken, self.orders_taken = state.bytes_taken, state.orders_taken
        for source_id, clock in state.clocks.items():
            self._clock_of(source_id).restore(clock)
        self.poses.restore(state.poses)
        self._stream.restore(state.stream)
        self._tickets = deque(_Ticket(*ticket) for ticket in state.tickets)
        self._whole, self._gaps = state.whole, set(state.gaps)

    def feed(self, chunk: Chunk, *, late: bool = False) -> list[Work]:
        """Take the next chunk; returns what is to be done because of it, in order.

        Args:
            chunk: of any link.
            late: it came after the chosen part: its sonar bytes may complete a ping, the rest
                means nothing.
        """
        if chunk.encoding == DECISIONS:
            return list(self._decided(chunk))
        self.bytes_taken += len(chunk.data)
        if chunk.encoding == OCULUS:
            self._take_sonar(chunk)
        elif chunk.encoding.startswith(ENCODING_PREFIX) and not late:
            self._take_odometry(chunk)
        return self._settled(None if late else chunk.arrival_ns)

    def end(self, *, cut: bool = False) -> list[Work]:
        """Settle what is pending; nothing more comes.

        Args:
            cut: bytes would follow, so messages that are pending are not judged.
        """
        if not cut:
            self._offer_all(self._stream.finish(), None)
        work = self._settled(None, final=True)
        self._stream.count(self.counters)
        return work

    def offer(self, ping: Ping | Reject, t_ns: int | None, complete_ns: int | None) -> None:
        """Count a ping that came and let it wait for its pose.

        Args:
            ping: or why there is none.
            t_ns: as `PoseLookup.add_ping` takes it.
            complete_ns: when its last byte came.
        """
        number, self.pings = self.pings, self.pings + 1
        self.counters.pings_total += 1
        if isinstance(ping, Reject):
            self.counters.drop(ping.reason, ping.detail)
            return
        skip = self.config.processing.frame_skip
        turn, self._whole = self._whole % skip, self._whole + 1
        if turn:
            self.counters.drop("frame_skip", f"every {skip}th ping is mapped")
            return
        placed_ns = ping_time_ns(ping) if t_ns is None else t_ns
        self._tickets.append(_Ticket(number, complete_ns, placed_ns))
        self.poses.add_ping(ping, placed_ns)

    def take(self, config: Config) -> None:
        """Take chunks with other settings from the next one on."""
        self.config = config
        self.poses.take(config)

    def _decided(self, chunk: Chunk) -> Iterator[Work]:
        decision = decision_of(chunk)
        self.orders_taken += not isinstance(decision, Skip) and not is_remark(decision)
        match decision:
            case Gap(link):
                self._gaps.add(link)
            case Skip(link, size) if self._obey:
                self._gaps.add(link)
                self.bytes_taken += size
            case Settings(values) if self._obey:
                self.take(with_values(self.config, values))
                yield NewSettings(self.config)
            case Reset() if self._obey:
                yield decision
            case _ if self._obey and isinstance(decision, Request):
                yield decision

    def _gap_before(self, chunk: Chunk) -> bool:
        gap = chunk.gap_before or chunk.link in self._gaps
        self._gaps.discard(chunk.link)
        return gap

    def _take_odometry(self, chunk: Chunk) -> None:
        self.poses.add_odometry(
            chunk.link,
            chunk.data,
            chunk.arrival_ns,
            encoding=chunk.encoding,
            gap_before=self._gap_before(chunk),
        )

    def _take_sonar(self, chunk: Chunk) -> None:
        gap = self._gap_before(chunk)
        arrivals = self._stream.feed(chunk.link, chunk.data, chunk.arrival_ns, gap_before=gap)
        self._offer_all(arrivals, chunk.arrival_ns)

    def _offer_all(self, arrivals: Iterable[Arrival], complete_ns: int | None) -> None:
        for arrival in arrivals:
            if self._within is not None and not self._within(arrival.t_ns):
                self.counters.pings_outside += 1
            else:
                self.offer(arrival.ping, self._time_ns(arrival.ping), complete_ns)

    def _time_ns(self, ping: Ping | Reject) -> int | None:
        """By the sonar's own clock, where it has one."""
        if isinstance(ping, Reject):
            return None
        return ping_time_ns(ping, self._clock_of(ping.source_id))

    def _clock_of(self, source_id: int) -> SonarClock:
        if source_id not in self.clocks:
            latency_ns = round(self.config.device.latency_sec * 1e9)
            self.clocks[source_id] = SonarClock(latency_ns=latency_ns)
        return self.clocks[source_id]

    def _settled(self, now_ns: int | None, *, final: bool = False) -> list[Work]:
        work: list[Work] = []
        for ping, pose in self.poses.resolved(now_ns, final=final):
            ticket = self._tickets.popleft()  # pings come out in the order in which they went in
            settled = PosedPing(ticket.number, ping, pose, ticket.complete_ns, ticket.t_ns)
            work.append(settled)
        return work
