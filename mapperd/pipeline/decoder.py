"""Decodes the bytes of all links to pings with their poses, live and recorded.

The result depends only on the chunks and their order; nothing here reads a clock. A recording
therefore gives the same map as the live session.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.imaging.ping_image import corrected_ranges
from mapperd.odometry.bridge import ENCODING_PREFIX
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.framing import LinkParser
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
    obeyed,
)
from oculus_driver.clock import SonarClock, SonarClockState
from oculus_driver.ping import Ping, PingSequence, decode_ping
from oculus_driver.recording import OCULUS, Chunk
from oculus_driver.stream import Framing, Message, StreamParserState
from oculus_driver.wire import MessageId

__all__ = [
    "NewSettings",
    "PingStream",
    "PosedPing",
    "SessionDecoder",
    "SessionDecoderState",
    "Work",
]


class Arrival(NamedTuple):
    """A ping message.

    Attributes:
        arrival_ns: arrival time of its first byte; None if unknown.
        ping: the ping, or why it is rejected.
        damaged: some of its bytes fail their checksum.
    """

    arrival_ns: int | None
    ping: Ping | Reject
    damaged: bool = False


Parts = list[tuple[int, int]]
"""Parts of a link's stream, by the offsets of their first byte and of the next one after them."""


class PingStreamState(NamedTuple):
    """State of a `PingStream`.

    Attributes:
        parsers: link to the state of its parser.
        sequence: of the ping numbers.
        owner: link whose pings are mapped; None before the first ping.
        unnumbered: rejected ping messages since the last ping.
        not_lost: missing ping numbers that these messages explain.
        damaged: parts of each link that fail their checksum and are not parsed yet.
    """

    parsers: dict[str, StreamParserState]
    sequence: tuple[int, int, int, int | None]
    owner: str | None
    unnumbered: int
    not_lost: int
    damaged: dict[str, Parts] | None = None


FULL_PING = Reject("full_ping", "full ping results (message 0x22) do not name what a map needs")


class PingStream:
    """Decodes the pings in the bytes of each link; each ping message counts once.

    Args:
        confirm: hold each ping back until the next bytes confirm that none of its bytes is
            missing: for recordings, too slow for live pings.
    """

    def __init__(self, *, confirm: bool = False) -> None:
        self._confirm = confirm
        self._parsers: dict[str, LinkParser] = {}
        self._sequence = PingSequence()
        self._owner: str | None = None
        self._unnumbered = 0  # rejected ping messages since the last ping
        self._not_lost = 0  # missing ping numbers that these messages explain
        self._damaged: dict[str, Parts] = {}

    def feed(
        self,
        link: str,
        data: bytes,
        arrival_ns: int | None,
        *,
        gap_before: bool = False,
        damaged: bool = False,
        framing: Framing | None = None,
    ) -> Iterator[Arrival]:
        """Feed the next bytes of a link; yield the ping messages that they complete.

        Args:
            link: name of the link.
            data: its bytes, in any fragmentation.
            arrival_ns: their arrival time.
            gap_before: bytes in front of them are missing.
            damaged: they fail their checksum.
            framing: what the driver found in them; None if they did not come from it.
        """
        parser = self._parsers.setdefault(link, LinkParser(confirm=self._confirm))
        if damaged:
            start = parser.counters.bytes_total
            self._damaged.setdefault(link, []).append((start, start + len(data)))
        messages = parser.feed(data, arrival_ns, gap_before=gap_before, framing=framing)
        yield from self._arrivals(link, messages)

    def state(self) -> PingStreamState:
        """Return everything that `restore` needs to continue exactly."""
        return PingStreamState(
            {link: parser.state() for link, parser in self._parsers.items()},
            self._sequence.state(),
            self._owner,
            self._unnumbered,
            self._not_lost,
            {link: list(parts) for link, parts in self._damaged.items()} or None,
        )

    def restore(self, state: PingStreamState) -> None:
        """Continue as the one of which `state` was taken; the arguments must be the same."""
        for link, parser in state.parsers.items():
            self._parsers[link] = LinkParser(confirm=self._confirm)
            self._parsers[link].restore(parser)
        self._sequence.restore(state.sequence)
        self._owner, self._unnumbered = state.owner, state.unnumbered
        self._not_lost = state.not_lost
        self._damaged = {link: list(parts) for link, parts in (state.damaged or {}).items()}

    def finish(self) -> Iterator[Arrival]:
        """Yield the pending ping messages at the end of all links."""
        for link, parser in self._parsers.items():
            yield from self._arrivals(link, parser.finish())

    def count(self, counters: PipelineCounters) -> None:
        """Add the counters of the parsers and of the ping numbers."""
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
            if message.message_id == MessageId.FULL_PING_RESULT:
                yield Arrival(message.arrival_ns, FULL_PING)
            elif message.message_id == MessageId.PING_RESULT:
                damaged = self._is_damaged(link, message)
                ping = self._ping_of(link, message, damaged=damaged)
                yield Arrival(message.arrival_ns, ping, damaged)

    def _is_damaged(self, link: str, message: Message) -> bool:
        """Return whether a damaged part reaches into a message; forget the parts before it."""
        if link not in self._damaged:
            return False
        parts = [part for part in self._damaged.pop(link) if part[1] > message.offset]
        if parts:
            self._damaged[link] = parts
        return any(start < message.offset + len(message.data) for start, _ in parts)

    def _ping_of(self, link: str, message: Message, *, damaged: bool) -> Ping | Reject:
        ping = decode_ping(message)
        if not isinstance(ping, Ping):
            self._unnumbered += link == self._owner
            return Reject(ping.reason, ping.detail)
        # The mounting holds for one sonar: pings of a second one would be misplaced.
        self._owner = self._owner or link
        if link != self._owner:
            return Reject("other_link", f"pings of {link!r}; those of {self._owner!r} are mapped")
        if damaged:  # its number may be wrong
            self._unnumbered += 1
        elif not self._is_new(ping.ping_id):
            return Reject("duplicate", f"ping {ping.ping_id} came twice")
        return ping

    def _is_new(self, ping_id: int) -> bool:
        """Follow the ping numbers; each rejected message explains one missing number."""
        lost = self._sequence.lost_pings
        new = self._sequence.accept(ping_id)
        self._not_lost += min(self._unnumbered, self._sequence.lost_pings - lost)
        self._unnumbered = 0
        return new


