"""A log beside an event loop: the loop never waits for the disk."""

from __future__ import annotations

import time
from collections import deque
from threading import Condition, Thread
from typing import TYPE_CHECKING, Final, NamedTuple, Self

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from oculus_driver.recording.logger import SonarLog

MAX_WAITING_BYTES: Final = 64 << 20
_TICK_S: Final = 1.0
_LEAST_SIZE: Final = 256
"""What an entry counts at least: its own memory."""


class _Entry(NamedTuple):
    data: bytes
    arrival_ns: int
    gap_before: bool
    link: str | None  # None is the sonar's stream


class BackgroundLog:
    """Hands bytes to a `SonarLog` in a thread of its own. Leaving the block writes what waits.

    Where the disk is slower than the sonar for long, the newest bytes are dropped and counted,
    and the log notes the gap.

    Args:
        log: is used by the thread alone until the block is left, then closed.
        max_waiting_bytes: that may wait for the disk.
        clock: the host's, in the nanoseconds of `arrival_ns`.

    Attributes:
        bytes_dropped: because too many waited.
    """

    def __init__(
        self,
        log: SonarLog,
        *,
        max_waiting_bytes: int = MAX_WAITING_BYTES,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.bytes_dropped = 0
        self._log = log
        self._limit = max_waiting_bytes
        self._clock = clock
        self._changed = Condition()
        self._entries: deque[_Entry] = deque()
        self._waiting = 0
        self._gap = False
        self._closing = False
        self._error: BaseException | None = None
        self._thread = Thread(target=self._run, name="sonar log", daemon=True)

    async def __aenter__(self) -> Self:
        self._thread.start()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        import asyncio  # noqa: PLC0415 - there already where this runs, and slow to import

        with self._changed:
            self._closing = True
            self._changed.notify()
        await asyncio.to_thread(self._thread.join)
        if self._error is not None:
            raise self._error

    @property
    def waiting_bytes(self) -> int:
        """Bytes that wait for the disk."""
        return self._waiting

    def write(
        self,
        data: bytes | bytearray | memoryview,
        arrival_ns: int,
        *,
        gap_before: bool = False,
    ) -> bool:
        """Take the next bytes of the sonar's stream at once; False if there is no room for them.

        Args:
            data: as they came; copied unless they cannot change.
            arrival_ns: when they came.
            gap_before: bytes before these were lost, or this is a new connection.
        """
        gap = gap_before or self._gap
        taken = self._offer(_Entry(bytes(data), arrival_ns, gap, None))
        self._gap = not taken
        return taken

    def write_status(self, datagram: bytes, arrival_ns: int) -> bool:
        """Take a status datagram at once; False if there is no room for it."""
        return self._offer(_Entry(datagram, arrival_ns, gap_before=False, link="status"))

    def write_other(
        self, link: str, data: bytes, arrival_ns: int, *, gap_before: bool = False
    ) -> bool:
        """Take bytes of a link beside the sonar at once; False if there is no room for them."""
        return self._offer(_Entry(data, arrival_ns, gap_before, link))

    def _offer(self, entry: _Entry) -> bool:
        size = max(len(entry.data), _LEAST_SIZE)
        with self._changed:
            if self._waiting + size > self._limit or self._error is not None:
                self.bytes_dropped += len(entry.data)
                return False
            self._entries.append(entry)
            self._waiting += size
            self._changed.notify()
        return True

    def _run(self) -> None:
        try:
            while (entry := self._next()) is not None:
                self._record(entry)
            self._log.close()
        except BaseException as error:  # noqa: BLE001 - raised where the block is left
            self._error = error

    def _next(self) -> _Entry | None:
        """Wait for an entry; None once nothing is left and the block was left."""
        while True:
            with self._changed:
                if not self._entries and not self._closing:
                    self._changed.wait(_TICK_S)
                if self._entries:
                    entry = self._entries.popleft()
                    self._waiting -= max(len(entry.data), _LEAST_SIZE)
                    return entry
                if self._closing:
                    return None
            self._log.tick(self._clock())

    def _record(self, entry: _Entry) -> None:
        if entry.link is None:
            self._log.write(entry.data, entry.arrival_ns, gap_before=entry.gap_before)
        else:
            self._log.write_other(
                entry.link, entry.data, entry.arrival_ns, gap_before=entry.gap_before
            )
