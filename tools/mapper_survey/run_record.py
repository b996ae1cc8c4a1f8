"""The record of a run in `survey.json`: its dives, its tasks, and their times."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from mapper_survey.merging import MergeResult
from mapper_survey.planning import DivePlan
from mapper_survey.spool import NO_TIME, Rows
from mapper_survey.tiles import TileResult

__all__ = ["PAUSE_S", "dive_record", "map_times", "plan_times", "recorded_s"]


Kind = Literal["plan", "tile", "merge"]


class TaskTime(msgspec.Struct, frozen=True, kw_only=True):
    """Cost of one successful task.

    Attributes:
        kind: step of the survey.
        name: unique name of the task.
        cpu_s: CPU time, user and system, without waiting for disk or network.
        read_bytes, written_bytes: through the survey's folder and from the recordings.
        after: names of its predecessors.
    """

    kind: Kind
    name: str
    cpu_s: float
    read_bytes: int
    written_bytes: int
    after: tuple[str, ...] = ()


class _TaskRecords(msgspec.Struct):
    """The part of `survey.json` that is read here."""

    tasks: list[TaskTime]


def read_task_times(path: Path) -> list[TaskTime]:
    """Return the tasks of a `survey.json`, each after its predecessors.

    Raises:
        ValueError: the record is invalid or its tasks are inconsistent; the text names the place.
    """
    try:
        record = msgspec.json.decode(path.read_bytes(), type=_TaskRecords)
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: no record of a survey: {error}") from error
    try:
        return in_order(record.tasks)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def in_order(tasks: Sequence[TaskTime]) -> list[TaskTime]:
    """Return the tasks, each after its predecessors, otherwise in the given order.

    Raises:
        ValueError: a duplicate name, a missing predecessor, a cycle, or a negative or infinite
            number.
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


PAUSE_S = 10.0
"""Time without a ping above which it is a pause; no mapping sonar is that slow."""


def dive_record(plan: DivePlan) -> dict[str, Any]:
    """Return the summary of a dive, for people."""
    of_dive: dict[str, Any] = msgspec.to_builtins(plan)
    del of_dive["bearings"]
    return of_dive


def recorded_s(rows: Rows) -> float:
    """Return the time covered by a dive's pings, without pauses."""
    gaps_ns = np.diff(np.sort(rows["t_ns"][rows["t_ns"] != NO_TIME]))
    return float(gaps_ns[gaps_ns <= PAUSE_S * 1e9].sum()) / 1e9


def plan_times(plans: Sequence[DivePlan]) -> list[TaskTime]:
    """Return the cost of planning."""
    return [_time_of("plan", plan.name, plan) for plan in plans]


def map_times(
    results: Sequence[TileResult], merged: MergeResult, before: tuple[str, ...]
) -> list[TaskTime]:
    """Return the cost of one map's tiles and of their merge.

    Args:
        results: results of all tiles, including those that were cut.
        merged: result of the merge.
        before: names of their predecessors.
    """
    names = [_short(result.shard) for result in results]
    cut = {name for name, result in zip(names, results, strict=True) if result.too_large}
    tiles = [
        _time_of("tile", name, result, _waited_for(name, cut, before))
        for name, result in zip(names, results, strict=True)
    ]
    return [*tiles, _time_of("merge", merged.name, merged, tuple(tile.name for tile in tiles))]


def _waited_for(name: str, cut: set[str], before: tuple[str, ...]) -> tuple[str, ...]:
    """Return the predecessors of a tile: for a part of a cut tile that tile, otherwise `before`."""
    parent = _parent(name)
    return (f"tile/{parent}",) if parent in cut else before


def _short(shard: str) -> str:
    """Return a tile's name without its fingerprint."""
    return shard.removeprefix("shards/").rsplit(".", 2)[0]


def _parent(name: str) -> str:
    """Return the name of the tile of twice the edge around a tile."""
    scope, at, tile = name.rpartition("@")
    *key, edge = (int(number) for number in tile.split("_"))
    return f"{scope}{at}{'_'.join(str(k // 2) for k in key)}_{2 * edge}"


def _time_of(
    kind: Kind,
    name: str,
    took: DivePlan | TileResult | MergeResult,
    after: tuple[str, ...] = (),
) -> TaskTime:
    return TaskTime(
        kind=kind,
        name=f"{kind}/{name}",
        cpu_s=took.cpu_s,
        read_bytes=took.read_bytes,
        written_bytes=took.written_bytes,
        after=after,
    )