@dataclass(frozen=True, slots=True, eq=False)
class PosedPing:
    """A ping with the odometry's pose.

    Attributes:
        number: of the ping in its session, from 0; every ping message counts.
        ping: the decoded ping.
        pose: of the base at `t_ns`, or why it is unknown.
        complete_ns: arrival of the last byte, clock of the arrivals; None if unknown.
        t_ns: when the sound reached the middle of the image, same clock; None if unknown.
    """

    number: int
    ping: Ping
    pose: FusedPose | Reject
    complete_ns: int | None
    t_ns: int | None = None


@dataclass(frozen=True, slots=True)
class NewSettings:
    """The following pings are mapped with other settings."""

    config: Config


Work = PosedPing | NewSettings | Reset | Request
"""One piece of work for the executor."""


@dataclass(frozen=True, slots=True)
class _Ticket:
    number: int
    complete_ns: int | None
    t_ns: int | None
    damaged: bool = False


class SessionDecoderState(NamedTuple):
    """State of a `SessionDecoder`, without settings and counters.

    Attributes:
        pings, bytes_taken, orders_taken: its attributes.
        clocks: source id to the state of that sonar's clock.
        poses, stream: of its parts.
        tickets: number, time of the last byte and time of each ping that waits for its pose.
        whole: pings that were complete so far.
        gaps: links of which bytes are missing before the next ones.
        damaged: numbers of the pings that wait for their pose and are damaged.
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
    damaged: tuple[int, ...] = ()


DAMAGED = Reject("checksum", "bytes of the recording fail their checksum")


class SessionDecoder:
    """Turns the chunks of one session into work: frames, decodes, and looks up poses.

    Chunks that fail their checksum are not mapped: their pings keep their numbers and get no pose,
    their odometry counts as missing. Their decisions are not carried out, except gaps.

    Args:
        config: the settings at the beginning of the session.
        poses: fixed, or from odometry; fresh.
        counters: of the pings.
        confirm: hold each ping back until the next bytes confirm it: for recordings that do not
            mark missing bytes.
        obey: carry out the recorded decisions; otherwise only gaps count.
        within: whether to map a ping that arrived at a time; None maps all.

    Attributes:
        config: the settings for the next chunk.
        counters: as given.
        pings: ping messages so far: the number of the next one.
        bytes_taken, orders_taken: position in the session's stream: bytes of all links including
            skipped ones, and orders other than `Skip`. It does not depend on how a log splits the
            bytes into pieces and files.
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
        """Number of pings that wait for their poses."""
        return len(self._tickets)

    def state(self) -> SessionDecoderState:
        """Return everything that `restore` needs to continue exactly; between two chunks."""
        return SessionDecoderState(
            self.pings,
            self.bytes_taken,
            self.orders_taken,
            {source_id: clock.state() for source_id, clock in self.clocks.items()},
            self.poses.state(),
            self._stream.state(),
            [(ticket.number, ticket.complete_ns, ticket.t_ns) for ticket in self._tickets],
            self._whole,
            sorted(self._gaps),
            tuple(ticket.number for ticket in self._tickets if ticket.damaged),
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
        self._tickets = deque(
            _Ticket(*ticket, damaged=ticket[0] in state.damaged) for ticket in state.tickets
        )
        self._whole, self._gaps = state.whole, set(state.gaps)

    def feed(
        self, chunk: Chunk, *, late: bool = False, framing: Framing | None = None
    ) -> list[Work]:
        """Decode the next chunk; return the resulting work in order.

        Args:
            chunk: of any link.
            late: the chunk is after the chosen part of the recording: its sonar bytes may complete
                a ping, its odometry is ignored.
            framing: what the driver found in bytes of the sonar; None if they did not come from it.
        """
        if chunk.encoding == DECISIONS:
            return list(self._decide(chunk))
        self.bytes_taken += len(chunk.data)
        if chunk.encoding == OCULUS:
            self._take_sonar(chunk, framing)
        elif chunk.encoding.startswith(ENCODING_PREFIX) and not late:
            self._take_odometry(chunk)
        return self._resolve(None if late or chunk.damaged else chunk.arrival_ns)

    def end(self, *, cut: bool = False) -> list[Work]:
        """Return the work that is pending at the end of the session.

        Args:
            cut: the recording continues, so incomplete messages are not counted.
        """
        if not cut:
            self._offer_all(self._stream.finish(), None)
        work = self._resolve(None, final=True)
        self._stream.count(self.counters)
        return work

    def offer(
        self,
        ping: Ping | Reject,
        t_ns: int | None,
        complete_ns: int | None,
        *,
        damaged: bool = False,
    ) -> None:
        """Count a ping and pass it to the pose lookup.

        Args:
            ping: the ping, or why it is rejected.
            t_ns: as for `PoseLookup.add_ping`.
            complete_ns: arrival of its last byte.
            damaged: some of its bytes fail their checksum.
        """
        number, self.pings = self.pings, self.pings + 1
        self.counters.pings_total += 1
        if isinstance(ping, Reject):
            self.counters.drop(ping)
            return
        skip = self.config.processing.frame_skip
        phase, self._whole = self._whole % skip, self._whole + 1
        if phase:
            self.counters.drop(Reject("frame_skip", f"every {skip}th ping is mapped"))
            return
        placed_ns = ping_time_ns(ping) if t_ns is None else t_ns
        self._tickets.append(_Ticket(number, complete_ns, placed_ns, damaged))
        self.poses.add_ping(ping, placed_ns, damaged=damaged)

    def reconfigure(self, config: Config) -> None:
        """Decode the following chunks with other settings."""
        self.config = config
        self.poses.reconfigure(config)

    def _decide(self, chunk: Chunk) -> Iterator[Work]:
        decision = decision_of(chunk)
        self.orders_taken += not isinstance(decision, Skip) and not is_remark(decision)
        match obeyed(chunk):
            case Gap(link):
                self._gaps.add(link)
            case Skip(link, size) if self._obey:
                self._gaps.add(link)
                self.bytes_taken += size
            case Settings(values) if self._obey:
                self.reconfigure(with_values(self.config, values))
                yield NewSettings(self.config)
            case Reset() as reset if self._obey:
                yield reset
            case request if self._obey and isinstance(request, Request):
                yield request

    def _gap_before(self, chunk: Chunk) -> bool:
        gap = chunk.gap_before or chunk.link in self._gaps
        self._gaps.discard(chunk.link)
        return gap

    def _take_odometry(self, chunk: Chunk) -> None:
        if chunk.damaged:
            self._gaps.add(chunk.link)
            return
        self.poses.add_odometry(
            chunk.link,
            chunk.data,
            chunk.arrival_ns,
            encoding=chunk.encoding,
            gap_before=self._gap_before(chunk),
        )

    def _take_sonar(self, chunk: Chunk, framing: Framing | None) -> None:
        arrivals = self._stream.feed(
            chunk.link,
            chunk.data,
            chunk.arrival_ns,
            gap_before=self._gap_before(chunk),
            damaged=chunk.damaged,
            framing=framing,
        )
        self._offer_all(arrivals, chunk.arrival_ns)

    def _offer_all(self, arrivals: Iterable[Arrival], complete_ns: int | None) -> None:
        for arrival_ns, received, damaged in arrivals:
            ping = received
            if isinstance(received, Ping):
                ping = corrected_ranges(received, self.config.water)
            if self._within is not None and not self._within(arrival_ns):
                self.counters.pings_outside += 1
            else:
                t_ns = None if damaged else self._time_ns(ping)
                self.offer(ping, t_ns, complete_ns, damaged=damaged)

    def _time_ns(self, ping: Ping | Reject) -> int | None:
        """Return when the sound reached the middle of the image, by the sonar's own clock."""
        if isinstance(ping, Reject):
            return None
        return ping_time_ns(ping, self._clock_of(ping.source_id))

    def _clock_of(self, source_id: int) -> SonarClock:
        if source_id not in self.clocks:
            latency_ns = round(self.config.device.latency_sec * 1e9)
            self.clocks[source_id] = SonarClock(latency_ns=latency_ns)
        return self.clocks[source_id]

    def _resolve(self, now_ns: int | None, *, final: bool = False) -> list[Work]:
        work: list[Work] = []
        for ping, pose in self.poses.resolved(now_ns, final=final):
            ticket = self._tickets.popleft()  # the lookup keeps the order of the pings
            posed = DAMAGED if ticket.damaged else pose
            work.append(PosedPing(ticket.number, ping, posed, ticket.complete_ns, ticket.t_ns))
        return work
