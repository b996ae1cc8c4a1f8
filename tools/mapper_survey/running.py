"""Runs a survey: plan, tiles, merge. Finished work is not repeated."""

import contextlib
import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TextIO

import msgspec

from mapper_survey.engine import Engine
from mapper_survey.errors import SurveyError
from mapper_survey.fingerprint import digest_of
from mapper_survey.folder import Folder, crc_of, held, mark, marked
from mapper_survey.memory import edge_for, edge_within, voxel_bytes_of
from mapper_survey.merging import MergeResult, MergeTask, merge_shards
from mapper_survey.planning import DivePlan, index_name, mark_name, plan_all, rows_of, spool_name
from mapper_survey.request import Request
from mapper_survey.run_record import dive_record, map_times, plan_times, recorded_s
from mapper_survey.tiles import Scope, TileResult, TileStage, shard_mark
from mapperd import __version__
from mapperd.cli.progress import ProgressBar
from mapperd.errors import ExportError
from mapperd.io import lock_file

__all__ = [
    "DIVES",
    "MAP",
    "RECORD",
    "RunOptions",
    "dive_map",
    "plan_survey",
    "run_survey",
    "was_begun",
]

Show = Callable[[float, int], None]

MAP = "map.db"
DIVES = "dives"
RECORD = "survey.json"


class RunOptions(msgspec.Struct, frozen=True):
    """Options of a run.

    Attributes:
        memory_bytes: memory of a worker.
        by_dive: also make a map of each dive.
    """

    memory_bytes: int
    by_dive: bool = False


SUFFIXES = (".db", ".spool", ".npy", ".json")
"""Suffixes of files that a run makes, including marks."""

BESIDE = ("-journal", "-wal", "-shm")
"""Suffixes of SQLite's files beside one being written; beside another file they do harm."""

FINGERPRINTED = re.compile(r"\.[0-9a-f]{24}\.[a-z]+$")
"""Names that only a run gives: an interrupted run may leave such a file without its mark."""


class _Merged(msgspec.Struct, frozen=True):
    key: str
    result: MergeResult


def dive_map(dive: str) -> str:
    """Return the name of the map of one dive."""
    return f"{DIVES}/{dive}.db"


def was_begun(folder: Folder) -> bool:
    """Return whether a survey was run into a folder, finished or not."""
    return any(FINGERPRINTED.search(name) for name in folder.names("plan"))


def plan_survey(request: Request, folder: Folder, engine: Engine, out: TextIO) -> dict[str, Any]:
    """Only plan the dives; return their records."""
    with _alone(folder):
        folder.forget_workspaces()
        with _bar("plan", out) as show:
            plans = plan_all(request, folder, engine, show)
        return {"dives": [dive_record(plan) for plan in plans]}


def run_survey(
    request: Request, folder: Folder, engine: Engine, options: RunOptions, out: TextIO
) -> dict[str, Any]:
    """Make the map of all dives; return the content of `survey.json`.

    Raises:
        SurveyError: another process uses the folder, or a task fails.
    """
    resolution_m = request.config.octree.voxel_resolution
    max_bytes = voxel_bytes_of(options.memory_bytes, resolution_m)
    edge = edge_for(request.config, max_bytes, request.survey.tile_size_m)
    with _alone(folder):
        return _Running(request, folder, engine, out).run(edge, max_bytes, by_dive=options.by_dive)


