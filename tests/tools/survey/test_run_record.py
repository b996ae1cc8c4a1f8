"""What `survey.json` tells of a run's tasks is the order in which they can be done."""

import json
from pathlib import Path

import pytest
from survey.cluster_simulation import Cluster, simulate
from survey.scaling import LIMITS, scaling
from survey.task_times import TaskTime, read_task_times

from tests.tools.survey.dives import run_here, write_survey


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run with maps of the dives, and tiles that were cut, some of them twice."""
    folder = tmp_path_factory.mktemp("survey")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("survey.running.voxel_bytes_of", lambda *_: 700_000)
        run_here(write_survey(folder, tile_size_m=25.6), folder / "out", by_dive=True)
    return folder / "out"


@pytest.fixture(scope="module")
def tasks(out: Path) -> list[TaskTime]:
    return read_task_times(out / "survey.json")


def place_of(name: str) -> tuple[str, tuple[int, ...], int]:
    """Scope of a tile, its corner in bricks, and its edge."""
    scope, _, tile = name.removeprefix("tile/").rpartition("@")
    *key, edge = map(int, tile.split("_"))
    return scope, tuple(k * edge for k in key), edge


def test_a_part_of_a_tile_waits_for_the_tile(tasks: list[TaskTime]) -> None:
    tiles = {task.name: task for task in tasks if task.kind == "tile"}
    largest = max(place_of(name)[2] for name in tiles)
    parts = 0
    for task in tiles.values():
        scope, corner, edge = place_of(task.name)
        if edge == largest:
            assert tiles.keys().isdisjoint(task.after)
            continue
        (parent,) = task.after
        its_scope, its_corner, its_edge = place_of(parent)
        assert (its_scope, its_edge) == (scope, 2 * edge)
        assert all(0 <= at - low < its_edge for at, low in zip(corner, its_corner, strict=True))
        parts += 1
    assert parts > 8
    assert min(place_of(name)[2] for name in tiles) < largest / 2
    assert any(min(place_of(name)[1]) < 0 for name in tiles)


def test_maps_are_made_one_after_the_other(tasks: list[TaskTime]) -> None:
    merges = [task for task in tasks if task.kind == "merge"]
    assert [merge.name for merge in merges] == [
        "merge/map.db",
        "merge/dives/a.db",
        "merge/dives/b.db",
    ]
    waited = {"": {"plan/a", "plan/b"}, "a": {"merge/map.db"}, "b": {"merge/dives/a.db"}}
    for merge, (scope, before) in zip(merges, waited.items(), strict=True):
        its = {t.name: t for t in tasks if t.kind == "tile" and place_of(t.name)[0] == scope}
        assert set(merge.after) == its.keys()
        firsts = [task for task in its.values() if its.keys().isdisjoint(task.after)]
        assert firsts
        assert all(set(task.after) == before for task in firsts)


def test_the_simulation_of_such_a_run_counts_each_task_once(tasks: list[TaskTime]) -> None:
    alone = simulate(tasks, Cluster(1))
    assert alone.wall_s == pytest.approx(sum(task.cpu_s for task in tasks))
    many = simulate(tasks, Cluster(1000))
    for task in tasks:
        began_s = many.ended_s[task.name] - task.cpu_s
        assert all(many.ended_s[name] <= began_s + 1e-9 for name in task.after)
    for step in scaling(tasks, Cluster(1), [1, 7, 1000]):
        assert step.saved.keys() == LIMITS.keys()
        assert step.speedup <= step.workers + 1e-9


def test_large_tiles_are_told_first_as_they_are_begun(out: Path, tasks: list[TaskTime]) -> None:
    firsts = [task.name for task in tasks if task.after[:1] == ("plan/a",)]
    marks = {f"tile/{path.name.split('.')[0]}": path for path in (out / "shards").glob("*.json")}
    pings = [json.loads(marks[name].read_bytes())["pings"] for name in firsts]
    assert len(set(pings)) > 2
    assert pings == sorted(pings, reverse=True)
