"""Playback of a recording as a virtual sonar."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import TYPE_CHECKING, Final

from oculus_driver.models import MAX_RATE_HZ
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.stream import Message, StreamParser
from oculus_driver.virtual_sonar.device import LOCAL, M750D_PART, Identity, VirtualDevice
from oculus_driver.virtual_sonar.resample import resample_ping
from oculus_driver.virtual_sonar.server import ANY, VirtualSonar
from oculus_driver.wire import MessageId, PingRate, ping_result_layout

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Generator, Iterable, Iterator

    from oculus_driver.virtual_sonar.device import FireRequest
    from oculus_driver.virtual_sonar.faults import Faults


class PlaybackDevice(VirtualDevice):
    """Plays recorded messages and follows fire messages. No sockets, no clock.

    Before the first fire message it pings as recorded, or is in standby: real sonars keep their
    last settings over power cycles. It follows standby, ping rate (never faster than recorded) and
    network trigger; with `resampled` also range, beams, samples, gain words, mode and version of
    the results, see `oculus_driver.virtual_sonar.resample`.

    Args:
        source: the messages to play.
        identity: of the sonar.
        resampled: convert pings to the requested settings instead of sending them as recorded.
        standby: start in standby.
        loops: number of repetitions, None: endless.
        ignored_fire_version: version of fire messages to ignore.
    """

    def __init__(
        self,
        source: MessageSource,
        identity: Identity | None = None,
        *,
        resampled: bool = False,
        standby: bool = False,
        loops: int | None = 1,
        ignored_fire_version: int | None = None,
    ) -> None:
        identity = identity or Identity()
        self._source = source
        self._resampled = resampled
        self._standby = standby
        self._loops_left = loops
        self._renumbering = Renumbering()
        self._join_wait_ns = 0  # between the end of the recording and its repetition
        self._steps: Generator[TimedMessage, None, None] | None = None
        self._upcoming: TimedMessage | None = None
        self._load()
        first = None if self._upcoming is None else self._upcoming.message
        device_id = identity.device_id or (first.source_id if first else 0) or 1
        known_part = first.part_number if first else 0
        part_number = identity.part_number or known_part or M750D_PART
        super().__init__(identity, device_id, part_number, ignored_fire_version)

    @property
    def pinging(self) -> bool:
        """Whether it transmits, continuously or on triggers."""
        if not self.can_ping or self._upcoming is None:
            return False
        return not (self._standby if self.request is None else self.request.standby)

    @property
    def ended(self) -> bool:
        """Whether all messages were played."""
        return self._upcoming is None

    @property
    def next_is_ping(self) -> bool:
        """Whether the next message is a ping."""
        step = self._upcoming
        return step is not None and step.message.message_id == MessageId.PING_RESULT

    async def prepare(self) -> None:
        """Do nothing: recorded messages are always prepared."""

    def wait_ns(self) -> int:
        """Return the time between the previous message and the next one."""
        if self._upcoming is None or (self.triggered and self.next_is_ping):
            return 0
        recorded_ns = self._join_wait_ns or self._upcoming.wait_ns
        if self.request is None or not self.next_is_ping:
            return recorded_ns
        rate_hz = MAX_RATE_HZ.get(PingRate(self.request.ping_rate)) if self._rate_known() else None
        return max(recorded_ns, round(1e9 / rate_hz) if rate_hz else 0)

    def take(self) -> tuple[bytes, int | None]:
        """Return the next message and, of a ping, its id.

        Raises:
            LookupError: all messages were played.
        """
        if self._upcoming is None:
            raise LookupError("all messages were played")
        message = self._upcoming.message
        data, ping_id = self._renumbering.apply(message)
        if ping_id is not None:
            self.triggers = max(0, self.triggers - 1)
            if self._resampled and self.request is not None:
                data = self._resample(data, self.request)
        self._load()
        return data, ping_id

    def restart(self) -> None:
        """Restart ids and device time; the settings stay."""
        self._renumbering.restart()

    def close(self) -> None:
        """Close the recording."""
        if self._steps is not None:
            self._steps.close()

    def _rate_known(self) -> bool:
        return self.request is not None and self.request.ping_rate in MAX_RATE_HZ

    def _resample(self, data: bytes, request: FireRequest) -> bytes:
        messages = StreamParser().feed(data)
        ping = decode_ping(messages[0]) if messages else None
        return resample_ping(ping, request, self._part_number) if isinstance(ping, Ping) else data

    def _load(self) -> None:
        """Load the next message; at the end of the recording start over while loops are left."""
        last_wait_ns = DEFAULT_WAIT_NS if self._upcoming is None else self._upcoming.wait_ns
        self._join_wait_ns = 0
        self._upcoming = None if self._steps is None else next(self._steps, None)
        if self._upcoming is not None or self._loops_left == 0:
            return
        if self._loops_left is not None:
            self._loops_left -= 1
        if self._steps is not None:
            self._join_wait_ns = last_wait_ns or DEFAULT_WAIT_NS
        self._steps = iter(self._source)
        self._upcoming = next(self._steps, None)
        self._renumbering.join()


_U32: Final = struct.Struct("<I")
_F64: Final = struct.Struct("<d")
_WRAP: Final = 1 << 32

_FIRST_ID: Final = 1
_STEP_S: Final = 0.1
_STEP_TICKS: Final = 12_500_000
"""0.1 s at 8 ns per tick."""


class Renumbering:
    """Shifts ids and times so that they continue when a recording is repeated."""

    def __init__(self) -> None:
        self._anchor: str | None = None  # pending shift for the next ping: join or restart
        self._id_shift = 0
        self._time_shift = 0.0
        self._boots = 0
        self._last: tuple[int, float] | None = None  # id and time

    def join(self) -> None:
        """Let the next ping continue the sequence of the last one, if there is one."""
        if self._last is not None and self._anchor is None:
            self._anchor = "join"

    def restart(self) -> None:
        """Let the next ping be the first one after power-up."""
        self._anchor = "restart"

    def apply(self, message: Message) -> tuple[bytes, int | None]:
        """Return the shifted message and, of a ping, its id."""
        layout = ping_result_layout(message.version)
        if message.message_id != MessageId.PING_RESULT or layout is None:
            return message.data, None
        fields = layout.unpack(message.data)
        ticks = "start_ticks" in fields
        name = "start_ticks" if ticks else "start_time_s"
        self._settle_shift(fields["ping_id"], fields[name], _STEP_TICKS if ticks else _STEP_S)
        ping_id = (fields["ping_id"] + self._id_shift) % _WRAP
        time = fields[name] + self._time_shift
        self._last = ping_id, time
        if not self._id_shift and not self._time_shift:
            return message.data, ping_id
        data = bytearray(message.data)
        _U32.pack_into(data, layout.offset_of("ping_id"), ping_id)
        if ticks:
            _U32.pack_into(data, layout.offset_of(name), int(time) % _WRAP)
        else:
            _F64.pack_into(data, layout.offset_of(name), time)
        return bytes(data), ping_id

    def _settle_shift(self, ping_id: int, time: float, step: float) -> None:
        if self._anchor == "join" and self._last is not None:
            self._id_shift = self._last[0] + 1 - ping_id
            self._time_shift = self._last[1] + step - time
        elif self._anchor == "restart":
            # Boot times differ, so that the first pings of two boots are not duplicates.
            self._boots += 1
            self._id_shift = _FIRST_ID - ping_id
            self._time_shift = step * (1 + self._boots / 1024) - time
        self._anchor = None


TICK_NS: Final = 8
"""Length of a version-1 clock tick, derived from captures with a known ping rate."""

MAX_WAIT_NS: Final = 10_000_000_000
"""Longer pauses of a recording are shortened to this."""

DEFAULT_WAIT_NS: Final = 100_000_000
"""Wait between pings without times: the sonar's normal rate."""

