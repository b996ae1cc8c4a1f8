"""Contents of `survey.json`: tasks in a possible order, and the recorded time."""

import json
from pathlib import Path

import numpy as np
import pytest
from mapper_survey.cluster_simulation import ComputeCluster, simulate
from mapper_survey.run_record import PAUSE_S, TaskTime, read_task_times, recorded_s
from mapper_survey.scaling import LIMITS, scaling
from mapper_survey.spool import NO_TIME, ROW, Rows

from tests.tools.mapper_survey.dives import SECOND, START_NS, run_here, write_dive, write_survey


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run with maps of the dives, and tiles that were cut, some of them twice."""
    folder = tmp_path_factory.mktemp("survey")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mapper_survey.running.voxel_bytes_of", lambda *_: 400_000)
        patch.setattr("mapper_survey.running.edge_within", lambda edge, *_: edge)
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
    alone = simulate(tasks, ComputeCluster(1))
    assert alone.wall_s == pytest.approx(sum(task.cpu_s for task in tasks))
    many = simulate(tasks, ComputeCluster(1000))
    for task in tasks:
        began_s = many.ended_s[task.name] - task.cpu_s
        assert all(many.ended_s[name] <= began_s + 1e-9 for name in task.after)
    for step in scaling(tasks, ComputeCluster(1), [1, 7, 1000]):
        assert step.saved.keys() == LIMITS.keys()
        assert step.speedup <= step.workers + 1e-9


def test_large_tiles_are_reported_first_as_they_are_begun(out: Path, tasks: list[TaskTime]) -> None:
    firsts = [task.name for task in tasks if task.after[:1] == ("plan/a",)]
    marks = {f"tile/{path.name.split('.')[0]}": path for path in (out / "shards").glob("*.json")}
    pings = [json.loads(marks[name].read_bytes())["pings"] for name in firsts]
    assert len(set(pings)) > 2
    assert pings == sorted(pings, reverse=True)


def rows(*times_s: float | None) -> Rows:
    times = [NO_TIME if s is None else START_NS + round(s * SECOND) for s in times_s]
    return np.array([(t_ns, 0, 0, (0, 0, 0), (0, 0, 0)) for t_ns in times], dtype=ROW)


def test_pauses_are_not_counted_as_recorded() -> None:
    assert recorded_s(rows(0.0, 0.2, 0.6, 1.0)) == pytest.approx(1.0)
    assert recorded_s(rows(0.0, 1.0, 3601.0, 3603.5)) == pytest.approx(3.5)
    assert recorded_s(rows(0.0, PAUSE_S, 2 * PAUSE_S + 0.1)) == pytest.approx(PAUSE_S)
    assert recorded_s(rows(5.0, None, 4.0, 6.0)) == pytest.approx(2.0)
    assert recorded_s(rows(7.0)) == recorded_s(rows(None)) == recorded_s(rows()) == 0.0


def test_sessions_an_hour_apart_are_as_long_as_they_are(tmp_path: Path) -> None:
    dives = [{"name": name, "recording": name} for name in ("day", "c.mcap")]
    survey = write_survey(tmp_path, dives=dives)
    write_dive(tmp_path / "day/1.mcap", 1, pings=6)
    write_dive(tmp_path / "day/2.mcap", 1, pings=11, begin_s=3600.0)
    write_dive(tmp_path / "c.mcap", 2, pings=4)
    record = run_here(survey, tmp_path / "out")
    assert record["pings"] == 21
    assert record["recorded_s"] == pytest.approx(0.2 * (5 + 10 + 3))