class _Running:
    def __init__(self, request: Request, folder: Folder, engine: Engine, out: TextIO) -> None:
        self._request = request
        self._folder = folder
        self._engine = engine
        self._out = out
        self._times = plan_times([])
        self._wall_s: dict[str, float] = {}
        self._shards: set[str] = set()

    def run(self, edge: int, max_bytes: int, *, by_dive: bool) -> dict[str, Any]:
        self._folder.forget_workspaces()
        with self._stage("plan") as show:
            plans = plan_all(self._request, self._folder, self._engine, show)
        self._times += plan_times(plans)
        rows = [rows_of(self._folder, plan) for plan in plans]
        edge = edge_within(edge, rows, self._request.config, max_bytes)
        whole = Scope("", plans, rows)
        alone = [Scope(p.name, [p], [r]) for p, r in zip(plans, rows, strict=True)]
        scopes = [whole, *(alone if by_dive else [])]
        before = tuple(task.name for task in self._times)
        maps = []
        for scope in scopes:
            maps.append(self._map_of(scope, edge, max_bytes, before))
            before = (self._times[-1].name,)  # of the merge: the next map starts after it
        self._forget_others(plans, [each["map"] for each in maps])
        record = self._record(plans, maps, whole, edge)
        self._folder.write(RECORD, msgspec.json.format(msgspec.json.encode(record), indent=2))
        return record

    def _map_of(
        self, scope: Scope, edge: int, max_bytes: int, before: tuple[str, ...]
    ) -> dict[str, Any]:
        stage = TileStage(scope, self._request.config, self._folder, edge, max_bytes)
        suffix = f" {scope.name}" if scope.name else ""
        with self._stage(f"tiles{suffix}") as show:
            shards = stage.run(self._engine, show)
        results = sorted(stage.results, key=lambda result: (-result.pings, result.shard))
        self._shards.update(result.shard for result in results)
        with self._stage(f"merge{suffix}", "shards") as show:
            merged = self._merged(scope, shards, show)
        self._times += map_times(results, merged, before)
        return {
            "map": merged.name,
            "pings": scope.pings,
            "bricks": merged.bricks,
            "tiles": len(shards),
            "tiles_cut": sum(result.too_large for result in results),
            "largest_tile_bytes": max((each.voxel_bytes for each in results), default=0),
        }

    def _merged(self, scope: Scope, shards: Sequence[str], show: Show) -> MergeResult:
        name = dive_map(scope.name) if scope.name else MAP
        key = digest_of(str(scope.pings), *shards)
        record_name = _record_name(name)
        before = marked(self._folder, record_name, _Merged)
        if before is not None and before.key == key and self._is_whole(before.result):
            return before.result
        config = self._request.config
        task = MergeTask(name, list(shards), config, scope.pings, self._folder.url)
        for outdated in (RECORD, record_name):  # of the map that the merged one replaces
            self._folder.remove(outdated)
        for suffix in BESIDE:
            self._folder.remove(f"{name}{suffix}")
        result = merge_shards(task, show)
        mark(self._folder, record_name, _Merged(key, result))
        return result

    def _is_whole(self, merged: MergeResult) -> bool:
        """Return whether a map's file is unchanged since the merge."""
        if any(self._folder.has(f"{merged.name}{suffix}") for suffix in BESIDE):
            return False
        if not self._folder.has(merged.name):
            return False
        if self._folder.size_of(merged.name) != merged.written_bytes:
            return False
        with self._folder.open(merged.name) as file:
            return crc_of(file) == merged.crc

    def _forget_others(self, plans: Sequence[DivePlan], maps: Sequence[str]) -> None:
        """Remove results of earlier runs with other inputs."""
        wanted = self._shards | {shard_mark(shard) for shard in self._shards}
        for plan in plans:
            wanted |= {spool_name(plan), index_name(plan), mark_name(plan)}
        for name in maps:
            wanted |= {name, _record_name(name)}
        ours = [
            name
            for part, kind in (("shards", TileResult), ("plan", DivePlan), (DIVES, _Merged))
            for name in self._folder.names(part) - wanted
            if name.endswith(SUFFIXES) and _is_ours(self._folder, name, kind)
        ]
        if any(name.startswith(f"{DIVES}/") for name in ours):
            self._folder.remove(RECORD)  # it describes them
        for name in sorted(ours, key=lambda name: name.endswith(".json")):  # the marks last
            self._folder.remove(name)

    def _record(
        self, plans: Sequence[DivePlan], maps: list[dict[str, Any]], whole: Scope, edge: int
    ) -> dict[str, Any]:
        first = [plan.first_ns for plan in plans if plan.first_ns is not None]
        return {
            "version": __version__,
            "pings": whole.pings,
            "recorded_s": sum(recorded_s(rows) for rows in whole.rows),
            "first_ns": min(first, default=None),
            "tile_bricks": edge,
            "origin": self._request.survey.origin,
            "settings": self._request.config,
            "outputs": self._request.survey.outputs,
            "wall_s": self._wall_s,
            "dives": [dive_record(plan) for plan in plans],
            "maps": maps,
            "tasks": self._times,
        }

    @contextlib.contextmanager
    def _stage(self, name: str, unit: str = "pings") -> Iterator[Show]:
        began_s = time.perf_counter()
        with _bar(name, self._out, unit) as show:
            yield show
        self._wall_s[name] = round(time.perf_counter() - began_s, 3)


@contextlib.contextmanager
def _bar(stage: str, out: TextIO, unit: str = "pings") -> Iterator[Show]:
    bar = ProgressBar(out, time.perf_counter, f"mapper-survey {stage}", unit)
    last = 0

    def show(fraction: float, count: int) -> None:
        nonlocal last
        last = count
        bar.show(fraction, count)

    yield show
    bar.close(last)


def _is_ours(folder: Folder, name: str, kind: type[msgspec.Struct]) -> bool:
    """Return whether a run made a file; a user's recordings may lie in such folders too."""
    if FINGERPRINTED.search(name):
        return True
    return marked(folder, f"{name.rpartition('.')[0]}.json", kind) is not None


@contextlib.contextmanager
def _alone(folder: Folder) -> Iterator[None]:
    """Hold a lock that ends with the process; on other storage than disks use a file."""
    if folder.local is None:
        with held(folder):
            yield
        return
    try:
        folder.local.mkdir(parents=True, exist_ok=True)
        handle = lock_file(folder.local / ".lock", mode=0o666)
    except PermissionError as error:
        raise ExportError(f"{folder.url}: cannot be written into: {error.strerror}") from error
    except BlockingIOError as error:
        raise SurveyError(f"{folder.url}: another mapper-survey is at work") from error
    try:
        yield
    finally:
        os.close(handle)


def _record_name(map_name: str) -> str:
    """Return the name of the record of a map's file."""
    return f"{map_name.removesuffix('.db')}.json"
