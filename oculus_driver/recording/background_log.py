"""Writes a log in a thread, so that the event loop never waits for the disk."""

from __future__ import annotations

import time
from collections import deque
from threading import Condition, Thread
from typing import TYPE_CHECKING, Final, NamedTuple, Self

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from oculus_driver.recording.sonar_log import LogPosition, SonarLog
    from oculus_driver.stream import MessageBounds

MAX_WAITING_BYTES: Final = 64 << 20
_TICK_S: Final = 1.0
_RETRY_S: Final = 0.2
_MIN_SIZE: Final = 256
"""Minimum accounted size of an entry: its own memory."""


class _Entry(NamedTuple):
    data: bytes
    arrival_ns: int
    gap_before: bool
    link: str
    bounds: MessageBounds | None = None  # None: not the sonar's stream
    number: int = 0


class _PieceRun(NamedTuple):
    """Consecutive pieces in one file, one message each."""

    first: int
    last: int
    position: LogPosition  # after the last piece


_MAX_RUNS: Final = 1000
"""Number of runs with known positions. A run ends with a file, at a loss, or at a split piece."""


class BackgroundLog:
    """Passes bytes to a `SonarLog` in a thread. The end of the block writes all waiting data.

    If the disk is slower than the sonar for long, the newest bytes are dropped and counted, and the
    log contains a gap. A log that holds (see `SonarLog`) may be blocked for as long as its disk is
    full; data wait meanwhile within the same bound.

    Every offered piece has a number, starting with 1, and a position once it is written.

    Args:
        log: used only by the thread until the end of the block, then closed.
        max_waiting_bytes: maximum size of the waiting data.
        clock: the host's clock, in the nanoseconds of `arrival_ns`.

    Attributes:
        bytes_dropped: because too many were waiting.
        offered: number of the newest piece.
        written: number of the last piece that is with the operating system; earlier pieces are
            written, or dropped.
        synced: number of the last piece that is on the disk, where it survives a power cut.
    """

    def __init__(
        self,
        log: SonarLog,
        *,
        max_waiting_bytes: int = MAX_WAITING_BYTES,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.bytes_dropped = 0
        self.offered = 0
        self.written = 0
        self.synced = 0
        self._sync_wanted = 0
        self._runs: deque[_PieceRun] = deque(maxlen=_MAX_RUNS)
        self._log = log
        self._limit = max_waiting_bytes
        self._clock = clock
        self._changed = Condition()
        self._entries: deque[_Entry] = deque()
        self._waiting = 0
        self._gaps: set[str] = set()  # links whose last piece was dropped
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
        import asyncio  # noqa: PLC0415 - slow to import, and always loaded when this runs

        with self._changed:
            self._closing = True
            self._changed.notify_all()
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
        bounds: MessageBounds,
        *,
        gap_before: bool = False,
    ) -> bool:
        """Queue the next bytes of the sonar's stream; return False if there is no room for them.

        Args:
            data: received bytes; copied unless immutable.
            arrival_ns: arrival time.
            bounds: message boundaries in the data, see `SonarLog.write`.
            gap_before: bytes before these were lost, or this is a new connection.
        """
        return self._offer(_Entry(bytes(data), arrival_ns, gap_before, "sonar", bounds))

    def write_status(self, datagram: bytes, arrival_ns: int) -> bool:
        """Queue a status datagram; return False if there is no room for it."""
        return self._offer(_Entry(datagram, arrival_ns, gap_before=False, link="status"))

    def write_other(
        self, link: str, data: bytes, arrival_ns: int, *, gap_before: bool = False
    ) -> bool:
        """Queue bytes of a link other than the sonar; return False if there is no room for them."""
        return self._offer(_Entry(data, arrival_ns, gap_before, link))

    def position_of(self, number: int) -> LogPosition | None:
        """Return the position after a piece; None while it is not written, or long after.

        For a dropped piece: the position after the preceding one.
        """
        with self._changed:
            if number > self.written:
                return None
            for first, last, position in reversed(self._runs):
                if first <= number:
                    later = max(0, last - number)
                    return position._replace(messages=position.messages - later)
        return None

    def wait_for(self, number: int, timeout_s: float) -> bool:
        """Have a piece flushed to the disk; return False on a timeout. Not for the event loop."""
        with self._changed:
            self._sync_wanted = max(self._sync_wanted, number)
            self._changed.notify_all()
            return self._changed.wait_for(lambda: self.synced >= number, timeout_s)

    def _offer(self, entry: _Entry) -> bool:
        size = max(len(entry.data), _MIN_SIZE)
        with self._changed:
            self.offered += 1
            gap = entry.gap_before or entry.link in self._gaps
            entry = entry._replace(number=self.offered, gap_before=gap)
            if self._waiting + size > self._limit or self._error is not None:
                self.bytes_dropped += len(entry.data)
                self._gaps.add(entry.link)
                return False
            self._gaps.discard(entry.link)
            self._entries.append(entry)
            self._waiting += size
            self._changed.notify_all()
        return True

    def _run(self) -> None:
        try:
            while (entry := self._next()) is not None:
                self._record(entry)
                self._retry_held()
                self._remember_position(entry.number)
                self._sync_if_wanted()
            self._log.close()
            if self._log.sync(self._clock()):
                self._note_synced(self.written)
        except BaseException as error:  # noqa: BLE001 - raised at the end of the block
            self._error = error

    def _next(self) -> _Entry | None:
        """Wait for an entry; return None at the end of the block when all are written."""
        while True:
            with self._changed:
                if not self._entries and not self._closing:
                    self._changed.wait(_TICK_S)
                if self._entries:
                    entry = self._entries.popleft()
                    self._waiting -= max(len(entry.data), _MIN_SIZE)
                    return entry
                if self._closing:
                    return None
            self._log.tick(self._clock())
            self._sync_if_wanted()

    def _record(self, entry: _Entry) -> None:
        if entry.bounds is not None:
            self._log.write(entry.data, entry.arrival_ns, entry.bounds, gap_before=entry.gap_before)
        else:
            self._log.write_other(
                entry.link, entry.data, entry.arrival_ns, gap_before=entry.gap_before
            )

    def _retry_held(self) -> None:
        """Retry until the log has written what it holds, or the block ends."""
        while self._log.holding and not self._log.retry(self._clock()):
            with self._changed:
                if self._closing:
                    self._log.drop_held()
                else:
                    self._changed.wait_for(lambda: self._closing, _RETRY_S)

    def _sync_if_wanted(self) -> None:
        if self.synced < self._sync_wanted <= self.written and self._log.sync(self._clock()):
            self._note_synced(self.written)

    def _note_synced(self, number: int) -> None:
        with self._changed:
            self.synced = number
            self._changed.notify_all()

    def _remember_position(self, number: int) -> None:
        """Remember the position of a piece."""
        position = self._log.position
        with self._changed:
            last = self._runs[-1] if self._runs else None
            if (
                last is not None
                and number == last.last + 1
                and position == last.position._replace(messages=last.position.messages + 1)
            ):
                self._runs[-1] = last._replace(last=number, position=position)
            else:
                self._runs.append(_PieceRun(number, number, position))
            self.written = number
            self._changed.notify_all()
