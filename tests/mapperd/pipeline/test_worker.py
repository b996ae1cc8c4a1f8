"""The mapping thread, on a clock that the test turns."""

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from mapperd.config.tree import BacklogConfig, Config
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.backlog import Backlog
from mapperd.pipeline.build import build_pipeline
from mapperd.pipeline.ingest import SONAR, ChunkQueue
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.pipeline.worker import MappingThread, snapshot_reader
from mapperd.session_log import Decision, Drop, Remarks
from oculus_driver.recording import OCULUS, Chunk

PingBytes = Callable[..., bytes]
S = 1_000_000_000


class Bench:
    """A mapping thread and everything that it reports."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.remarks: list[Decision] = []
        self.late: list[bool] = []
        self.queue = ChunkQueue()
        sonar_map = SonarMap(Config())
        persistence = MemoryPersistence(sonar_map)
        poses = FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0)))
        pipeline = build_pipeline(sonar_map, poses, persistence=persistence, remarks=Remarks())
        self.thread = MappingThread(
            self.queue,
            pipeline,
            Backlog(BacklogConfig(max_wait=1.0)),
            persistence,
            remark=self.remarks.append,
            clock=lambda: self.now_ns,
            read_snapshot=snapshot_reader(lambda: self.now_ns),
        )
        self.thread.on_snapshot = lambda snapshot: self.late.append(snapshot.behind["late"])

    def receive(self, data: bytes, arrival_ns: int) -> None:
        self.queue.put(Chunk(SONAR, OCULUS, arrival_ns, data))

    def run(self) -> None:
        self.queue.close()
        self.thread.start()
        self.thread.join()
        if self.thread.failure is not None:
            raise self.thread.failure


def test_time_in_the_queue_counts_as_waiting(ping_bytes: PingBytes) -> None:
    """A ping of six seconds kept the thread; what arrived meanwhile has not been decoded yet."""
    bench = Bench()
    for number in range(1, 61):
        bench.receive(ping_bytes(number), number * S // 10)
    bench.now_ns = 6 * S
    bench.run()
    assert bench.remarks == [Drop(k) for k in range(49)]  # those of more than a second ago
    assert bench.thread.pipeline.counters.pings_mapped == 11


def test_backlog_is_late_until_nothing_waits(ping_bytes: PingBytes) -> None:
    bench = Bench()
    map_ping: Any = bench.thread.pipeline.executor.map_ping

    def slow(posed: Any) -> Any:
        bench.now_ns += S // 2
        return map_ping(posed)

    bench.thread.pipeline.executor.map_ping = slow  # type: ignore[method-assign]
    for number in range(1, 61):
        bench.receive(ping_bytes(number), number * S // 10)
    bench.now_ns = 6 * S
    bench.run()
    assert bench.late[0]
    assert not bench.late[-1]


def test_a_thread_that_hangs_in_its_only_ping_has_work(ping_bytes: PingBytes) -> None:
    bench, going_on = Bench(), threading.Event()

    def hang(_: Any) -> Any:
        going_on.wait()

    bench.thread.pipeline.executor.map_ping = hang  # type: ignore[method-assign, assignment]
    bench.receive(ping_bytes(1), 0)
    bench.thread.start()
    while not bench.thread.waiting:
        time.sleep(0.001)
    time.sleep(0.05)
    assert bench.thread.waiting == 1
    going_on.set()
    bench.queue.close()
    bench.thread.join()
    assert bench.thread.waiting == 0


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapperd.pipeline.worker.FINISH_TIMEOUT_NS", 0)