_TICKS_WRAP: Final = 1 << 32


@dataclass(frozen=True, slots=True)
class TimedMessage:
    """One message and the wait since the previous one; 0 before the first."""

    message: Message
    wait_ns: int


class MessageSource:
    """The messages sent by a sonar, in order; can be iterated repeatedly.

    Args:
        source: path of a recording of any format, or complete messages.
    """

    def __init__(self, source: str | os.PathLike[str] | Sequence[bytes]) -> None:
        self._source = source

    def __iter__(self) -> Generator[TimedMessage, None, None]:
        last: Message | None = None
        for message in self._messages():
            if message.message_id == MessageId.FIRE:  # sent by a client
                continue
            yield TimedMessage(message, 0 if last is None else _wait_ns(last, message))
            last = message

    def _messages(self) -> Iterator[Message]:
        if not isinstance(self._source, Sequence) or isinstance(self._source, str):
            return _recorded(self._source)
        return _parsed(self._source)


def _recorded(path: str | os.PathLike[str]) -> Iterator[Message]:
    from oculus_driver.recording import open_recording  # noqa: PLC0415 - slow to import
    from oculus_driver.recording.chunk import messages_of  # noqa: PLC0415 - as above

    with open_recording(path) as recording:
        yield from messages_of(recording)


def _parsed(pieces: Iterable[bytes]) -> Iterator[Message]:
    parser = StreamParser(confirm=True)
    for data in pieces:
        yield from parser.feed(data)
    yield from parser.finish()


