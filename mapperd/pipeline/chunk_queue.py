"""Bytes on their way from the event loop to the mapping thread."""

from collections import deque
from threading import Condition

from oculus_driver.recording import Chunk

__all__ = ["MAX_BYTES", "ChunkQueue"]

MAX_BYTES = 64 * 1024 * 1024

LEAST_SIZE = 512
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
    return max(len(chunk.data), LEAST_SIZE)
