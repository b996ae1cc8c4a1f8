"""What the scaling report says, as JSON and as tables."""

from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path

import msgspec

from mapper_survey.cluster_simulation import Cluster, simulate
from mapper_survey.scaling import Step
from mapper_survey.task_times import Kind, TaskTime, read_task_times

KINDS: tuple[Kind, ...] = ("plan", "tile", "merge")


class Run(msgspec.Struct, frozen=True):
    """A survey that was run.

    Attributes:
        workers: of one task at a time each.
        wall_s: of all its stages.
        tasks: what each took.
    """

    workers: int
    wall_s: float
    tasks: list[TaskTime]


class Measured(msgspec.Struct, frozen=True):
    """A run beside its simulation.

    Attributes:
        workers: how many.
        wall_s: measured.
        speedup: against the run with the fewest workers, times their number.
        cpu_s: of all tasks; more than with one worker where they are in each other's way.
        simulated_s: wall time of the first run's tasks on so many workers.
    """

    workers: int
    wall_s: float
    speedup: float
    cpu_s: float
    simulated_s: float


class KindTimes(msgspec.Struct, frozen=True):
    """All tasks of one kind.

    Attributes:
        tasks: how many.
        cpu_s: of all.
        longest_s: of one.
        read_bytes, written_bytes: of all.
    """

    tasks: int
    cpu_s: float
    longest_s: float
    read_bytes: int
    written_bytes: int


class ScalingRecord(msgspec.Struct, frozen=True):
    """All that `scaling.json` holds.

    Attributes:
        kinds: the tasks that are scheduled.
        scheduler_s: for each task.
        storage_bytes_per_s: of all workers together; none is without a bound.
        link_bytes_per_s: of a worker; none is without a bound.
        measured: runs, of the fewest workers first.
        steps: simulated.
    """

    kinds: dict[str, KindTimes]
    scheduler_s: float
    storage_bytes_per_s: float | None
    link_bytes_per_s: float | None
    measured: list[Measured]
    steps: list[Step]


class _Told(msgspec.Struct):
    """The part of `survey.json` that is read here."""

    wall_s: dict[str, float]


def read_run(workers: int, path: Path) -> Run:
    """Read a survey's record.

    Raises:
        ValueError: the file is no such record.
    """
    tasks = read_task_times(path)
    try:
        wall_s = sum(msgspec.json.decode(path.read_bytes(), type=_Told).wall_s.values())
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: no record of a survey: {error}") from error
    return Run(workers, wall_s, tasks)


def record_of(runs: Sequence[Run], cluster: Cluster, steps: Sequence[Step]) -> ScalingRecord:
    """Put the runs, and what was simulated of the first one's tasks, together."""
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


def _measured(run: Run, first: Run, scheduler_s: float) -> Measured:
    """The machine's own disk is no shared storage: what it takes is in the tasks' CPU times."""
    simulated = simulate(first.tasks, Cluster(run.workers, scheduler_s))
    return Measured(
        run.workers,
        run.wall_s,
        first.workers * first.wall_s / run.wall_s,
        sum(task.cpu_s for task in run.tasks),
        simulated.wall_s,
    )


def tables(record: ScalingRecord) -> str:
    """For a page in Markdown."""
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
