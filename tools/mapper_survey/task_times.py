"""What each task of a survey took, as its `survey.json` holds it: the scaling report reads it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec

Kind = Literal["plan", "tile", "merge"]


class TaskTime(msgspec.Struct, frozen=True, kw_only=True):
    """One task, done once without a failure.

    Attributes:
        kind: which step of the survey.
        name: its own among all tasks.
        cpu_s: of its thread or process, user and system, without waiting for disk or network.
        read_bytes, written_bytes: through the survey's folder and from the recordings.
        after: names of the tasks that must have ended before it begins.
    """

    kind: Kind
    name: str
    cpu_s: float
    read_bytes: int
    written_bytes: int
    after: tuple[str, ...] = ()


class _Told(msgspec.Struct):
    """The part of `survey.json` that is read here."""

    tasks: list[TaskTime]


def read_task_times(path: Path) -> list[TaskTime]:
    """Tasks of a `survey.json`, each after those that it waits for.

    Raises:
        ValueError: the file is no such record, or its tasks make no sense; says where.
    """
    try:
        told = msgspec.json.decode(path.read_bytes(), type=_Told)
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: no record of a survey: {error}") from error
    try:
        return in_order(told.tasks)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def in_order(tasks: Sequence[TaskTime]) -> list[TaskTime]:
    """The same tasks, each after those that it waits for; otherwise in the order given.

    Raises:
        ValueError: a name twice, a wait for a task that is not there or in a circle, a negative
            or infinite number.
    """
    waits = {task.name: len(set(task.after)) for task in tasks}
    if len(waits) < len(tasks):
        twice = next(t.name for k, t in enumerate(tasks) if t.name in {u.name for u in tasks[:k]})
        raise ValueError(f"two tasks are called {twice!r}")
    next_ones: dict[str, list[TaskTime]] = {name: [] for name in waits}
    for task in tasks:
        _check(task)
        for name in set(task.after):
            if name not in waits:
                raise ValueError(f"{task.name!r} waits for {name!r}, which is not there")
            next_ones[name].append(task)
    done = [task for task in tasks if waits[task.name] == 0]
    for task in done:  # grows meanwhile
        for later in next_ones[task.name]:
            waits[later.name] -= 1
            if waits[later.name] == 0:
                done.append(later)
    if len(done) < len(tasks):
        stuck = next(name for name, left in waits.items() if left)
        raise ValueError(f"{stuck!r} waits for itself")
    return done


def _check(task: TaskTime) -> None:
    if not 0 <= task.cpu_s < float("inf") or min(task.read_bytes, task.written_bytes) < 0:
        raise ValueError(f"{task.name!r} has a negative or infinite time or size")
