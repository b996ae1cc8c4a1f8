"""Links to the vehicle: opened, read within limits, and opened again when they are lost.

What a link does, as a state machine with names that a person can read; no I/O, no clock.

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
"""Gets what arrived; returns whether more may come at once."""

OnOpen = Callable[[], None]

MAX_READ_BYTES = 1 << 16
CONNECT_S = 5.0
PAUSE_S = 0.05
"""A port that receives more than its limit is read after such pauses; the system drops the rest."""


async def listen_to(address: LinkAddress, on_open: OnOpen, on_bytes: OnBytes) -> NoReturn:
    """Open a link and hand on what it brings.

    Args:
        address: which link.
        on_open: called once it is open.
        on_bytes: called with each datagram, or each piece of the stream.

    Raises:
        OSError: it cannot be opened, or was lost; the text states the reason.
        ConfigError: a library that it needs is not installed.
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
                pauses.append(loop.call_later(PAUSE_S, go_on))

        def go_on() -> None:
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
        async with asyncio.timeout(CONNECT_S):
            reader, writer = await asyncio.open_connection(address.host, address.port)
    except TimeoutError:
        raise TimeoutError(f"no answer within {CONNECT_S:g} s") from None
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
            if not data:  # readable and empty is what an unplugged line looks like
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
"""A connection that is silent for this time may be dead."""
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
        phase: what it does.
        since_ns: when that began, host clock.
        reason: why, for a person.
        bytes_received: since the start.
        opened: times that it was opened.
        losses: times that it was lost or could not be opened.
    """

    phase: LinkPhase
    since_ns: int
    reason: str
    bytes_received: int
    opened: int
    losses: int

    def time_in_phase_s(self, now_ns: int) -> float:
        """How long it has been so."""
        return (now_ns - self.since_ns) / SECOND_NS


class OdometryLinkState:
    """Follows one link. Every method takes the host's time in nanoseconds.

    Args:
        where: the link, for the reasons.
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
        """The link as it is now."""
        return OdometryLinkStatus(
            self._phase, self._since_ns, self._reason, self._bytes, self._opened, self._losses
        )

    @property
    def overdue_ns(self) -> int | None:
        """Next time for `tick`; None if only an event can change the state."""
        if self._phase in (LinkPhase.WAITING, LinkPhase.RECEIVING):
            return self._heard_ns + SILENT_NS
        if self._phase is LinkPhase.SILENT and self._connects:
            return self._heard_ns + RECONNECT_NS
        return None

    def opening(self, now_ns: int) -> None:
        """It is being opened."""
        self._enter(LinkPhase.OPENING, f"opening {self._where}", now_ns)

    def opened(self, now_ns: int) -> None:
        """It is open; nothing has come yet."""
        self._opened += 1
        self._heard_ns = now_ns
        self._enter(LinkPhase.WAITING, f"{self._where} is open, nothing received yet", now_ns)

    def received(self, size: int, now_ns: int) -> None:
        """Bytes came."""
        self._bytes += size
        self._heard_ns = now_ns
        self._back_off.succeeded()
        if self._phase is not LinkPhase.RECEIVING:
            self._enter(LinkPhase.RECEIVING, f"bytes come from {self._where}", now_ns)

    def tick(self, now_ns: int) -> bool:
        """Look at the time; True where the connection is to be given up."""
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
        """It was lost, or could not be opened; returns when to try again."""
        self._losses += 1
        self._enter(LinkPhase.BACKING_OFF, reason, now_ns)
        return now_ns + round(self._back_off.failed())

    def closed(self, now_ns: int) -> None:
        """It was closed on purpose."""
        self._enter(LinkPhase.CLOSED, "closed", now_ns)

    def _enter(self, phase: LinkPhase, reason: str, now_ns: int) -> None:
        self._phase, self._since_ns, self._reason = phase, now_ns, reason


