"""Simulates the scaling of a survey: its measured tasks on clusters of any size.

The cost of each limit is found by removing it alone and simulating again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import msgspec

from mapper_survey.cluster_simulation import ComputeCluster, Schedule, simulate
from mapper_survey.run_record import Kind, TaskTime, in_order, read_task_times

WORKERS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)

Limited = tuple[list[TaskTime], ComputeCluster]


class Step(msgspec.Struct, frozen=True):
    """A survey with a number of workers.

    Attributes:
        workers: number of workers.
        wall_s: simulated wall time.
        speedup: relative to one worker on the same storage.
        efficiency: speed-up divided by the number of workers.
        saved: share of the time that removing each limit alone would save, by name. It can be
            negative: workers that start together read at the same time.
        bottleneck: the limit that costs most, or `none alone`.
    """

    workers: int
    wall_s: float
    speedup: float
    efficiency: float
    saved: dict[str, float]
    bottleneck: str


NOTICED = 0.01
"""Share of the time below which a limit does not count."""


def scaling(
    tasks: Sequence[TaskTime], cluster: ComputeCluster, workers: Sequence[int] = WORKERS
) -> list[Step]:
    """Simulate the survey on more and more workers.

    Args:
        tasks: measured; see `mapper_survey.run_record`.
        cluster: scheduler, storage and links; its number of workers is not used.
        workers: numbers of workers.
    """
    alone_s = simulate(tasks, replace(cluster, workers=1)).wall_s
    return [_step(tasks, replace(cluster, workers=count), alone_s) for count in workers]


def without(limit: str, tasks: Sequence[TaskTime], cluster: ComputeCluster) -> Schedule:
    """Return the survey without one of `LIMITS`."""
    return simulate(*LIMITS[limit](list(tasks), cluster))


def _step(tasks: Sequence[TaskTime], cluster: ComputeCluster, alone_s: float) -> Step:
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


def _more_workers(tasks: list[TaskTime], cluster: ComputeCluster) -> Limited:
    return tasks, replace(cluster, workers=max(len(tasks), cluster.workers))


def _no_scheduler(tasks: list[TaskTime], cluster: ComputeCluster) -> Limited:
    return tasks, replace(cluster, scheduler_s=0.0)


def _wide_storage(tasks: list[TaskTime], cluster: ComputeCluster) -> Limited:
    return tasks, replace(cluster, storage_bytes_per_s=inf)


def _wide_links(tasks: list[TaskTime], cluster: ComputeCluster) -> Limited:
    return tasks, replace(cluster, link_bytes_per_s=inf)


def _no_merge(tasks: list[TaskTime], cluster: ComputeCluster) -> Limited:
    free = (
        msgspec.structs.replace(task, cpu_s=0.0, read_bytes=0, written_bytes=0)
        if task.kind == "merge"
        else task
        for task in tasks
    )
    return list(free), cluster


def _divided(kind: Kind) -> Callable[[list[TaskTime], ComputeCluster], Limited]:
    """Divide tasks of a kind into as many pieces as there are workers, for the same total work.

    Tasks of each map are divided separately, because maps are made one after the other. The cost
    for the scheduler stays.
    """

    def divide(tasks: list[TaskTime], cluster: ComputeCluster) -> Limited:
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
    """Group tasks of a kind by their predecessors of other kinds, direct or not."""
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


LIMITS: dict[str, Callable[[list[TaskTime], ComputeCluster], Limited]] = {
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


KINDS: tuple[Kind, ...] = ("plan", "tile", "merge")


class ScalingRun(msgspec.Struct, frozen=True):
    """A measured run of a survey.

    Attributes:
        workers: number of workers.
        wall_s: wall time of all stages.
        tasks: cost of each task.
    """

    workers: int
    wall_s: float
    tasks: list[TaskTime]


class MeasuredRun(msgspec.Struct, frozen=True):
    """A measured run compared with its simulation.

    Attributes:
        workers: number of workers.
        wall_s: measured wall time.
        speedup: relative to the run with the fewest workers, times their number.
        cpu_s: CPU time of all tasks; it grows if workers obstruct each other.
        simulated_s: simulated wall time of the first run's tasks with that many workers.
    """

    workers: int
    wall_s: float
    speedup: float
    cpu_s: float
    simulated_s: float


class KindTimes(msgspec.Struct, frozen=True):
    """Totals of all tasks of one kind.

    Attributes:
        tasks: number of tasks.
        cpu_s: CPU time of all.
        longest_s: CPU time of the longest.
        read_bytes, written_bytes: bytes of all.
    """

    tasks: int
    cpu_s: float
    longest_s: float
    read_bytes: int
    written_bytes: int


class ScalingRecord(msgspec.Struct, frozen=True):
    """Content of `scaling.json`.

    Attributes:
        kinds: scheduled tasks by kind.
        scheduler_s: time of the scheduler for each task.
        storage_bytes_per_s: bandwidth for all workers; None is unlimited.
        link_bytes_per_s: bandwidth of a worker; None is unlimited.
        measured: measured runs, fewest workers first.
        steps: simulated runs.
    """

    kinds: dict[str, KindTimes]
    scheduler_s: float
    storage_bytes_per_s: float | None
    link_bytes_per_s: float | None
    measured: list[MeasuredRun]
    steps: list[Step]


class _StageTimes(msgspec.Struct):
    """The part of `survey.json` that is read here."""

    wall_s: dict[str, float]


def read_run(workers: int, path: Path) -> ScalingRun:
    """Read a survey's record.

    Raises:
        ValueError: the record is invalid.
    """
    tasks = read_task_times(path)
    try:
        wall_s = sum(msgspec.json.decode(path.read_bytes(), type=_StageTimes).wall_s.values())
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: no record of a survey: {error}") from error
    return ScalingRun(workers, wall_s, tasks)


def record_of(
    runs: Sequence[ScalingRun], cluster: ComputeCluster, steps: Sequence[Step]
) -> ScalingRecord:
    """Combine the measured runs and the simulations of the first one's tasks."""
    storage, link = cluster.storage_bytes_per_s, cluster.link_bytes_per_s
    return ScalingRecord(
        {kind: _times(runs[0].tasks, kind) for kind in KINDS},
        cluster.scheduler_s,
        None if storage == inf else storage,
        None if link == inf else link,
        [_measured(run, runs[0], cluster.scheduler_s) for run in runs],
        list(steps),
    )


