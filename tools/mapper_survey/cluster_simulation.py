"""Simulates a survey on a cluster: schedules its measured tasks event by event.

One scheduler hands out tasks in the order of the list, each as soon as its predecessors are done. A
worker does one task at a time: it reads, computes, and writes. Workers that read or write share the
storage's bandwidth equally, each up to the speed of its link.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from mapper_survey.run_record import TaskTime, in_order


@dataclass(frozen=True, slots=True)
class ComputeCluster:
    """A cluster.

    Attributes:
        workers: number of workers; each does one task at a time.
        scheduler_s: time of the scheduler for each task.
        storage_bytes_per_s: bandwidth of the shared storage for all workers.
        link_bytes_per_s: bandwidth between the storage and one worker.
    """

    workers: int
    scheduler_s: float = 0.0
    storage_bytes_per_s: float = inf
    link_bytes_per_s: float = inf

    def __post_init__(self) -> None:
        if self.workers < 1 or self.scheduler_s < 0.0:
            raise ValueError(
                "a cluster has a worker at least, and its scheduler takes time or none"
            )
        if min(self.storage_bytes_per_s, self.link_bytes_per_s) <= 0.0:
            raise ValueError("a cluster's storage and links carry more than nothing")


@dataclass(frozen=True, slots=True)
class Schedule:
    """Result of a simulated survey.

    Attributes:
        wall_s: time from the start to the end of the last task.
        computing_s: computing time of all workers.
        scheduling_s: busy time of the scheduler.
        moved_bytes: bytes read and written.
        ended_s: end of each task, by name.
    """

    wall_s: float
    computing_s: float
    scheduling_s: float
    moved_bytes: int
    ended_s: dict[str, float]


def simulate(tasks: Sequence[TaskTime], cluster: ComputeCluster) -> Schedule:
    """Run all tasks.

    Raises:
        ValueError: see `mapper_survey.run_record.in_order`.
    """
    return _SurveyRun(in_order(tasks), cluster).schedule()


class _SharedStorage:
    """Transfers that share a bandwidth equally.

    At any time all run at the same rate. A transfer therefore ends when the amount that one
    transfer would have carried since the beginning has grown by its size.
    """

    def __init__(self, cluster: ComputeCluster) -> None:
        self._cluster = cluster
        self._carried = 0.0
        self._updated_s = 0.0
        self._over: list[tuple[float, int]] = []

    def start(self, now_s: float, size: int, task: int) -> None:
        self._advance(now_s)
        heapq.heappush(self._over, (self._carried + size, task))

    def next_end_s(self) -> float:
        """Time of the end of the next transfer if none starts before; infinite without one."""
        if not self._over:
            return inf
        return self._updated_s + max(self._over[0][0] - self._carried, 0.0) / self._rate()

    def end_next(self, now_s: float) -> int:
        """Remove the transfer that ends now; return its task."""
        self._updated_s = now_s
        self._carried, task = heapq.heappop(self._over)
        return task

    def _advance(self, now_s: float) -> None:
        if now_s > self._updated_s and self._over:
            self._carried += self._rate() * (now_s - self._updated_s)
        self._updated_s = now_s

    def _rate(self) -> float:
        share = self._cluster.storage_bytes_per_s / len(self._over)
        return min(share, self._cluster.link_bytes_per_s)


class _SurveyRun:
    """The events of one survey."""

    def __init__(self, tasks: list[TaskTime], cluster: ComputeCluster) -> None:
        self._tasks, self._cluster = tasks, cluster
        self._storage = _SharedStorage(cluster)
        self._numbers = {task.name: k for k, task in enumerate(tasks)}
        self._waits = [len(set(task.after)) for task in tasks]
        self._later: list[list[int]] = [[] for _ in tasks]
        for k, task in enumerate(tasks):
            for name in set(task.after):
                self._later[self._numbers[name]].append(k)
        self._ready = [k for k, waits in enumerate(self._waits) if waits == 0]
        self._idle = cluster.workers
        self._scheduler_free_s = 0.0
        self._events: list[tuple[float, int, bool]] = []
        """Time, task, and whether it has computed; otherwise it was handed out."""
        self._writing = [False] * len(tasks)
        self._ended_s: dict[str, float] = {}

    def schedule(self) -> Schedule:
        now_s = 0.0
        while len(self._ended_s) < len(self._tasks):
            self._hand_out(now_s)
            event_s = self._events[0][0] if self._events else inf
            transfer_s = self._storage.next_end_s()
            now_s = min(event_s, transfer_s)
            if transfer_s <= event_s:
                self._transferred(now_s, self._storage.end_next(now_s))
            else:
                _, task, computed = heapq.heappop(self._events)
                self._begin_transfer(now_s, task, writing=computed)
        return Schedule(
            now_s,
            sum(task.cpu_s for task in self._tasks),
            self._cluster.scheduler_s * len(self._tasks),
            sum(task.read_bytes + task.written_bytes for task in self._tasks),
            self._ended_s,
        )

    def _hand_out(self, now_s: float) -> None:
        while self._idle and self._ready:
            task = heapq.heappop(self._ready)
            self._idle -= 1
            self._scheduler_free_s = max(now_s, self._scheduler_free_s) + self._cluster.scheduler_s
            heapq.heappush(self._events, (self._scheduler_free_s, task, False))

    def _begin_transfer(self, now_s: float, task: int, *, writing: bool) -> None:
        self._writing[task] = writing
        times = self._tasks[task]
        self._storage.start(now_s, times.written_bytes if writing else times.read_bytes, task)

    def _transferred(self, now_s: float, task: int) -> None:
        if not self._writing[task]:
            heapq.heappush(self._events, (now_s + self._tasks[task].cpu_s, task, True))
            return
        self._idle += 1
        self._ended_s[self._tasks[task].name] = now_s
        for later in self._later[task]:
            self._waits[later] -= 1
            if self._waits[later] == 0:
                heapq.heappush(self._ready, later)
