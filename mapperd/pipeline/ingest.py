"""Where everything comes in: to the recorder and to the mapper, the same bytes in one order."""

import threading
from collections.abc import Callable, Mapping

from mapperd.pipeline.chunk_queue import ChunkQueue
from mapperd.pipeline.recorder import Recorder
from mapperd.session_log import Decision, Gap, Skip, chunk_of
from oculus_driver.recording import OCULUS, Chunk

__all__ = ["SONAR", "Inlet"]

SONAR = "sonar"
"""Name of the sonar's link."""


class Inlet:
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
