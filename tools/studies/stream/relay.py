"""A bad link inside one process: a TCP relay that is slow, stalls, and cuts.

    python -m studies.stream.relay HOST:PORT

prints the port where the relay listens, and carries until killed.

For machines where no hosts can be made, and for connections that must fail at will. A packet that
is lost comes again a round trip later, and what follows it waits, as over TCP.
"""

import asyncio
import contextlib
import random
import sys
from typing import Self

from studies.stream.link import LinkShape

__all__ = ["Relay"]

PACKET = 1448


class Relay:
    """Listens on loopback and carries each connection to an address; `async with`.

    Args:
        host, port: where to.
        shape: of both ways; None is as fast as it goes.
        dice: seeds the losses.

    Attributes:
        port: where it listens.
    """

    def __init__(self, host: str, port: int, shape: LinkShape | None = None, dice: int = 0) -> None:
        self.port = 0
        self._to = (host, port)
        self._shape = shape
        self._random = random.Random(dice)  # noqa: S311 no secret
        self._open = asyncio.Event()
        self._open.set()
        self._writers: set[asyncio.StreamWriter] = set()

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0, limit=PACKET)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.cut()
        self._open.set()

    def cut(self) -> None:
        """Break all connections, in the middle of any message."""
        for writer in self._writers:
            writer.transport.abort()

    def stall(self) -> None:
        """Carry nothing, until `resume`."""
        self._open.clear()

    def resume(self) -> None:
        """Carry again."""
        self._open.set()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection(*self._to, limit=PACKET)
        except OSError:
            writer.transport.abort()
            return
        ends = {writer, far_writer}
        self._writers |= ends
        try:
            ways = [self._carry(reader, far_writer), self._carry(far_reader, writer)]
            await asyncio.gather(*ways, return_exceptions=True)
        finally:
            self._writers -= ends
            for end in ends:
                end.transport.abort()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(self._room())
        sending = asyncio.create_task(self._deliver(under_way, writer))
        try:
            await self._take(reader, under_way)
            await sending
        except (OSError, asyncio.IncompleteReadError):
            pass
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)
            writer.transport.abort()

    def _room(self) -> int:
        return 64 if self._shape is None else max(self._shape.queue_bytes // PACKET, 1)

    async def _take(
        self, reader: asyncio.StreamReader, under_way: asyncio.Queue[tuple[float, bytes]]
    ) -> None:
        clock = asyncio.get_running_loop().time
        free_s = last_s = 0.0
        while data := await reader.read(PACKET):
            await self._open.wait()
            arrives_s = clock()
            if self._shape is not None:
                free_s = max(free_s, arrives_s) + len(data) * 8 / self._shape.bits_per_s
                arrives_s = free_s + self._shape.delay_s
                while self._random.random() < self._shape.loss:
                    arrives_s += 2 * self._shape.delay_s
                # What follows a lost packet waits for it, and the line is busy until this one left.
                arrives_s = last_s = max(arrives_s, last_s)
                await asyncio.sleep(max(free_s - clock(), 0.0))
            await under_way.put((arrives_s, data))
        await under_way.put((0.0, b""))

    async def _deliver(
        self, under_way: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter
    ) -> None:
        clock = asyncio.get_running_loop().time
        while (piece := await under_way.get())[1]:
            await asyncio.sleep(max(piece[0] - clock(), 0.0))
            await self._open.wait()
            writer.write(piece[1])
            await writer.drain()
        with contextlib.suppress(OSError):
            writer.write_eof()


async def _run(address: str) -> None:
    host, _, port = address.rpartition(":")
    async with Relay(host, int(port), LinkShape()) as relay:
        print(relay.port, flush=True)
        await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(_run(sys.argv[1]))
