"""MAVLink 1 and 2 from one vehicle: frames, the sender, and its time.

Frames are found in any bytes; pymavlink checks and decodes packets. If a checksum is wrong, the
search continues one byte later, so that a garbled length loses one frame only. Later frames may be
delayed by the wrong length: by at most 280 bytes, and not at all in datagrams.
"""

from collections.abc import Iterator
from dataclasses import replace
from mmap import mmap
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from mapperd.config.odometry import FormatSettings
from mapperd.errors import Reject
from mapperd.odometry.clock import Leaders, Precedence
from mapperd.odometry.decoder import CountersState, DecoderCounters
from mapperd.odometry.mavlink_messages import ACCELERATIONS, ORDER, READERS, specific_force
from mapperd.odometry.records import Clock, Odometry

__all__ = [
    "BootClock",
    "MavlinkDecoder",
    "MavlinkFrames",
    "frame_size",
    "navigation_frame",
    "stamp_of_us",
]

V1, V2 = 0xFE, 0xFD
V1_OVERHEAD, V2_OVERHEAD, SIGNATURE = 8, 12, 13
SIGNED = 0x01
"""The only known incompatibility flag; frames with others cannot be decoded."""

MAX_FRAME_BYTES = 255 + V2_OVERHEAD + SIGNATURE


class MavlinkFrames:
    """Splits a stream or datagrams into messages.

    Attributes:
        skipped: number of bytes outside of frames.

    Args:
        datagrams: frames do not continue in the next piece.
    """

    def __init__(self, *, datagrams: bool) -> None:
        self.skipped = 0
        self._datagrams = datagrams
        self._buffer = bytearray()
        self._in_sync = True
        self._codec: Any = common.MAVLink(None)

    def restart(self) -> None:
        """Forget what is half received."""
        self.skipped += len(self._buffer)
        self._buffer.clear()

    def state(self) -> tuple[int, bytes, bool]:
        """Return the skipped bytes, the bytes of a partial frame, and if frames may continue."""
        return self.skipped, bytes(self._buffer), self._in_sync

    def restore(self, skipped: int, buffer: bytes, *, in_sync: bool) -> None:
        """Restore a state that `state` returned."""
        self.skipped, self._buffer, self._in_sync = skipped, bytearray(buffer), in_sync

    def feed(self, data: bytes) -> Iterator[Any]:
        """Yield messages, and one Reject for each run of bytes outside of frames."""
        self._buffer += data
        place = 0
        while (end := self._frame_end(place)) is not None:
            result = self._decoded(place, end)
            if result is None:
                self.skipped += 1
                place += 1
                if self._in_sync:
                    self._in_sync = False
                    yield Reject("not_a_frame", "bytes that are no MAVLink frame with a good check")
            else:
                place, self._in_sync = end, True
                yield result
        del self._buffer[:place]

    def _frame_end(self, place: int) -> int | None:
        """Return the end of a possible frame at `place`; `place` if there is none; None to wait."""
        buffer = self._buffer
        size = frame_size(buffer, place)
        if place < len(buffer) and (size is None or place + size > len(buffer)):
            return place if self._datagrams else None
        return None if size is None else place + size

    def _decoded(self, place: int, end: int) -> Any:  # noqa: ANN401 pymavlink's messages
        """Return the message, a Reject if it is valid but unknown, or None if it is no frame."""
        message = self._parsed(place, end)
        if isinstance(message, common.MAVLink_unknown) and not self._is_likely(place, end):
            return None
        if message is not None and self._buffer[place] == V2 and self._buffer[place + 2] & ~SIGNED:
            return Reject("incompatible", f"incompatibility flags {self._buffer[place + 2]:#04x}")
        return message

    def _parsed(self, place: int, end: int) -> Any:  # noqa: ANN401
        if place == end:
            return None
        try:
            return self._codec.decode(self._buffer[place:end])
        except common.MAVError:
            return None

    def _is_likely(self, place: int, end: int) -> bool:
        """Whether this is a frame of another dialect, whose checksum is unknown.

        It stands between frames, and no known frame begins within it.
        """
        buffer = self._buffer
        if not self._in_sync or (end < len(buffer) and buffer[end] not in (V1, V2)):
            return False
        for inner in range(place + 1, end):
            size = frame_size(buffer, inner) or 0
            if size and inner + size <= len(buffer):
                message = self._parsed(inner, inner + size)
                if not (message is None or isinstance(message, common.MAVLink_unknown)):
                    return False
        return True