def _times(tasks: Sequence[TaskTime], kind: Kind) -> KindTimes:
    those = [task for task in tasks if task.kind == kind]
    return KindTimes(
        len(those),
        sum(task.cpu_s for task in those),
        max((task.cpu_s for task in those), default=0.0),
        sum(task.read_bytes for task in those),
        sum(task.written_bytes for task in those),
    )


def _measured(run: ScalingRun, first: ScalingRun, scheduler_s: float) -> MeasuredRun:
    """Compare a run with its simulation, without storage limits of the local disk."""
    simulated = simulate(first.tasks, ComputeCluster(run.workers, scheduler_s))
    return MeasuredRun(
        run.workers,
        run.wall_s,
        first.workers * first.wall_s / run.wall_s,
        sum(task.cpu_s for task in run.tasks),
        simulated.wall_s,
    )


def tables(record: ScalingRecord) -> str:
    """Return the tables in Markdown."""
    return "\n\n".join([_tasks_table(record.kinds), _runs_table(record), _steps_table(record)])


def _tasks_table(kinds: Mapping[str, KindTimes]) -> str:
    rows = [
        f"| {kind} | {t.tasks} | {t.cpu_s:.1f} | {t.longest_s:.2f} | {t.read_bytes / 1e6:.0f} "
        f"| {t.written_bytes / 1e6:.0f} |"
        for kind, t in kinds.items()
    ]
    head = "| tasks | how many | CPU, s | longest, s | read, MB | written, MB |"
    return "\n".join([head, "|---|---|---|---|---|---|", *rows])


def _runs_table(record: ScalingRecord) -> str:
    rows = [
        f"| {run.workers} | {run.wall_s:.1f} | {run.simulated_s:.1f} | {run.speedup:.2f} "
        f"| {run.cpu_s:.1f} |"
        for run in record.measured
    ]
    head = "| workers, measured | time, s | simulated, s | speed-up | CPU of all tasks, s |"
    return "\n".join([head, "|---|---|---|---|---|", *rows])


def _steps_table(record: ScalingRecord) -> str:
    rows = []
    for step in record.steps:
        saved = step.saved.get(step.bottleneck, 0.0)
        rows.append(
            f"| {step.workers} | {step.wall_s:.1f} | {step.speedup:.1f} "
            f"| {step.efficiency:.1%} | {step.bottleneck} | {saved:.0%} |"
        )
    head = "| workers, simulated | time, s | speed-up | of the workers | bottleneck | costs |"
    return "\n".join([head, "|---|---|---|---|---|---|", *rows])


COLOURS = {name: f"C{k}" for k, name in enumerate((*LIMITS, "none alone"))}
PICTURE_INCHES = (11.0, 4.6)
DPI = 110


def draw_scaling(record: ScalingRecord, path: Path) -> None:
    """Draw the speed-up over workers, and its limits, to a file; atomic.

    Raises:
        ImportError: matplotlib is not installed.
    """
    import matplotlib as mpl  # noqa: PLC0415 an extra

    mpl.use("agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    figure, (left, right) = plt.subplots(1, 2, figsize=PICTURE_INCHES, layout="constrained")
    _draw_speedups(left, record)
    _draw_limits(right, record)
    unfinished = path.with_name(f"{path.stem}.part{path.suffix}")
    figure.savefig(unfinished, dpi=DPI)
    plt.close(figure)
    unfinished.replace(path)


def _draw_speedups(axes: Any, record: ScalingRecord) -> None:  # noqa: ANN401 an extra
    workers = [step.workers for step in record.steps]
    axes.plot(workers, workers, ":", color="0.5", label="ideal")
    axes.plot(workers, [step.speedup for step in record.steps], "-", color="0.3", label="simulated")
    for name, colour in COLOURS.items():
        there = [step for step in record.steps if step.bottleneck == name]
        if there:
            speedups = [step.speedup for step in there]
            label = f"bottleneck: {name}"
            axes.plot([s.workers for s in there], speedups, "o", color=colour, label=label)
    measured = record.measured
    speedups = [run.speedup for run in measured]
    axes.plot([run.workers for run in measured], speedups, "kx", ms=9, mew=2, label="measured")
    axes.set(xscale="log", yscale="log", xlabel="workers", ylabel="speed-up")
    axes.set_title("How much faster than one worker")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize="small")


def _draw_limits(axes: Any, record: ScalingRecord) -> None:  # noqa: ANN401 an extra
    workers = [step.workers for step in record.steps]
    for name in LIMITS:
        saved = [100.0 * max(step.saved.get(name, 0.0), 0.0) for step in record.steps]
        axes.plot(workers, saved, "o-", ms=4, color=COLOURS[name], label=name)
    axes.set(xscale="log", xlabel="workers", ylabel="part of the time, %", ylim=(0.0, 100.0))
    axes.set_title("What each limit alone costs")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize="small")
