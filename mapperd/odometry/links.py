"""Links to the vehicle: opens them, reads within limits, and reopens lost ones.

The phases of a link form a state machine without I/O and clock:

opening ─▶ waiting ─▶ receiving ⇄ silent
   ▲          │            │         │
   └─ backing off ◀────────┴─────────┘   (lost, or silent for too long on a connection)
"""

import asyncio
import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NoReturn, Protocol, TypeVar

from mapperd.config.odometry import LinkAddress, serial_path
from mapperd.errors import ConfigError, missing_extra
from oculus_driver.back_off import BackOff, doubling_steps

if TYPE_CHECKING:
    from serial import Serial

__all__ = [
    "LinkPhase",
    "OdometryLink",
    "OdometryLinkState",
    "OdometryLinkStatus",
    "OnBytes",
    "listen_to",
]

OnBytes = Callable[[bytes], bool]
"""Receives data; returns whether to read on at once."""

OnOpen = Callable[[], None]

MAX_READ_BYTES = 1 << 16
CONNECT_TIMEOUT_S = 5.0
PAUSE_S = 0.05
"""Pause before a port over its limit is read again; the system drops the rest."""


async def listen_to(address: LinkAddress, on_open: OnOpen, on_bytes: OnBytes) -> NoReturn:
    """Open a link and pass on its data.

    Args:
        address: the link.
        on_open: called when it is open.
        on_bytes: called with each datagram or piece of the stream.

    Raises:
        OSError: it cannot be opened or was lost; the text states the reason.
        ConfigError: a required library is not installed.
    """
    if address.kind == "udp":
        await _listen_udp(address, on_open, on_bytes)
    if address.kind == "tcp":
        await _read_tcp(address, on_open, on_bytes)
    await _read_serial(address, on_open, on_bytes)


async def _listen_udp(address: LinkAddress, on_open: OnOpen, on_bytes: OnBytes) -> NoReturn:
    loop = asyncio.get_running_loop()
    lost: asyncio.Future[None] = loop.create_future()
    with await _bound(address) as port:

        def read() -> None:
            try:
                wants_more = on_bytes(port.recv(MAX_READ_BYTES))
            except BlockingIOError:
                return
            except OSError as error:
                loop.remove_reader(port)
                lost.set_exception(error)
                return
            if not wants_more:
                loop.remove_reader(port)
                pauses.append(loop.call_later(PAUSE_S, resume))

        def resume() -> None:
            pauses.clear()
            loop.add_reader(port, read)

        pauses: list[asyncio.TimerHandle] = []
        loop.add_reader(port, read)
        try:
            on_open()
            await lost
        finally:
            lost.cancel()
            loop.remove_reader(port)
            for pause in pauses:
                pause.cancel()
    raise ConnectionAbortedError("the port was closed")


async def _bound(address: LinkAddress) -> socket.socket:
    """Return a bound UDP socket that does not block."""
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(
        address.host, address.port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE
    )
    family, kind, protocol, _, where = found[0]
    port = socket.socket(family, kind, protocol)
    try:
        port.setblocking(False)  # noqa: FBT003 its only argument
        port.bind(where)
    except OSError:
        port.close()
        raise
    return port


async def _read_tcp(address: LinkAddress, on_open: OnOpen, on_bytes: OnBytes) -> NoReturn:
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            reader, writer = await asyncio.open_connection(address.host, address.port)
    except TimeoutError:
        raise TimeoutError(f"no answer within {CONNECT_TIMEOUT_S:g} s") from None
    except ConnectionError as error:
        raise OSError(error.errno, os.strerror(error.errno or 0).lower()) from error
    try:
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        on_open()
        while data := await reader.read(MAX_READ_BYTES):
            on_bytes(data)
    finally:
        writer.close()
    raise ConnectionResetError("closed by the other side")