KIB = 1024
RATE = 256 * KIB
"""Bytes per second that a link may bring; no vehicle sends as much odometry."""
BURST = 128 * KIB
RESUME = 64 * KIB
"""Room in which a link that was over its limit is read again: a run holds whole frames."""
GARBAGE_RATE = KIB
"""The same for a link that brings nothing but garbage: its recording must not displace others."""
GARBAGE_BURST = 4 * KIB
GARBAGE = 64 * KIB
"""Bytes without a valid frame after which a link brings garbage."""
MIN_PIECE = 32
"""Minimum accounted size of a piece: the work that it makes."""
LIMITED_NS = 10 * SECOND_NS
"""A link is within its limit again when nothing was dropped for this time."""


class InputLimit:
    """Limits the bytes of one link, in runs long enough to hold whole frames; reads no clock.

    Attributes:
        bytes_dropped: bytes beyond the limit.
        reason: why bytes are dropped lately; empty while none are.
    """

    def __init__(self) -> None:
        self.bytes_dropped = 0
        self.reason = ""
        self._room: float = BURST
        self._is_open = True
        self._frames = self._valid_bytes = 0
        self._since_ns: int | None = None
        self._dropped_ns = 0

    def passed(self, data: bytes, now_ns: int, decoded: tuple[int, int] = (0, 0)) -> bytes:
        """Return the part of a piece that is within the limit; the rest is dropped.

        Args:
            data: the received piece.
            now_ns: clock of the arrivals.
            decoded: bytes and valid frames that the link's decoder has counted so far.
        """
        is_garbage = self._is_garbage(*decoded)
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

    def _is_garbage(self, total_bytes: int, frames: int) -> bool:
        if frames != self._frames:
            self._frames, self._valid_bytes = frames, total_bytes
        return total_bytes - self._valid_bytes > GARBAGE

    def _count(self, dropped: int, now_ns: int, *, is_garbage: bool) -> None:
        if dropped:
            self.bytes_dropped += dropped
            self._dropped_ns = now_ns
            self.reason = "no valid frame" if is_garbage else f"over {RATE // KIB} KiB/s"
        elif now_ns - self._dropped_ns > LIMITED_NS:
            self.reason = ""


LOOK_S = 1.0
"""So often the state is looked at where nothing is due: it may have been opened meanwhile."""

T = TypeVar("T")


class TakeBytes(Protocol):
    """Gets bytes, their arrival, and whether bytes before them are missing."""

    def __call__(self, data: bytes, arrival_ns: int, /, *, gap: bool) -> None:
        """Take them."""


class OdometryLink:
    """Keeps a link open until it is cancelled.

    Args:
        name: of the source.
        address: where it is.
        take: gets what comes.
        clock: the host's, nanoseconds.
        on_status: called with each new state.
        decoded: returns how many bytes and valid frames of the link were decoded so far.

    Attributes:
        name, address: as given.
        limit: of what it may bring.
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
        """What it does now."""
        return self._state.status

    async def run(self) -> NoReturn:
        """Open, read, open again.

        Raises:
            ConfigError: a library that it needs is not installed: trying again would not help.
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
        """Wait until the link is lost, which is raised, or too silent to be alive."""
        while not self._change(self._state.tick):
            due_ns = self._state.overdue_ns
            wait_s = LOOK_S if due_ns is None else max(due_ns - self._clock(), 0) / SECOND_NS
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
            # What was under way when the link broke, or bytes were dropped, will not be completed.
            self._take(kept, now_ns, gap=self._broken)
            self._broken = False
        is_whole = len(kept) == len(data)
        self._broken |= not is_whole
        return is_whole

    def _change(self, change: "Callable[[int], T]") -> "T":
        """Change the state, and report a new one."""
        before = self._state.status.phase
        result = change(self._clock())
        status = self._state.status
        if status.phase != before and self._on_status is not None:
            self._on_status(self.name, status)
        return result