def frame_size(buffer: bytearray | bytes | mmap, place: int) -> int | None:
    """Return the length of the frame at `place`; 0 without a frame, None with too few bytes."""
    if place >= len(buffer):
        return None
    if buffer[place] not in (V1, V2):
        return 0
    if place + 2 >= len(buffer):
        return None
    if buffer[place] == V1:
        return buffer[place + 1] + V1_OVERHEAD
    return buffer[place + 1] + V2_OVERHEAD + (SIGNATURE if buffer[place + 2] & SIGNED else 0)


_USED = frozenset(getattr(common, f"MAVLINK_MSG_ID_{name}") for name in (*READERS, *ACCELERATIONS))


def navigation_frame(frame: bytes, settings: FormatSettings) -> bool:
    """Return whether a frame is a message for `MavlinkDecoder`, by its header."""
    if frame[0] == V1:
        sender, number = frame[3:5], frame[5]
    else:
        sender, number = frame[5:7], int.from_bytes(frame[7:10], "little")
    wanted = settings.mavlink_system_id, settings.mavlink_component_id
    return number in _USED and all(
        want in (0, have) for want, have in zip(wanted, sender, strict=True)
    )


WRAP_MS = 1 << 32
NEAR_WRAP_MS = 3_600_000
"""Distance from the end and then the start of the counter that shows a wrap (after 49.7 days)."""

REBOOT_MS = 1000
"""Step back that shows a reboot; reordered datagrams differ by less."""

_UNIX_FROM_US = 10**15
"""Microseconds from which a number is Unix time (2001); no uptime is that long."""


class BootClock:
    """Follows the 32-bit counter of one system.

    Attributes:
        reboots: number of restarts.
    """

    def __init__(self) -> None:
        self.reboots = 0
        self._wraps = 0
        self._last_ms: int | None = None

    def state(self) -> tuple[int, int, int | None]:
        """Return reboots, wraps and the last number."""
        return self.reboots, self._wraps, self._last_ms

    def restore(self, reboots: int, wraps: int, last_ms: int | None) -> None:
        """Restore the state of a clock."""
        self.reboots, self._wraps, self._last_ms = reboots, wraps, last_ms

    def stamp_ns(self, boot_ms: int) -> int:
        """Return nanoseconds since boot."""
        last_ms = boot_ms if self._last_ms is None else self._last_ms
        if last_ms >= WRAP_MS - NEAR_WRAP_MS and boot_ms < NEAR_WRAP_MS:
            self._wraps += 1
        elif boot_ms >= WRAP_MS - NEAR_WRAP_MS and last_ms < NEAR_WRAP_MS and self._wraps:
            # From before the wrap, received late: do not follow it.
            return ((self._wraps - 1) * WRAP_MS + boot_ms) * 1_000_000
        elif boot_ms < last_ms - REBOOT_MS:
            self.reboots += 1
            self._wraps = 0
        self._last_ms = boot_ms
        return (self._wraps * WRAP_MS + boot_ms) * 1_000_000


def stamp_of_us(time_us: int) -> tuple[int, Clock]:
    """Return stamp and clock of microseconds since boot or Unix, decided by their size."""
    return time_us * 1000, "unix" if time_us >= _UNIX_FROM_US else "boot"


RESETS = 256
"""Range of the estimator's 8-bit counter; each reboot adds one range."""


MAX_APART_NS = 200_000_000
"""Maximum time between an acceleration and its attitude."""


class _Force(NamedTuple):
    """An acceleration that waits for its attitude: value and arrival time."""

    mps2: NDArray[np.float64]
    arrival_ns: int | None


class _MavlinkState(NamedTuple):
    counters: CountersState
    frames: tuple[int, bytes, bool]
    leaders: Leaders
    boot: tuple[int, int, int | None]
    resets: int
    force: tuple[list[float], int | None] | None = None
    force_rank: int | None = None


