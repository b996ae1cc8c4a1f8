"""Follow a vehicle that others drive: links that bring its pose into a live path."""

import asyncio
import contextlib
from collections.abc import Callable
from functools import partial
from typing import cast
from urllib.parse import urlsplit

from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.live_path import LivePath
from sonar_sim.navigation.pose_records import (
    MavlinkRecords,
    NativeRecords,
    PoseAssembler,
    PoseDecoder,
)
from sonar_sim.scene.vehicle import Vehicle

FOLLOW_LINKS = ("udp", "mavlink", "mavlink+tcp")
SILENT_S = 3.0
RETRY_S = 1.0
MAX_READ = 1 << 16
PERIOD_US = 20_000
"""Of the messages that an autopilot is asked for."""
ASK_S = 10.0
MIN_RATE_HZ = 15.0
"""An autopilot that sends its pose less often is asked for more."""


class PoseFollower:
    """Receives poses in one event loop, until it is closed.

    Args:
        url: `udp://HOST:PORT` listens for native records, `mavlink://HOST:PORT` for MAVLink
            datagrams, `mavlink+tcp://HOST:PORT` connects to an autopilot.
        path: what the poses are added to.
        vehicle: whose map origin geographic positions count from.
        clock: seconds on the path.

    Raises:
        SonarSimError: the URL is none of these; raised at once.

    Attributes:
        url: of it, with the port that it listens on.
        records: that held a part of a pose; late: those of them that came after newer ones and
            were ignored; malformed: datagrams and bytes that held none.
    """

    def __init__(
        self, url: str, path: LivePath, vehicle: Vehicle, clock: Callable[[], float]
    ) -> None:
        kind, self._host, self._port = _parts(url)
        self.url = url
        self.records = 0
        self.late = 0
        self.malformed = 0
        self._kind = kind
        self._decoder: PoseDecoder = NativeRecords() if kind == "udp" else MavlinkRecords(vehicle)
        self._assembler = PoseAssembler(path)
        self._clock = clock
        self._heard_s: float | None = None
        self._asked_s = -ASK_S
        self._asked_at = 0
        self._transport: asyncio.DatagramTransport | None = None
        self._reading: asyncio.Task[None] | None = None

    @property
    def state(self) -> str:
        """`waiting` before the first whole pose, `following`, or `silent` after the last record."""
        if self._heard_s is None or not self._assembler.is_placed:
            return "waiting"
        return "following" if self._clock() - self._heard_s < SILENT_S else "silent"

    async def open(self) -> None:
        """Listen, or begin to connect.

        Raises:
            SonarSimError: the address cannot be listened on.
        """
        if self._kind == "mavlink+tcp":
            self._reading = asyncio.create_task(self._read())
            return
        try:
            self._transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: _FollowedDatagrams(self), local_addr=(self._host, self._port)
            )
        except OSError as error:
            reason = error.strerror or str(error)
            raise SonarSimError(
                f"--follow {self.url}: cannot listen on {self._host}:{self._port}: {reason}; use "
                "another port"
            ) from error
        port = self._transport.get_extra_info("sockname")[1]
        self.url = f"{self._kind}://{self._host}:{port}"

    async def close(self) -> None:
        """Stop."""
        if self._transport is not None:
            self._transport.close()
        if self._reading is not None:
            self._reading.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._reading

    def take(self, data: bytes, reply: Callable[[bytes], object]) -> None:
        """Take bytes as they arrived.

        Args:
            data: a datagram, or a piece of a stream.
            reply: sends bytes to their sender.
        """
        now_s = self._clock()
        for record in self._decoder.decode(data, now_s):
            if record is None:
                self.malformed += 1
                continue
            self.records += 1
            self._heard_s = now_s
            self.late += not self._assembler.take(record, now_s)
        self._ask_for_more(now_s, reply)

    def _ask_for_more(self, now_s: float, reply: Callable[[bytes], object]) -> None:
        """Ask an autopilot for its pose, where it sends little by itself."""
        decoder, passed_s = self._decoder, now_s - self._asked_s
        if not isinstance(decoder, MavlinkRecords) or decoder.autopilot is None or passed_s < ASK_S:
            return
        if self.records - self._asked_at < MIN_RATE_HZ * passed_s:
            reply(decoder.interval_requests(PERIOD_US))
        self._asked_s, self._asked_at = now_s, self.records

    async def _read(self) -> None:
        """Read from an autopilot, and connect again whenever it goes."""
        while True:
            with contextlib.suppress(OSError, UnicodeError):  # TimeoutError is an OSError
                reader, writer = await asyncio.open_connection(self._host, self._port)
                self._asked_s = -ASK_S
                try:
                    while data := await asyncio.wait_for(reader.read(MAX_READ), ASK_S):
                        self.take(data, writer.write)
                finally:
                    writer.close()
            await asyncio.sleep(RETRY_S)


class _FollowedDatagrams(asyncio.DatagramProtocol):
    """Hands datagrams on."""

    def __init__(self, follower: PoseFollower) -> None:
        self._follower = follower
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        assert self._transport is not None  # noqa: S101 it is connected
        self._follower.take(data, partial(self._transport.sendto, addr=addr))


def _parts(url: str) -> tuple[str, str, int]:
    """Scheme, host and port.

    Raises:
        SonarSimError: it has other parts, or lacks one.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme not in FOLLOW_LINKS or not parts.hostname or port is None or parts.path:
        links = ", ".join(f"{one}://HOST:PORT" for one in FOLLOW_LINKS)
        raise SonarSimError(f"--follow: {url!r} is not a link; use {links}")
    return parts.scheme, parts.hostname, port
