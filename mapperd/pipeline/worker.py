"""The mapping thread: the only thread that decodes bytes and changes the map; and its status."""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mapperd.errors import StoreError
from mapperd.localization.status import LocalizationSnapshot
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.backlog import Backlog
from mapperd.pipeline.build import Pipeline
from mapperd.pipeline.counters import Latency
from mapperd.pipeline.decoder import NewSettings, PosedPing, Work
from mapperd.pipeline.ingest import ChunkQueue
from mapperd.pipeline.persistence import MapPersistence
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.session_log import STUCK, Decision, Drop, Request, Reset, ResetFailed

if TYPE_CHECKING:
    from mapperd.errors import Reject
    from mapperd.pipeline.step import PingResult

__all__ = ["MappingThread", "StatusSnapshot", "snapshot_reader"]

FINISH_TIMEOUT_NS = 10_000_000_000
"""Time at the end in which all waiting pings are mapped; after it late pings are dropped again."""

SNAPSHOT_INTERVAL_NS = 200_000_000
"""Minimum time between two snapshots while the thread is busy."""


@dataclass(frozen=True, slots=True)
class StatusSnapshot:
    """Status of the mapping thread between two pings; immutable.

    Attributes:
        pings, latency_ms, behind, odometry, robots: as in `DaemonApi.status`.
        pose, pose_ns: of the newest mapped ping, and the arrival of that ping's last byte.
        sonar: values of that ping.
        clocks: how pings got their times.
        progress: finished pieces of work.
        localization: its status; None where it is off.
        rule: as of `SonarMap.rule_facts`.
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
    localization: LocalizationSnapshot | None = None
    rule: dict[str, Any] = field(default_factory=dict)


class MappingThread:
    """Maps the chunks of a queue until the queue is closed and empty.

    Args:
        queue: of received chunks.
        pipeline: decodes and maps them.
        backlog: of decoded work.
        persistence: of the map.
        remark: records a decision.
        clock: of the arrivals, nanoseconds.
        read_snapshot: reads the thread's status between two pings.

    Attributes:
        snapshot: the newest status.
        newest: result of the last mapped ping.
        pipeline, backlog: as given; used only by the thread while it runs.
        failure: error that ended the thread.
        on_end: called in the thread at its end.
        on_reset: called in the thread after each reset, with its error or None.
        on_request: called in the thread after each request to localization, with why it was
            refused or None.
        on_snapshot: called in the thread with each new snapshot.
    """

    def __init__(
        self,
        queue: ChunkQueue,
        pipeline: Pipeline,
        backlog: Backlog,
        persistence: MapPersistence,
        *,
        remark: Callable[[Decision], None],
        clock: Callable[[], int],
        read_snapshot: Callable[["MappingThread"], StatusSnapshot],
    ) -> None:
        self.pipeline = pipeline
        self.backlog = backlog
        self.latency = Latency()
        self.newest: PingResult | None = None
        self.progress = 0
        self.failure: BaseException | None = None
        self.on_end: Callable[[], None] = lambda: None
        self.on_reset: Callable[[Reset, StoreError | None], None] = lambda *_: None
        self.on_request: Callable[[Request, Reject | None], None] = lambda *_: None
        self.on_snapshot: Callable[[StatusSnapshot], None] = lambda _: None
        self._queue = queue
        self._persistence = persistence
        self._remark = remark
        self._clock = clock
        self._read_snapshot = read_snapshot
        self._number = 0
        self._is_busy = False
        self.snapshot = read_snapshot(self)
        self._published_ns = 0
        self._unpublished = False
        self._thread = threading.Thread(target=self._run, name="mapping", daemon=True)
        pipeline.executor.on_stuck = lambda posed, _: remark(Drop(posed.number, STUCK))

    @property
    def waiting(self) -> int:
        """Number of unfinished pieces of work; any thread."""
        return len(self.backlog) + self._is_busy

    @property
    def steps(self) -> int:
        """Grows with all input and all finished work; any thread."""
        decoder = self.pipeline.decoder
        return self.progress + decoder.bytes_taken + decoder.orders_taken

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def join(self) -> None:
        """Wait for the end of the thread, after the queue is closed."""
        self._thread.join()

    def _run(self) -> None:
        decoder = self.pipeline.decoder
        try:
            while (chunks := self._queue.take(self._timeout_s())) is not None:
                for chunk, number, framing in chunks:
                    self._number = number
                    self._enqueue(decoder.feed(chunk, framing=framing), chunk.arrival_ns)
                self._do_one(patient=False)
                self._persistence.between(self._number, len(self.backlog))
                self._publish(news=bool(chunks))
            self._enqueue(decoder.end(), None)
            late_ns = self._clock() + FINISH_TIMEOUT_NS
            while self.backlog:
                self._do_one(patient=self._clock() < late_ns)
                self._publish(news=True)
            self._persistence.end()
            self._publish_now()
        except BaseException as error:  # noqa: BLE001 raised where the end of the thread is awaited
            self.failure = error
        finally:
            self._persistence.stop()
            self.on_end()

    def _enqueue(self, works: list[Work], arrival_ns: int | None) -> None:
        """Queue work that the bytes of this arrival completed; None: the end of the input."""
        arrival_ns = self._clock() if arrival_ns is None else arrival_ns
        for work in works:
            self.backlog.put(work, arrival_ns)

    def _do_one(self, *, patient: bool) -> None:
        """Do the next piece of work and drop the late pings in front of it."""
        while self.backlog and self._do_next(patient=patient):
            pass

    def _do_next(self, *, patient: bool) -> bool:
        """Do the next piece of work; return whether it was a dropped ping."""
        work, is_late = self.backlog.next(self._clock(), patient=patient)
        self._is_busy = True
        executor = self.pipeline.executor
        match work:
            case PosedPing() if is_late:
                self._remark(Drop(work.number))
                executor.drop(work)
            case PosedPing():
                self._map_ping(work)
            case Reset():
                self._reset(work)
            case NewSettings():
                executor.change_settings(work)
            case _:
                self.on_request(work, executor.request(work))
        self._is_busy = False
        self.progress += 1
        return is_late

    def _map_ping(self, posed: PosedPing) -> None:
        result = self.pipeline.executor.map_ping(posed)
        if result is None or result.reject is not None:
            return
        self.newest = result
        if posed.complete_ns is not None:
            self.latency.add(posed.complete_ns, self._clock())

    def _reset(self, reset: Reset) -> None:
        problem: StoreError | None = None
        try:
            self.pipeline.executor.reset(reset)
        except StoreError as error:
            problem = error
            self._remark(ResetFailed(reset.number))
        self.on_reset(reset, problem)

    def _timeout_s(self) -> float | None:
        """Return how long to wait for chunks: not at all with work, briefly before a snapshot."""
        if self.backlog:
            return 0.0
        return SNAPSHOT_INTERVAL_NS / 1e9 if self._unpublished else None

    def _publish(self, *, news: bool) -> None:
        """Publish a snapshot: at intervals while busy, and once when the input pauses."""
        self._unpublished = self._unpublished or news
        is_idle = not news and not self.backlog
        if not self._queue.waiting_bytes:
            self.backlog.rest()
        is_due = self._clock() - self._published_ns >= SNAPSHOT_INTERVAL_NS
        if self._unpublished and (is_idle or is_due):
            self._publish_now()

    def _publish_now(self) -> None:
        self._published_ns, self._unpublished = self._clock(), False
        self.snapshot = self._read_snapshot(self)
        self.on_snapshot(self.snapshot)


def snapshot_reader(clock: Callable[[], int]) -> Callable[[MappingThread], StatusSnapshot]:
    """Return a function that reads a thread's status between two pings as plain values.

    Args:
        clock: of the arrivals, nanoseconds.
    """

    def read(thread: MappingThread) -> StatusSnapshot:
        newest, localization = thread.newest, thread.pipeline.executor.stages.localization
        pose = None if newest is None else newest.pose
        return StatusSnapshot(
            pings=_pings(thread),
            latency_ms=thread.latency.percentiles_ms(clock()),
            behind=_backlog(thread),
            odometry=_odometry(thread),
            robots=_robots(thread, clock()),
            pose=pose if isinstance(pose, FusedPose) else None,
            pose_ns=None if newest is None else newest.posed.complete_ns,
            sonar=_sonar(thread),
            clocks=_clocks(thread),
            progress=thread.progress,
            localization=None if localization is None else localization.snapshot(),
            rule=thread.pipeline.executor.stages.map.rule_facts(),
        )

    return read


def _pings(thread: MappingThread) -> dict[str, Any]:
    counters = thread.pipeline.counters
    return {
        "total": counters.pings_total,
        "mapped": counters.pings_mapped,
        "dropped": dict(sorted(counters.pings_dropped.items())),
        "waiting": thread.pipeline.decoder.waiting + thread.backlog.pings,
    }


def _backlog(thread: MappingThread) -> dict[str, Any]:
    backlog = thread.backlog
    return {
        "late": backlog.late,
        "dropped": backlog.dropped,
        "ready": backlog.pings,
    }


def _odometry(thread: MappingThread) -> dict[str, Any]:
    poses = thread.pipeline.poses
    if isinstance(poses, FixedPose):
        return {"source": "fixed", "ignored": poses.ignored}
    bridge = poses.odometry
    return {
        "source": "odometry",
        "received": bridge.received,
        "accepted": bridge.accepted,
        "rejected": dict(sorted(bridge.rejects.items())),
        **bridge.status(),
    }


def _robots(thread: MappingThread, now_ns: int) -> list[dict[str, Any]]:
    expire_s = thread.pipeline.decoder.config.robot_detection.expire_sec
    seen = thread.pipeline.executor.sightings.since(now_ns, expire_s)
    return [{"t_s": one.t_ns / 1e9, "position_m": list(one.position_m)} for one in seen]


def _sonar(thread: MappingThread) -> dict[str, Any]:
    if thread.newest is None:
        return {}
    ping = thread.newest.posed.ping
    clock = thread.pipeline.decoder.clocks.get(ping.source_id)
    period_s = None if clock is None else clock.period_s
    return {
        "ping_id": ping.ping_id,
        "ping_rate_hz": None if period_s is None else 1 / period_s,
        "range_m": ping.max_range_m,
        "gain_percent": ping.gain_percent if math.isfinite(ping.gain_percent) else None,
        "temperature_c": ping.temperature_c,
        "speed_of_sound_mps": ping.credible_speed_of_sound_mps,
    }


def _clocks(thread: MappingThread) -> dict[str, Any]:
    clocks = thread.pipeline.decoder.clocks.values()
    placed = {
        method: sum(clock.placed[method] for clock in clocks) for method in ("device", "arrival")
    }
    return {"placed": placed, "restarts": sum(clock.restarts for clock in clocks)}
