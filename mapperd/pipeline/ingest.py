"""Bytes of all links, in one order, to the recorder and to the mapping thread."""

import threading
from collections import deque
from collections.abc import Callable, Mapping
from threading import Condition

from mapperd.pipeline.recorder import Recorder
from mapperd.session_log import Decision, Gap, Skip, chunk_of
from oculus_driver.recording import OCULUS, Chunk

__all__ = ["MAX_BYTES", "SONAR", "ChunkQueue", "Ingest"]

MAX_BYTES = 64 * 1024 * 1024

MIN_SIZE = 512
"""What an entry counts at least: its own memory."""


class ChunkQueue:
    """Chunks in order, bounded by their bytes; any threads.

    Args:
        max_bytes: that may wait.

    Attributes:
        chunks_refused, bytes_refused: for which there was no room.
    """

    def __init__(self, max_bytes: int = MAX_BYTES) -> None:
        self.chunks_refused = 0
        self.bytes_refused = 0
        self._limit = max_bytes
        self._chunks: deque[tuple[Chunk, int]] = deque()
        self._bytes = 0
        self._closed = self._woken = False
        self._changed = Condition()

    @property
    def waiting_bytes(self) -> int:
        """Bytes that wait."""
        return self._bytes

    def has_room(self, chunk: Chunk) -> bool:
        """Whether a chunk may be put; one that may not counts as refused. For the one producer."""
        if self._bytes + _size(chunk) <= self._limit:
            return True
        self.chunks_refused += 1
        self.bytes_refused += len(chunk.data)
        return False

    def put(self, chunk: Chunk, number: int = 0) -> None:
        """Add a chunk, for which there is room, or that is a decision, of which there are few.

        Args:
            chunk: the next one.
            number: of the piece of the recording that it is, or behind which it comes.
        """
        with self._changed:
            self._chunks.append((chunk, number))
            self._bytes += _size(chunk)
            self._changed.notify()

    def wake(self) -> None:
        """Let `take` return, though there may be nothing to take."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def take(self, wait_s: float | None) -> list[tuple[Chunk, int]] | None:
        """All chunks that wait, in order, with their numbers; None once it is closed and empty.

        Args:
            wait_s: for the first one, where there is none; None is until one comes.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._chunks or self._closed or self._woken, wait_s)
            self._woken = False
            if self._closed and not self._chunks:
                return None
            chunks = list(self._chunks)
            self._chunks.clear()
            self._bytes = 0
        return chunks

    def close(self) -> None:
        """Nothing more will be added."""
        with self._changed:
            self._closed = True
            self._changed.notify()


def _size(chunk: Chunk) -> int:
    return max(len(chunk.data), MIN_SIZE)


SONAR = "sonar"
"""Name of the sonar's link."""


class Ingest:
    """Hands on what comes in; any thread, never waits.

    Args:
        recorder: gets everything.
        queue: gets what it has room for; what it has not is noted in the recording.
        encodings: of the links of the odometry.
        clock: of the arrivals, nanoseconds.
    """

    def __init__(
        self,
        recorder: Recorder,
        queue: ChunkQueue,
        encodings: Mapping[str, str],
        clock: Callable[[], int],
    ) -> None:
        self._recorder = recorder
        self._queue = queue
        self._encodings = {SONAR: OCULUS, **encodings}
        self._clock = clock
        self._skipped: dict[str, int] = {}
        self._lock = threading.Lock()

    def bytes_came(self, link: str, data: bytes, arrival_ns: int, *, gap: bool) -> None:
        """Take bytes of a link.

        Args:
            link: its name.
            data: as they came.
            arrival_ns: when.
            gap: bytes before them are missing.
        """
        with self._lock:
            if gap:
                self._order(Gap(link), arrival_ns)
            if not data:
                return
            chunk = Chunk(link, self._encodings[link], arrival_ns, data)
            if self._queue.has_room(chunk):
                self._tell_skipped(arrival_ns)
                self._queue.put(chunk, self._recorder.record(chunk, gap=gap))
                return
            self._skipped[link] = self._skipped.get(link, 0) + len(data)
            self._recorder.record(chunk_of(Skip(link, len(data)), arrival_ns), gap=False)
            self._recorder.record(chunk, gap=gap)

    def order(self, decision: Decision) -> None:
        """Let something take effect for the bytes that come from here on."""
        with self._lock:
            self._order(decision, self._clock())

    def remark(self, decision: Decision) -> None:
        """Record what was decided about a ping; the mapper knows."""
        with self._lock:
            self._recorder.record(chunk_of(decision, self._clock()), gap=False)

    def _order(self, decision: Decision, t_ns: int) -> None:
        self._tell_skipped(t_ns)
        chunk = chunk_of(decision, t_ns)
        self._queue.put(chunk, self._recorder.record(chunk, gap=False))

    def _tell_skipped(self, t_ns: int) -> None:
        """Let the mapper know, in one order a link, what stands in several in the recording."""
        for link, size in self._skipped.items():
            self._queue.put(chunk_of(Skip(link, size), t_ns), self._recorder.newest)
        self._skipped.clear()
