"""A TCP server and a UDP sender for a peer's messages on loopback."""

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager

Pieces = Callable[[], Iterable[bytes]]


@asynccontextmanager
async def tcp_server(pieces: Pieces, *, reset: bool = False, port: int = 0) -> AsyncIterator[int]:
    """Send the pieces to each client, then close; yield the port.

    Args:
        pieces: called for each client.
        reset: end with a reset instead of a close.
        port: to listen on; 0 takes a free one.
    """

    async def send(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for piece in pieces():
            writer.write(piece)
            await writer.drain()
            await asyncio.sleep(0)
        if reset:
            writer.transport.abort()
        else:
            writer.close()

    server = await asyncio.start_server(send, "127.0.0.1", port)
    async with server:
        yield server.sockets[0].getsockname()[1]


def send_udp(pieces: Iterable[bytes], port: int) -> None:
    """Send each piece as a datagram; skip empty pieces."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for piece in pieces:
            if piece:
                sender.sendto(piece, ("127.0.0.1", port))
