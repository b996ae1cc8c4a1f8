"""The one thread that understands bytes and changes the map."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from mapperd.errors import StoreError
from mapperd.localization.status import LocalizationFacts
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.backlog import Backlog
from mapperd.pipeline.counters import Latency
from mapperd.pipeline.decoder import NewSettings, PosedPing, SessionDecoder, Work
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.ingest import ChunkQueue
from mapperd.pipeline.persistence import MapPersistence
from mapperd.session_log import Decision, Drop, Request, Reset, ResetFailed

if TYPE_CHECKING:
    from mapperd.errors import Reject

__all__ = ["MappingThread", "StatusSnapshot"]

LAST_NS = 10_000_000_000
"""So long everything that waits at the end is mapped; then only what has not waited for long."""

TELL_NS = 200_000_000
"""So often, at most, it says how it goes while it is busy."""


@dataclass(frozen=True, slots=True)
class StatusSnapshot:
    """How it goes, as it was at one moment between two pings; nobody changes it afterwards.

    Attributes:
        pings, latency_ms, behind, odometry, robots: as `DaemonApi.status` has them.
        pose, pose_ns: of the newest ping that had one, and when that ping was complete.
        sonar: what the newest of those pings was like.
        clocks: how pings were placed in time.
        progress: pieces of work that were done.
        localization: how that stands; None where it is off.
    """

    pings: dict[str, Any]
    latency_ms: dict[str, float] | None
    behind: dict[str, Any]
    odometry: dict[str, Any]
    robots: list[dict[str, Any]]
    pose: FusedPose | None
    pose_ns: int | None
    sonar: dict[str, Any]
    clocks: dict[str, Any]
    progress: int
    localization: LocalizationFacts | None = None


class MappingThread:
    """Takes chunks from the queue and maps what they give, until the queue is closed and empty.

    Args:
        queue: of what comes in.
        engine: makes work of it.
        integration: does the work.
        backlog: what waits in between.
        remark: records a decision.
        clock: of the arrivals, nanoseconds.
        facts_of: reads its facts, between two pings.
        keep: of the map.

    Attributes:
        facts: the newest.
        newest: ping that was mapped last; its image is kept with it.
        engine, integration, backlog: as given; of the thread alone while it runs.
        failure: what ended it before its time.
        on_end: called in the thread at its end.
        on_reset: called in the thread with each reset and why it failed, if it did.
        on_request: called in the thread with what localization was asked for, and why it was
            refused, if it was.
        on_told: called in the thread with new facts.
    """

    def __init__(
        self,
        queue: ChunkQueue,
        engine: SessionDecoder,
        integration: PingExecutor,
        backlog: Backlog,
        *,
        remark: Callable[[Decision], None],
        clock: Callable[[], int],
        facts_of: Callable[["MappingThread"], StatusSnapshot],
        keep: MapPersistence,
    ) -> None:
        self.engine = engine
        self.integration = integration
        self.backlog = backlog
        self.latency = Latency()
        self.newest: PosedPing | None = None
        self.progress = 0
        self.failure: BaseException | None = None
        self.on_end: Callable[[], None] = lambda: None
        self.on_reset: Callable[[Reset, StoreError | None], None] = lambda *_: None
        self.on_request: Callable[[Request, Reject | None], None] = lambda *_: None
        self.on_told: Callable[[StatusSnapshot], None] = lambda _: None
        self._queue = queue
        self._remark = remark
        self._clock = clock
        self._facts_of = facts_of
        self._keep = keep
        self._number = 0
        self.facts = facts_of(self)
        self._told_ns = 0
        self._untold = False
        self._thread = threading.Thread(target=self._run, name="mapping", daemon=True)

    @property
    def waiting(self) -> int:
        """Pieces of work at hand; any thread."""
        return len(self.backlog)

    @property
    def steps(self) -> int:
        """Grows with all that is taken and all that is done; any thread."""
        return self.progress + self.engine.bytes_taken + self.engine.orders_taken

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def join(self) -> None:
        """Wait for the end, which the queue's closing brings."""
        self._thread.join()

    def _run(self) -> None:
        try:
            while (chunks := self._queue.take(self._patience_s())) is not None:
                for chunk, number in chunks:
                    self._number = number
                    self._wait_for_turn(self.engine.feed(chunk))
                self._do_one(patient=False)
                self._keep.between(self._number, len(self.backlog))
                self._tell(news=bool(chunks))
            self._wait_for_turn(self.engine.end())
            late_ns = self._clock() + LAST_NS
            while self.backlog:
                self._do_one(patient=self._clock() < late_ns)
                self._tell(news=True)
            self._keep.end()
            self._tell_now()
        except BaseException as error:  # noqa: BLE001 raised by whoever waits for the end
            self.failure = error
        finally:
            self._keep.stop()
            self.on_end()

    def _wait_for_turn(self, works: list[Work]) -> None:
        now_ns = self._clock()
        for work in works:
            self.backlog.put(work, now_ns)

    def _do_one(self, *, patient: bool) -> None:
        """Do the next piece of work; what is only dropped before it is none."""
        while self.backlog and self._do_next(patient=patient):
            pass

    def _do_next(self, *, patient: bool) -> bool:
        """Do what is next; returns whether it was dropped."""
        turn = self.backlog.next(self._clock(), patient=patient)
        match turn.work:
            case PosedPing() as settled if turn.dropped:
                self._remark(Drop(settled.number))
                self.integration.drop(settled)
            case PosedPing() as settled:
                self._ping(settled)
            case Reset() as reset:
                self._reset(reset)
            case NewSettings() as settings:
                self.integration.do(settings)
            case request:
                self.on_request(request, self.integration.ask(request))
        self.progress += 1
        return turn.dropped

    def _ping(self, settled: PosedPing) -> None:
        mapped = self.integration.stepping.counters.pings_mapped
        self.integration.do(settled)
        if self.integration.stepping.counters.pings_mapped == mapped:
            return
        if self.integration.newest is not None:
            self.newest = replace(settled, pose=self.integration.newest)
        if settled.complete_ns is not None:
            self.latency.add(settled.complete_ns, self._clock())

    def _reset(self, reset: Reset) -> None:
        problem: StoreError | None = None
        try:
            self.integration.do(reset)
        except StoreError as error:
            problem = error
            self._remark(ResetFailed(reset.number))
        self.on_reset(reset, problem)

    def _patience_s(self) -> float | None:
        """How long to wait for bytes: not at all with work at hand, not for long with news."""
        if self.backlog:
            return 0.0
        return TELL_NS / 1e9 if self._untold else None

    def _tell(self, *, news: bool) -> None:
        """Say how it goes: every now and then while busy, and once when nothing more comes."""
        self._untold = self._untold or news
        idle = not news and not self.backlog
        if self._untold and (idle or self._clock() - self._told_ns >= TELL_NS):
            self._tell_now()

    def _tell_now(self) -> None:
        self._told_ns, self._untold = self._clock(), False
        self.facts = self._facts_of(self)
        self.on_told(self.facts)
