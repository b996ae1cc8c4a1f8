"""Queue of pings between the link and its readers. It keeps the newest pings."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Final

from oculus_driver.ping import PingHeader

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from oculus_driver.ping import Ping

MAX_PINGS: Final = 64
MAX_BYTES: Final = 64 << 20


class PingQueue:
    """Holds pings until a reader takes them. When full, it drops the oldest.

    Several readers share the queue: each ping goes to one of them. Iteration ends when the queue is
    closed and empty.

    Args:
        max_pings: maximum number of pings, ≥ 1.
        max_bytes: maximum size of the pings; the newest ping is always kept.

    Attributes:
        taken: pings delivered to a reader.
        dropped: pings dropped because the queue was full.
    """

    def __init__(self, max_pings: int = MAX_PINGS, max_bytes: int = MAX_BYTES) -> None:
        if max_pings < 1:
            raise ValueError(f"max_pings is {max_pings}: it must be at least 1")
        self.taken = 0
        self.dropped = 0
        self._max_pings = max_pings
        self._max_bytes = max_bytes
        self._pings: deque[Ping | PingHeader] = deque()
        self._bytes = 0
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._closed = False
        self._error: BaseException | None = None

    def __len__(self) -> int:
        return len(self._pings)

    def __aiter__(self) -> AsyncIterator[Ping]:
        return self

    async def __anext__(self) -> Ping:
        while not self._pings:
            if self._error is not None:
                raise self._error
            if self._closed:
                raise StopAsyncIteration
            await self._wait()
        self.taken += 1
        ping = self._pop()
        return ping.decode() if isinstance(ping, PingHeader) else ping

    def put(self, ping: Ping | PingHeader) -> None:
        """Add a ping without waiting. After `close` it counts as dropped.

        A header is decoded when a reader takes it.
        """
        if self._closed:
            self.dropped += 1
            return
        self._pings.append(ping)
        self._bytes += _size(ping)
        while len(self._pings) > 1 and self._full():
            self._pop()
            self.dropped += 1
        self._wake(1)

    def close(self, error: BaseException | None = None) -> None:
        """Let readers take the remaining pings, then end, with the error if there is one."""
        self._closed = True
        self._error = self._error or error
        self._wake(len(self._waiting))

    def _full(self) -> bool:
        return len(self._pings) > self._max_pings or self._bytes > self._max_bytes

    def _pop(self) -> Ping | PingHeader:
        ping = self._pings.popleft()
        self._bytes -= _size(ping)
        return ping

    async def _wait(self) -> None:
        future = asyncio.get_running_loop().create_future()
        self._waiting.append(future)
        try:
            await future
        except asyncio.CancelledError:
            if future.done() and not future.cancelled() and self._pings:
                self._wake(1)  # the next reader gets the ping of the cancelled one
            raise
        finally:
            if future in self._waiting:
                self._waiting.remove(future)

    def _wake(self, count: int) -> None:
        while self._waiting and count > 0:
            future = self._waiting.popleft()
            if not future.done():
                future.set_result(None)
                count -= 1


def _size(ping: Ping | PingHeader) -> int:
    return len(ping.message.data) if isinstance(ping, PingHeader) else ping.image.nbytes