async def _read_serial(address: LinkAddress, on_open: OnOpen, on_bytes: OnBytes) -> NoReturn:
    port = await asyncio.to_thread(_opened, address)
    loop = asyncio.get_running_loop()
    lost: asyncio.Future[None] = loop.create_future()

    def read() -> None:
        try:
            data = port.read(MAX_READ_BYTES)
            if not data:  # an unplugged line is readable and empty
                raise ConnectionResetError("the line was unplugged")
        except OSError as error:
            loop.remove_reader(port.fileno())
            lost.set_exception(error)
            return
        on_bytes(bytes(data))

    loop.add_reader(port.fileno(), read)
    try:
        on_open()
        await lost
    finally:
        if not lost.done():
            loop.remove_reader(port.fileno())
            lost.cancel()
        port.close()
    raise ConnectionAbortedError("the line was closed")


def _opened(address: LinkAddress) -> "Serial":
    try:
        import serial  # noqa: PLC0415 an extra
    except ModuleNotFoundError as error:
        raise ConfigError(f"serial links: {missing_extra('pyserial', 'serial')}") from error
    path = serial_path(address.device)
    return serial.Serial(str(path), address.baud, timeout=0, exclusive=True)


SECOND_NS = 1_000_000_000
SILENT_NS = 5 * SECOND_NS
RECONNECT_NS = 15 * SECOND_NS
"""Silence after which a connection counts as dead."""
BACK_OFF_NS = doubling_steps(SECOND_NS // 2, 5 * SECOND_NS)


class LinkPhase(StrEnum):
    """What the link does now."""

    CLOSED = "closed"
    OPENING = "opening"
    WAITING = "waiting"
    RECEIVING = "receiving"
    SILENT = "silent"
    BACKING_OFF = "backing off"


@dataclass(frozen=True, slots=True)
class OdometryLinkStatus:
    """The link at one moment.

    Attributes:
        phase: current phase.
        since_ns: start of the phase, host clock.
        reason: the reason, for people.
        bytes_received: number of bytes since the start.
        opened: number of times it was opened.
        losses: number of times it was lost or could not be opened.
    """

    phase: LinkPhase
    since_ns: int
    reason: str
    bytes_received: int
    opened: int
    losses: int

    def time_in_phase_s(self, now_ns: int) -> float:
        """Return the time in this phase."""
        return (now_ns - self.since_ns) / SECOND_NS


class OdometryLinkState:
    """State machine of one link. Every method takes the host's time in nanoseconds.

    Args:
        where: name of the link in reasons.
        connects: reconnect after silence, which may mean a dead connection.
    """

    def __init__(self, where: str, *, connects: bool) -> None:
        self._where = where
        self._connects = connects
        self._phase = LinkPhase.CLOSED
        self._since_ns = 0
        self._reason = "not started"
        self._heard_ns = 0
        self._bytes = self._opened = self._losses = 0
        self._back_off = BackOff(BACK_OFF_NS)

    @property
    def status(self) -> OdometryLinkStatus:
        """The current status."""
        return OdometryLinkStatus(
            self._phase, self._since_ns, self._reason, self._bytes, self._opened, self._losses
        )

    @property
    def overdue_ns(self) -> int | None:
        """Time for the next `tick`; None if only an event can change the state."""
        if self._phase in (LinkPhase.WAITING, LinkPhase.RECEIVING):
            return self._heard_ns + SILENT_NS
        if self._phase is LinkPhase.SILENT and self._connects:
            return self._heard_ns + RECONNECT_NS
        return None

    def opening(self, now_ns: int) -> None:
        """Note that the link is being opened."""
        self._enter(LinkPhase.OPENING, f"opening {self._where}", now_ns)

    def opened(self, now_ns: int) -> None:
        """Note that the link is open."""
        self._opened += 1
        self._heard_ns = now_ns
        self._enter(LinkPhase.WAITING, f"{self._where} is open, nothing received yet", now_ns)

    def received(self, size: int, now_ns: int) -> None:
        """Note received bytes."""
        self._bytes += size
        self._heard_ns = now_ns
        self._back_off.succeeded()
        if self._phase is not LinkPhase.RECEIVING:
            self._enter(LinkPhase.RECEIVING, f"bytes come from {self._where}", now_ns)

    def tick(self, now_ns: int) -> bool:
        """Check the time; return True if the connection should be closed."""
        overdue_ns = self.overdue_ns
        if overdue_ns is None or now_ns < overdue_ns:
            return False
        if self._phase is LinkPhase.SILENT:
            return True
        quiet_s = (now_ns - self._heard_ns) / SECOND_NS
        self._enter(
            LinkPhase.SILENT, f"nothing received for {quiet_s:.0f} s on {self._where}", now_ns
        )
        return False

    def lost(self, reason: str, now_ns: int) -> int:
        """Note that the link was lost or not opened; return the time of the next attempt."""
        self._losses += 1
        self._enter(LinkPhase.BACKING_OFF, reason, now_ns)
        return now_ns + round(self._back_off.failed())

    def closed(self, now_ns: int) -> None:
        """Note that the link was closed."""
        self._enter(LinkPhase.CLOSED, "closed", now_ns)

    def _enter(self, phase: LinkPhase, reason: str, now_ns: int) -> None:
        self._phase, self._since_ns, self._reason = phase, now_ns, reason


KIB = 1024
RATE = 256 * KIB
"""Limit in bytes per second, well above any vehicle's odometry."""
BURST = 128 * KIB
RESUME = 64 * KIB
"""Allowance at which a limited link is read again; large enough for whole frames."""
GARBAGE_RATE = KIB
"""Limit for a link with garbage, so that its recording does not displace others."""
GARBAGE_BURST = 4 * KIB
GARBAGE = 64 * KIB
"""Bytes over which the share of valid ones is judged; `GARBAGE_BURST` to recover."""
MIN_VALID = 0.1
"""Share of bytes in valid frames below which a link is garbage. Short checksums pass by chance: one
in 256 of NMEA."""
MIN_PIECE = 32
"""Minimum size that a piece counts as, for its processing time."""
LIMITED_NS = 10 * SECOND_NS
"""Time without drops after which a link counts as within its limit."""


class InputLimit:
    """Limits the bytes of one link in runs that hold whole frames; reads no clock.

    Attributes:
        bytes_dropped: bytes beyond the limit.
        reason: why bytes are being dropped; empty if none are.
    """

    def __init__(self) -> None:
        self.bytes_dropped = 0
        self.reason = ""
        self._room: float = BURST
        self._is_open = True
        self._is_garbage = False
        self._judged = (0, 0)
        self._since_ns: int | None = None
        self._dropped_ns = 0

    def passed(self, data: bytes, now_ns: int, decoded: tuple[int, int] = (0, 0)) -> bytes:
        """Return the part of a piece within the limit; drop the rest.

        Args:
            data: the received piece.
            now_ns: clock of the arrivals.
            decoded: bytes counted by the link's decoder, and those of them outside of valid frames.
        """
        is_garbage = self._is_garbage = self._judge(*decoded)
        rate, burst = (GARBAGE_RATE, GARBAGE_BURST) if is_garbage else (RATE, BURST)
        since_ns = now_ns if self._since_ns is None else self._since_ns
        self._since_ns = now_ns
        self._room = min(self._room + rate * (now_ns - since_ns) / SECOND_NS, burst)
        self._is_open = self._room >= (0 if self._is_open else min(RESUME, burst))
        kept = (data[:GARBAGE_BURST] if is_garbage else data) if self._is_open else b""
        if self._is_open:
            self._room -= max(len(kept), MIN_PIECE)
        self._count(len(data) - len(kept), now_ns, is_garbage=is_garbage)
        return kept

    def _judge(self, total_bytes: int, skipped_bytes: int) -> bool:
        """Return whether too few of the newest bytes were in valid frames."""
        total, skipped = total_bytes - self._judged[0], skipped_bytes - self._judged[1]
        if total < (GARBAGE_BURST if self._is_garbage else GARBAGE):
            return self._is_garbage
        self._judged = total_bytes, skipped_bytes
        return total - skipped < MIN_VALID * total

    def _count(self, dropped: int, now_ns: int, *, is_garbage: bool) -> None:
        if dropped:
            self.bytes_dropped += dropped
            self._dropped_ns = now_ns
            self.reason = "hardly any valid frame" if is_garbage else f"over {RATE // KIB} KiB/s"
        elif now_ns - self._dropped_ns > LIMITED_NS:
            self.reason = ""


POLL_INTERVAL_S = 1.0
"""Interval of checks while nothing is due, because the link may have been opened meanwhile."""

T = TypeVar("T")


class TakeBytes(Protocol):
    """Receives bytes, their arrival time, and whether bytes before them are missing."""

    def __call__(self, data: bytes, arrival_ns: int, /, *, gap: bool) -> None:
        """Process the bytes."""


class OdometryLink:
    """Keeps a link open until cancelled.

    Args:
        name: name of the source.
        address: address of the link.
        take: receives the data.
        clock: the host's clock, nanoseconds.
        on_status: called with each new status.
        decoded: returns the bytes decoded so far, and those of them outside of valid frames.

    Attributes:
        name, address: as given.
        limit: limit of its data rate.
    """

    def __init__(
        self,
        name: str,
        address: LinkAddress,
        take: TakeBytes,
        clock: Callable[[], int],
        on_status: Callable[[str, OdometryLinkStatus], None] | None = None,
        *,
        decoded: Callable[[], tuple[int, int]] = lambda: (0, 0),
    ) -> None:
        self.name = name
        self.address = address
        self.limit = InputLimit()
        self._decoded = decoded
        self._take = take
        self._clock = clock
        self._on_status = on_status
        self._state = OdometryLinkState(str(address), connects=address.kind == "tcp")
        self._broken = False

    @property
    def status(self) -> OdometryLinkStatus:
        """The current status."""
        return self._state.status

    async def run(self) -> NoReturn:
        """Open and read the link, and reopen it when it is lost.

        Raises:
            ConfigError: a required library is not installed.
        """
        try:
            while True:
                await self._once()
        finally:
            self._change(self._state.closed)

    async def _once(self) -> None:
        self._change(self._state.opening)
        reading = asyncio.ensure_future(listen_to(self.address, self._opened, self._received))
        try:
            reason = await self._watch(reading)
        except OSError as error:
            reason = f"{self.address}: {error.strerror or error}"
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
        self._broken = True
        retry_ns = self._change(lambda now_ns: self._state.lost(reason, now_ns))
        await asyncio.sleep((retry_ns - self._clock()) / SECOND_NS)

    async def _watch(self, reading: "asyncio.Future[NoReturn]") -> str:
        """Wait until the link is lost, which raises, or silent for too long."""
        while not self._change(self._state.tick):
            due_ns = self._state.overdue_ns
            wait_s = (
                POLL_INTERVAL_S if due_ns is None else max(due_ns - self._clock(), 0) / SECOND_NS
            )
            await asyncio.wait({reading}, timeout=wait_s)
            if reading.done():
                await reading
        return self._state.status.reason

    def _opened(self) -> None:
        self._change(self._state.opened)

    def _received(self, data: bytes) -> bool:
        now_ns = self._clock()
        self._change(lambda now_ns: self._state.received(len(data), now_ns))
        kept = self.limit.passed(data, now_ns, self._decoded())
        if kept or not data:
            # Partial data from before a loss or a drop is never completed.
            self._take(kept, now_ns, gap=self._broken)
            self._broken = False
        is_whole = len(kept) == len(data)
        self._broken |= not is_whole
        return is_whole

    def _change(self, change: "Callable[[int], T]") -> "T":
        """Change the state and report it if it differs."""
        before = self._state.status.phase
        result = change(self._clock())
        status = self._state.status
        if status.phase != before and self._on_status is not None:
            self._on_status(self.name, status)
        return result
