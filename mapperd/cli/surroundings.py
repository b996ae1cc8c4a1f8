"""What a computer hears of sonars and vehicles, and what `mapperd` answers without settings.

Nothing is sent: no sonar pings because of it.
"""

import asyncio
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from oculus_driver.discovery.diagnosis import silence_finding
from oculus_driver.discovery.listener import Discovery
from oculus_driver.discovery.state import DiscoveredSonar
from oculus_driver.errors import DiscoveryError
from oculus_driver.wire import STATUS_PORT

__all__ = [
    "ODOMETRY_PORTS",
    "DevicesHeard",
    "HeardOdometry",
    "listen",
    "odometry_lines",
    "sonar_lines",
]

LISTEN_S = 3.0
ODOMETRY_PORTS = (52200, 52210, 14550, 14551)
"""UDP ports on which vehicles send: those of `mapperd init`, and MAVLink's own."""

MAVLINK_MAGIC = (0xFD, 0xFE)
MAX_DATAGRAM = 65536


@dataclass(slots=True)
class HeardOdometry:
    """What arrived on one UDP port.

    Attributes:
        port: number of the port.
        datagrams: how many arrived.
        sender: address of the newest one.
        kind: `MAVLink`, `NMEA` or `data`.
        problem: why the port cannot be listened on, or "".
    """

    port: int
    datagrams: int = 0
    sender: str = ""
    kind: str = "data"
    problem: str = ""


@dataclass(frozen=True, slots=True)
class DevicesHeard:
    """What was heard.

    Attributes:
        sonars: whose status arrived.
        odometry: by UDP port.
        problem: why no sonar was heard, if none was.
    """

    sonars: Sequence[DiscoveredSonar]
    odometry: Sequence[HeardOdometry]
    problem: str


async def listen(
    seconds: float = LISTEN_S,
    status_port: int = STATUS_PORT,
    odometry_ports: Sequence[int] = ODOMETRY_PORTS,
) -> DevicesHeard:
    """Listen for status broadcasts of sonars and for datagrams of vehicles."""
    heard = [HeardOdometry(port) for port in odometry_ports]
    loop = asyncio.get_running_loop()
    sockets = []
    for one in heard:
        if (opened := _opened(one)) is not None:
            sockets.append(opened)
            loop.add_reader(opened, _reader(one, opened))
    try:
        async with Discovery(status_port) as discovery:
            await asyncio.sleep(seconds)
            silence = silence_finding(discovery.port).text
            return DevicesHeard(discovery.present(), heard, silence)
    except DiscoveryError as error:
        await asyncio.sleep(seconds)
        return DevicesHeard([], heard, str(error))
    finally:
        for opened in sockets:
            loop.remove_reader(opened)
            opened.close()


def _opened(one: HeardOdometry) -> socket.socket | None:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setblocking(False)  # noqa: FBT003 its only argument
    try:
        opened.bind(("", one.port))
    except OSError as error:
        opened.close()
        one.problem = (error.strerror or str(error)).lower()
        return None
    return opened


def _reader(one: HeardOdometry, opened: socket.socket) -> Callable[[], None]:
    def read() -> None:
        try:
            data, sender = opened.recvfrom(MAX_DATAGRAM)
        except OSError:
            return
        one.datagrams += 1
        one.sender = sender[0]
        if data[:1] and data[0] in MAVLINK_MAGIC:
            one.kind = "MAVLink"
        elif data[:1] in (b"$", b"!"):
            one.kind = "NMEA"

    return read


def sonar_lines(heard: DevicesHeard) -> Iterator[str]:
    """Describe each sonar, or why there is none."""
    for sonar in heard.sonars:
        status = sonar.status
        used = f", in use by {status.client_address or 'a client'}" if status.busy else ""
        name = f"Oculus {sonar.model.name}, serial {status.device_id}"
        yield f"sonar: {name}, at {sonar.address}{used}"
    if not heard.sonars:
        yield f"no sonar: {heard.problem}"


def odometry_lines(heard: DevicesHeard) -> Iterator[str]:
    """Describe what arrives on each port, or that nothing does."""
    for one in heard.odometry:
        if one.datagrams:
            yield f"odometry: {one.kind} from {one.sender} on UDP port {one.port}"
        elif one.problem:
            yield f"odometry: UDP port {one.port} cannot be opened: {one.problem}"
    if not any(one.datagrams or one.problem for one in heard.odometry):
        ports = ", ".join(str(one.port) for one in heard.odometry)
        yield f"no odometry on the UDP ports {ports}"