class MavlinkDecoder:
    """Decodes one link, UDP or serial.

    Accelerations arrive in separate messages; each is added to the next attitude.

    Attributes:
        counters: counters of this decoder.
    """

    def __init__(self, settings: FormatSettings, *, datagrams: bool = False) -> None:
        self.counters = DecoderCounters()
        self._settings = settings
        self._frames = MavlinkFrames(datagrams=datagrams)
        self._precedence = Precedence(ORDER)
        self._boot = BootClock()
        self._resets = 0
        self._force: _Force | None = None
        self._force_rank = len(ACCELERATIONS)

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:
        """Take the next bytes."""
        self.counters.bytes_total += len(data)
        for message in self._frames.feed(data):
            result = message if isinstance(message, Reject) else self._read(message, arrival_ns)
            if result is not None:
                yield self.counters.out(result)
        self.counters.bytes_skipped = self._frames.skipped

    def restart(self) -> None:
        """Forget what is half received."""
        self._frames.restart()
        self.counters.bytes_skipped = self._frames.skipped

    def state(self) -> _MavlinkState:
        """As `Decoder.state`."""
        return _MavlinkState(
            self.counters.state(),
            self._frames.state(),
            self._precedence.state(),
            self._boot.state(),
            self._resets,
            None if self._force is None else (self._force.mps2.tolist(), self._force.arrival_ns),
            self._force_rank,
        )

    def restore(self, state: Any) -> None:  # noqa: ANN401 as read from a checkpoint
        """As `Decoder.restore`."""
        known = msgspec.convert(state, _MavlinkState, strict=False)
        self.counters.restore(known.counters)
        skipped, buffer, in_sync = known.frames
        self._frames.restore(skipped, buffer, in_sync=in_sync)
        self._precedence.restore(known.leaders)
        self._boot.restore(*known.boot)
        self._resets = known.resets
        self._force = None
        if known.force is not None:
            self._force = _Force(np.array(known.force[0]), known.force[1])
        self._force_rank = len(ACCELERATIONS) if known.force_rank is None else known.force_rank

    def _read(self, message: Any, arrival_ns: int | None) -> Odometry | Reject | None:  # noqa: ANN401
        name = message.get_type()
        name = "unknown" if name.startswith("UNKNOWN") else name
        self.counters.heard(name, 0)
        if not self._is_ours(message):
            self.counters.ignore("other_system")
            return None
        if name in ACCELERATIONS:
            return self._felt(ACCELERATIONS.index(name), message, arrival_ns)
        reader = READERS.get(name)
        fields = None if reader is None else reader(message, self._settings)
        if fields is None:
            self.counters.ignore(name)
            return None
        if isinstance(fields, Reject):
            return fields
        odometry = self._stamped(name, message, fields)
        odometry_or_less = self._precedence.filtered(name, odometry, arrival_ns)
        if odometry_or_less is None:
            self.counters.ignore("superseded")
            return None
        return self._with_force(odometry_or_less, arrival_ns)

    def _felt(self, rank: int, message: Any, arrival_ns: int | None) -> Reject | None:  # noqa: ANN401
        """Note an acceleration, unless a better message provides one."""
        force = specific_force(message) if rank <= self._force_rank else None
        if force is None:
            self.counters.ignore("superseded")
        elif isinstance(force, Reject):
            return force
        else:
            self._force, self._force_rank = _Force(force, arrival_ns), rank
        return None

    def _with_force(self, odometry: Odometry, arrival_ns: int | None) -> Odometry:
        force = self._force
        if force is None or odometry.map_q_base is None:
            return odometry
        self._force = None
        arrivals_ns = [one for one in (force.arrival_ns, arrival_ns) if one is not None]
        if arrivals_ns and max(arrivals_ns) - min(arrivals_ns) > MAX_APART_NS:
            return odometry
        return replace(odometry, specific_force_mps2=force.mps2)

    def _is_ours(self, message: Any) -> bool:  # noqa: ANN401
        system, component = self._settings.mavlink_system_id, self._settings.mavlink_component_id
        return system in (0, message.get_srcSystem()) and component in (
            0,
            message.get_srcComponent(),
        )

    def _stamped(self, name: str, message: Any, fields: dict[str, Any]) -> Odometry:  # noqa: ANN401
        clock: Clock = "boot"
        if name == "ODOMETRY":
            stamp_ns, clock = stamp_of_us(message.time_usec)
            self._resets = message.reset_counter
            if clock == "boot":  # to notice a reboot
                self._boot.stamp_ns(message.time_usec // 1000 % WRAP_MS)
        else:
            stamp_ns = self._boot.stamp_ns(message.time_boot_ms)
        source = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        resets = self._boot.reboots * RESETS + self._resets
        return Odometry(stamp_ns, clock, reset_count=resets, source=source, **fields)
