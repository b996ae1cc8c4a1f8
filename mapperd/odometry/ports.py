"""Opening and reading a link: each coroutine runs until the link is lost, which it raises."""

import asyncio
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn

from mapperd.config.link_address import LinkAddress, serial_path
from mapperd.errors import ConfigError

if TYPE_CHECKING:
    from serial import Serial

__all__ = ["OnBytes", "listen_to"]

OnBytes = Callable[[bytes], None]
OnOpen = Callable[[], None]

LARGEST_READ = 1 << 16
CONNECT_S = 5.0


async def listen_to(address: LinkAddress, on_open: OnOpen, on_bytes: OnBytes) -> NoReturn:
    """Open a link and hand on what it brings.

    Args:
        address: which link.
        on_open: called once it is open.
        on_bytes: called with each datagram, or each piece of the stream.

    Raises:
        OSError: it cannot be opened, or was lost; its text says why.
        ConfigError: a library that it needs is not installed.
    """
    if address.kind == "udp":
        await _listen_udp(address, on_open, on_bytes)
    if address.kind == "tcp":
        await _read_tcp(address, on_open, on_bytes)
    await _read_serial(address, on_open, on_bytes)


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, on_bytes: OnBytes, lost: "asyncio.Future[None]") -> None:
        self._on_bytes = on_bytes
        self._lost = lost

    def datagram_received(self, data: bytes, _: object) -> None:
        self._on_bytes(data)

    def connection_lost(self, error: Exception | None) -> None:
        if not self._lost.done():
            self._lost.set_exception(error or ConnectionAbortedError("the port was closed"))


async def _listen_udp(address: LinkAddress, on_open: OnOpen, on_bytes: OnBytes) -> NoReturn:
    loop = asyncio.get_running_loop()
    lost: asyncio.Future[None] = loop.create_future()
    transport: asyncio.DatagramTransport | None = None
    try:
        transport, _ = await loop.create_datagram_endpoint(
            lambda: _Datagrams(on_bytes, lost), local_addr=(address.host, address.port)
        )
        on_open()
        await lost
    finally:
        lost.cancel()  # also where it was cancelled while it was being opened
        if transport is not None:
            transport.close()
    raise ConnectionAbortedError("the port was closed")


async def _read_tcp(address: LinkAddress, on_open: OnOpen, on_bytes: OnBytes) -> NoReturn:
    try:
        async with asyncio.timeout(CONNECT_S):
            reader, writer = await asyncio.open_connection(address.host, address.port)
    except TimeoutError:
        raise TimeoutError(f"no answer within {CONNECT_S:g} s") from None
    try:
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        on_open()
        while data := await reader.read(LARGEST_READ):
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
            data = port.read(LARGEST_READ)
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
        raise ConfigError(
            "serial links need pyserial, which is not installed; "
            "allowed: pip install 'mapperd[serial]'"
        ) from error
    path = serial_path(address.device)
    return serial.Serial(str(path), address.baud, timeout=0, exclusive=True)