def _wait_ns(before: Message, after: Message) -> int:
    """Return the time between two messages, by arrival or else by the sonar's clock."""
    if before.arrival_ns is not None and after.arrival_ns is not None:
        wait_ns = after.arrival_ns - before.arrival_ns
    else:
        wait_ns = _device_wait_ns(before, after)
    return min(max(wait_ns, 0), MAX_WAIT_NS)


def _device_wait_ns(before: Message, after: Message) -> int:
    first, second = _device_time_ns(before), _device_time_ns(after)
    if after.message_id != MessageId.PING_RESULT:
        return 0
    if first is None or second is None or first[1] != second[1]:
        return DEFAULT_WAIT_NS
    wrap_ns = first[1]
    wait_ns = (second[0] - first[0]) % wrap_ns if wrap_ns else second[0] - first[0]
    return wait_ns if 0 <= wait_ns <= MAX_WAIT_NS else DEFAULT_WAIT_NS


def _device_time_ns(message: Message) -> tuple[int, int] | None:
    """Return the sonar's own time and the period after which it wraps, 0 for never."""
    layout = ping_result_layout(message.version)
    if message.message_id != MessageId.PING_RESULT or layout is None:
        return None
    fields = layout.unpack(message.data)
    if "start_ticks" in fields:
        return fields["start_ticks"] * TICK_NS, _TICKS_WRAP * TICK_NS
    seconds = fields["start_time_s"]
    return (round(seconds * 1e9), 0) if 0.0 <= seconds < 1e9 else None  # noqa: PLR2004 - 30 years


class PlaybackSonar(VirtualSonar[PlaybackDevice]):
    """A recording served as a sonar on this computer, within an `async with` block.

    Args:
        source: path of a recording of any format, or complete messages.
        speed: factor on the recorded time; None: as fast as the client reads.
        loops: number of repetitions, None: endless. At the end only dummies follow.
        identity: of the sonar; None: address of `host`, the rest from the recording.
        resampled, standby: see `PlaybackDevice`.
        host, port, status_to, status_period_s, dummy_period_s, faults, on_ping: see
            `oculus_driver.virtual_sonar.server.VirtualSonar`.

    Raises:
        RecordingError: the source is not a recording.
        OculusError: the address cannot be opened; raised on entering.
    """

    def __init__(
        self,
        source: str | os.PathLike[str] | Sequence[bytes],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        speed: float | None = 1.0,
        loops: int | None = 1,
        status_to: Sequence[tuple[str, int]] = (),
        status_period_s: float = 1.0,
        dummy_period_s: float = 1.0,
        identity: Identity | None = None,
        resampled: bool = False,
        standby: bool = False,
        faults: Faults | None = None,
        on_ping: Callable[[int, bool], None] | None = None,
    ) -> None:
        device = PlaybackDevice(
            MessageSource(source),
            identity or Identity(address=advertised_address(host)),
            resampled=resampled,
            standby=standby,
            loops=loops,
            ignored_fire_version=None if faults is None else faults.ignored_fire_version,
        )
        super().__init__(
            device,
            host=host,
            port=port,
            speed=speed,
            status_to=status_to,
            status_period_s=status_period_s,
            dummy_period_s=dummy_period_s,
            faults=faults,
            on_ping=on_ping,
        )


def advertised_address(host: str) -> IPv4Address:
    """Return the address in the statuses of a sonar that listens at `host`."""
    address = IPv4Address(host)
    return LOCAL if address == ANY else address
