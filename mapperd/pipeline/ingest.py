"""Passes the bytes of all links, in one order, to the recorder and to the mapping thread."""

import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from threading import Condition
from typing import NamedTuple

from mapperd.pipeline.recorder import Recorder
from mapperd.session_log import Decision, Gap, Skip, chunk_of
from oculus_driver.recording import OCULUS, OCULUS_STATUS, Chunk
from oculus_driver.stream import Framing

__all__ = ["MAX_BYTES", "SONAR", "STATUS", "ChunkQueue", "Ingest", "Received"]

MAX_BYTES = 64 * 1024 * 1024
"""Room of the sonar in the queue."""

MAX_OTHER_BYTES = 8 * 1024 * 1024
"""Room of each other link: none takes the sonar's."""

MAX_FRAMED_BYTES = 8 * 1024 * 1024
"""With more waiting, messages that the driver found are not kept: they hold the bytes once more."""

MIN_SIZE = 512
"""Minimum accounted size of an entry: its own memory."""


SONAR = "sonar"
"""Name of the sonar's link."""

STATUS = "status"
"""Name of the link of its status datagrams, which are recorded and not mapped."""


class Received(NamedTuple):
    """A chunk on its way to the mapping thread.

    Attributes:
        chunk: the bytes, or a decision.
        number: of the recorded piece that holds it, or of the piece before it.
        framing: what the driver found in bytes of the sonar; None: the mapping thread frames them.
    """

    chunk: Chunk
    number: int
    framing: Framing | None = None


class ChunkQueue:
    """A queue of chunks with a bounded size for each link; thread-safe.

    Args:
        max_bytes: maximum size of the waiting chunks of one link.

    Attributes:
        chunks_refused, bytes_refused: input without room.
    """

    def __init__(self, max_bytes: int = MAX_BYTES) -> None:
        self.chunks_refused = 0
        self.bytes_refused = 0
        self._limit = max_bytes
        self._chunks: deque[Received] = deque()
        self._bytes: Counter[str] = Counter()
        self._total = 0
        self._closed = self._woken = False
        self._changed = Condition()

    @property
    def waiting_bytes(self) -> int:
        """Size of the waiting chunks."""
        return self._total

    def has_room(self, chunk: Chunk) -> bool:
        """Return whether a chunk fits; count it as refused if not. For the only producer."""
        most = self._limit if chunk.link == SONAR else min(self._limit, MAX_OTHER_BYTES)
        if self._bytes[chunk.link] + _size(chunk) <= most:
            return True
        self.chunks_refused += 1
        self.bytes_refused += len(chunk.data)
        return False

    def put(self, chunk: Chunk, number: int = 0, framing: Framing | None = None) -> None:
        """Append a chunk that fits, or a decision.

        Args:
            chunk: the next chunk.
            number: of the recorded piece that holds it, or of the piece before it.
            framing: what the driver found in it.
        """
        with self._changed:
            kept = framing if self._total <= MAX_FRAMED_BYTES else None
            self._chunks.append(Received(chunk, number, kept))
            self._bytes[chunk.link] += _size(chunk)
            self._total += _size(chunk)
            self._changed.notify()

    def wake(self) -> None:
        """Make `take` return, even without chunks."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def take(self, wait_s: float | None) -> list[Received] | None:
        """Remove and return all waiting chunks; None when closed and empty.

        Args:
            wait_s: how long to wait for the first chunk; None waits without a limit.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._chunks or self._closed or self._woken, wait_s)
            self._woken = False
            if self._closed and not self._chunks:
                return None
            chunks = list(self._chunks)
            self._chunks.clear()
            self._bytes.clear()
            self._total = 0
        return chunks

    def close(self) -> None:
        """Declare that nothing more is added."""
        with self._changed:
            self._closed = True
            self._changed.notify()


def _size(chunk: Chunk) -> int:
    return max(len(chunk.data), MIN_SIZE)


class Ingest:
    """Passes input on; any thread, never waits.

    Args:
        recorder: receives everything.
        queue: receives what fits; the recording notes the rest as skipped.
        encodings: of the odometry links.
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
        self._encodings = {SONAR: OCULUS, STATUS: OCULUS_STATUS, **encodings}
        self._clock = clock
        self._skipped: dict[str, int] = {}
        self._lock = threading.Lock()

    def receive(
        self,
        link: str,
        data: bytes,
        arrival_ns: int,
        framing: Framing | None = None,
        *,
        gap: bool,
    ) -> None:
        """Pass on received bytes of a link.

        Args:
            link: name of the link.
            data: the received bytes.
            arrival_ns: their arrival time.
            framing: what the driver found in bytes of the sonar; None: these are whole messages.
            gap: bytes in front of them are missing.
        """
        with self._lock:
            if gap:
                self._order(Gap(link), arrival_ns)
            if not data:
                return
            chunk = Chunk(link, self._encodings[link], arrival_ns, data)
            bounds = None if framing is None else framing.bounds
            if self._queue.has_room(chunk):
                self._queue_skips(arrival_ns)
                number = self._recorder.record(chunk, gap=gap, bounds=bounds)
                self._queue.put(chunk, number, framing)
                return
            self._skipped[link] = self._skipped.get(link, 0) + len(data)
            self._recorder.record(chunk_of(Skip(link, len(data)), arrival_ns), gap=False)
            self._recorder.record(chunk, gap=gap, bounds=bounds)

    def order(self, decision: Decision) -> None:
        """Pass on a decision that takes effect for the bytes after it."""
        with self._lock:
            self._order(decision, self._clock())

    def remark(self, decision: Decision) -> None:
        """Record a decision of the mapping thread."""
        with self._lock:
            self._recorder.record(chunk_of(decision, self._clock()), gap=False)

    def _order(self, decision: Decision, t_ns: int) -> None:
        self._queue_skips(t_ns)
        chunk = chunk_of(decision, t_ns)
        self._queue.put(chunk, self._recorder.record(chunk, gap=False))

    def _queue_skips(self, t_ns: int) -> None:
        """Queue one `Skip` per link for all skipped pieces; the recording has one for each."""
        for link, size in self._skipped.items():
            self._queue.put(chunk_of(Skip(link, size), t_ns), self._recorder.newest)
        self._skipped.clear()
