"""How a survey would scale: its measured tasks on clusters of any size, and what limits each.

What limits a cluster is found by taking each limit away, alone, and looking what that saves.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf

import msgspec

from mapper_survey.cluster_simulation import Cluster, Schedule, simulate
from mapper_survey.task_times import Kind, TaskTime, in_order

WORKERS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)

Limited = tuple[list[TaskTime], Cluster]


class Step(msgspec.Struct, frozen=True):
    """A survey on so many workers.

    Attributes:
        workers: how many.
        wall_s: simulated.
        speedup: against one worker on the same storage.
        efficiency: the speed-up's part of the workers.
        saved: which part of the time each limit costs, by its name: what its absence alone saves.
            Below zero where it even helps: workers that begin together read at the same time.
        bottleneck: the limit that costs most; `none alone` if there is no such.
    """

    workers: int
    wall_s: float
    speedup: float
    efficiency: float
    saved: dict[str, float]
    bottleneck: str


NOTICED = 0.01
"""A limit that costs less is none."""


def scaling(
    tasks: Sequence[TaskTime], cluster: Cluster, workers: Sequence[int] = WORKERS
) -> list[Step]:
    """Simulate the survey on more and more workers.

    Args:
        tasks: measured; see `mapper_survey.task_times`.
        cluster: scheduler, storage and links; its number of workers is not used.
        workers: how many each time.
    """
    alone_s = simulate(tasks, replace(cluster, workers=1)).wall_s
    return [_step(tasks, replace(cluster, workers=count), alone_s) for count in workers]


def without(limit: str, tasks: Sequence[TaskTime], cluster: Cluster) -> Schedule:
    """The survey as it would go if something did not limit it: a name of `LIMITS`."""
    return simulate(*LIMITS[limit](list(tasks), cluster))


def _step(tasks: Sequence[TaskTime], cluster: Cluster, alone_s: float) -> Step:
    wall_s = simulate(tasks, cluster).wall_s
    if wall_s == 0.0:
        return Step(cluster.workers, 0.0, 1.0, 1.0 / cluster.workers, {}, "none alone")
    saved = {name: 1.0 - without(name, tasks, cluster).wall_s / wall_s for name in LIMITS}
    most = max(saved, key=lambda name: saved[name])
    speedup = alone_s / wall_s
    return Step(
        cluster.workers,
        wall_s,
        speedup,
        speedup / cluster.workers,
        saved,
        most if saved[most] >= NOTICED else "none alone",
    )


def _more_workers(tasks: list[TaskTime], cluster: Cluster) -> Limited:
    return tasks, replace(cluster, workers=max(len(tasks), cluster.workers))


def _no_scheduler(tasks: list[TaskTime], cluster: Cluster) -> Limited:
    return tasks, replace(cluster, scheduler_s=0.0)


def _wide_storage(tasks: list[TaskTime], cluster: Cluster) -> Limited:
    return tasks, replace(cluster, storage_bytes_per_s=inf)


def _wide_links(tasks: list[TaskTime], cluster: Cluster) -> Limited:
    return tasks, replace(cluster, link_bytes_per_s=inf)


def _no_merge(tasks: list[TaskTime], cluster: Cluster) -> Limited:
    free = (
        msgspec.structs.replace(task, cpu_s=0.0, read_bytes=0, written_bytes=0)
        if task.kind == "merge"
        else task
        for task in tasks
    )
    return list(free), cluster


def _divided(kind: Kind) -> Callable[[list[TaskTime], Cluster], Limited]:
    """Tasks of a kind in as many pieces as there are workers, together the same work.

    Those of each map are divided on their own: one map is made after the other. The scheduler has
    no more to do for them than before.
    """

    def divide(tasks: list[TaskTime], cluster: Cluster) -> Limited:
        made = in_order(tasks)
        for before, whole in _together(made, kind).items():
            pieces = [_piece(whole, before, k, cluster.workers) for k in range(cluster.workers)]
            end = TaskTime(
                kind=kind,
                name=f"end of {whole[0].name} and its like",
                cpu_s=0.0,
                read_bytes=0,
                written_bytes=0,
                after=tuple(piece.name for piece in pieces),
            )
            names = {task.name for task in whole}
            rest = [_waiting_for(task, names, end) for task in made if task.name not in names]
            made = [*rest, *pieces, end]
        scheduler_s = cluster.scheduler_s * min(len(tasks) / len(made), 1.0)
        return made, replace(cluster, scheduler_s=scheduler_s)

    return divide


def _together(tasks: Sequence[TaskTime], kind: Kind) -> dict[frozenset[str], list[TaskTime]]:
    """Tasks of a kind by the tasks of others that they wait for, be it through one of their own."""
    groups: dict[frozenset[str], list[TaskTime]] = {}
    waits: dict[str, frozenset[str]] = {}
    for task in tasks:
        if task.kind == kind:
            before = (waits.get(name, frozenset([name])) for name in task.after)
            waits[task.name] = frozenset().union(*before)
            groups.setdefault(waits[task.name], []).append(task)
    return groups


def _piece(whole: Sequence[TaskTime], before: frozenset[str], number: int, pieces: int) -> TaskTime:
    return TaskTime(
        kind=whole[0].kind,
        name=f"piece {number} of {whole[0].name}",
        cpu_s=sum(task.cpu_s for task in whole) / pieces,
        read_bytes=round(sum(task.read_bytes for task in whole) / pieces),
        written_bytes=round(sum(task.written_bytes for task in whole) / pieces),
        after=tuple(sorted(before)),
    )


def _waiting_for(task: TaskTime, names: set[str], end: TaskTime) -> TaskTime:
    if names.isdisjoint(task.after):
        return task
    others = [name for name in task.after if name not in names]
    return msgspec.structs.replace(task, after=(*others, end.name))


LIMITS: dict[str, Callable[[list[TaskTime], Cluster], Limited]] = {
    "workers": _more_workers,
    "recordings": _divided("plan"),
    "tiles": _divided("tile"),
    "merge": _no_merge,
    "storage": _wide_storage,
    "links": _wide_links,
    "scheduler": _no_scheduler,
}
"""Too few workers; recordings that one worker plans alone; tiles that one worker maps alone; the
merge; the storage's bandwidth; a worker's own link; the scheduler's time for each task."""
