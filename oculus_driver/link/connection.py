"""The TCP connection to a sonar: socket options, whole writes, and reasons in words."""

from __future__ import annotations

import asyncio
import errno
import socket
from typing import TYPE_CHECKING, Final, cast

from oculus_driver.wire import MIB

if TYPE_CHECKING:
    from collections.abc import Callable

RECEIVE_BUFFER: Final = 2 * MIB
_MOST_UNSENT_BYTES: Final = 4096

_ADVICE: Final = {
    errno.ECONNREFUSED: "refused: another client may hold the sonar, or this is no sonar",
    errno.EHOSTUNREACH: "not reachable: check power, cable and address",
    errno.ENETUNREACH: "not in a network of this host: give the host an address in its subnet",
    errno.ECONNRESET: "reset by the sonar",
    errno.EPIPE: "closed by the sonar",
    errno.ETIMEDOUT: "timed out: check power and cable",
}


def reason_of(error: BaseException | None) -> str:
    """Return why a connection ended, None being the sonar's own regular end."""
    if error is None:
        return "connection closed by the sonar"
    advice = _ADVICE.get(getattr(error, "errno", None) or 0)
    return f"connection {advice}" if advice else f"connection failed: {error}"


class Connection(asyncio.Protocol):
    """One connection. After `drop` nobody hears of it any more.

    Bytes are handed on from the event loop's read, not by a task, so that a late timer never
    runs before bytes that came in time.

    Args:
        on_made: called with the connection when it stands.
        on_data: called with the bytes of each read.
        on_lost: called with the reason when it ended without our doing.
    """

    def __init__(
        self,
        on_made: Callable[[Connection], None],
        on_data: Callable[[bytes], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self._on_made = on_made
        self._on_data = on_data
        self._on_lost = on_lost
        self._transport: asyncio.Transport | None = None
        self._dropped = False
        self._deaf = False
        self.closed = asyncio.get_running_loop().create_future()

    @property
    def stands(self) -> bool:
        """Whether it was made and has not ended."""
        return self._transport is not None and not self._dropped

    @property
    def own_address(self) -> str | None:
        """This host's address on the connection."""
        name = None if self._transport is None else self._transport.get_extra_info("sockname")
        return str(name[0]) if name else None

    def send(self, data: bytes) -> None:
        """Write one message as a whole."""
        if self._transport is None or self._transport.is_closing():
            return
        self._transport.write(data)
        if self._transport.get_write_buffer_size() > _MOST_UNSENT_BYTES:
            self._deaf = True
            self._transport.abort()

    def drop(self) -> None:
        """End it at once."""
        self._dropped = True
        if self._transport is None:
            self._close()
        else:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport, from the event loop."""
        self._transport = cast("asyncio.Transport", transport)
        if self._dropped:
            self._transport.abort()
        else:
            self._on_made(self)

    def data_received(self, data: bytes) -> None:
        """Hand bytes on, from the event loop."""
        self._on_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell the end, from the event loop."""
        self._close()
        if not self._dropped:
            self._dropped = True
            self._on_lost("the sonar takes no more commands" if self._deaf else reason_of(exc))

    def _close(self) -> None:
        if not self.closed.done():
            self.closed.set_result(None)


async def open_connection(connection: Connection, address: str, port: int) -> None:
    """Connect to a sonar's data port.

    Raises:
        OSError: it cannot be reached; `reason_of` tells why in words.
    """
    loop = asyncio.get_running_loop()
    endpoint = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        endpoint.setblocking(False)  # noqa: FBT003 - the socket module's own signature
        endpoint.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if _allows_receive_buffer(RECEIVE_BUFFER):
            endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        await loop.sock_connect(endpoint, (address, port))
        await loop.create_connection(lambda: connection, sock=endpoint)
    except BaseException:
        endpoint.close()
        raise


def _allows_receive_buffer(size: int) -> bool:
    """Return whether this host gives a socket as much as it is asked for.

    A host that does not, gives more to sockets that never ask: asking ends the automatic growth
    of the buffer.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
        return probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= size
