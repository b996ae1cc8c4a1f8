"""What a run tells in its `survey.json` of dives, times and tasks."""

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from mapper_survey.merging import MergeResult
from mapper_survey.planning import DivePlan
from mapper_survey.spool import NO_TIME, Rows
from mapper_survey.task_times import Kind, TaskTime
from mapper_survey.tile_task import TileResult

__all__ = ["PAUSE_S", "map_times", "plan_times", "recorded_s", "told"]

PAUSE_S = 10.0
"""A longer time without a ping is a pause: no sonar that maps is as slow."""


def told(plan: DivePlan) -> dict[str, Any]:
    """Of a dive, for a person."""
    of_dive: dict[str, Any] = msgspec.to_builtins(plan)
    del of_dive["bearings"]
    return of_dive


def recorded_s(rows: Rows) -> float:
    """For how long a dive's pings came: from each to the next, without the pauses."""
    gaps_ns = np.diff(np.sort(rows["t_ns"][rows["t_ns"] != NO_TIME]))
    return float(gaps_ns[gaps_ns <= PAUSE_S * 1e9].sum()) / 1e9


def plan_times(plans: Sequence[DivePlan]) -> list[TaskTime]:
    """What planning took."""
    return [_time_of("plan", plan.name, plan) for plan in plans]


def map_times(
    results: Sequence[TileResult], merged: MergeResult, before: tuple[str, ...]
) -> list[TaskTime]:
    """What one map's tiles and their merge took.

    Args:
        results: of all tiles, those that were cut with them.
        merged: of the merge.
        before: names of the tasks that all of these waited for.
    """
    names = [_short(result.shard) for result in results]
    cut = {name for name, result in zip(names, results, strict=True) if result.too_large}
    tiles = [
        _time_of("tile", name, result, _waited_for(name, cut, before))
        for name, result in zip(names, results, strict=True)
    ]
    return [*tiles, _time_of("merge", merged.name, merged, tuple(tile.name for tile in tiles))]


def _waited_for(name: str, cut: set[str], before: tuple[str, ...]) -> tuple[str, ...]:
    """A part of a tile that was cut is not known before that has been tried."""
    parent = _parent(name)
    return (f"tile/{parent}",) if parent in cut else before


def _short(shard: str) -> str:
    """A tile's name without what it was made of."""
    return shard.removeprefix("shards/").rsplit(".", 2)[0]


def _parent(name: str) -> str:
    """Name of the tile of twice the edge that holds one."""
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
