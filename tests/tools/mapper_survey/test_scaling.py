"""Which limit is named: in surveys made so that it is known."""

import pytest
from mapper_survey.cluster_simulation import ComputeCluster, simulate
from mapper_survey.run_record import Kind, TaskTime
from mapper_survey.scaling import LIMITS, scaling, without


def survey(
    plan_s: tuple[float, ...] = (1.0,) * 10,
    tile_s: tuple[float, ...] = (1.0,) * 200,
    merge_s: float = 0.1,
    *,
    tile_bytes: int = 0,
) -> list[TaskTime]:
    plans = [
        TaskTime(kind="plan", name=f"plan {k}", cpu_s=s, read_bytes=0, written_bytes=0)
        for k, s in enumerate(plan_s)
    ]
    before = tuple(task.name for task in plans)
    tiles = [
        TaskTime(
            kind="tile",
            name=f"tile {k}",
            cpu_s=s,
            read_bytes=tile_bytes,
            written_bytes=0,
            after=before,
        )
        for k, s in enumerate(tile_s)
    ]
    merge = TaskTime(
        kind="merge",
        name="merge",
        cpu_s=merge_s,
        read_bytes=0,
        written_bytes=0,
        after=tuple(task.name for task in tiles),
    )
    return [*plans, *tiles, merge]


def bottleneck(tasks: list[TaskTime], workers: int, cluster: ComputeCluster | None = None) -> str:
    return scaling(tasks, cluster or ComputeCluster(1), [workers])[0].bottleneck


def test_few_workers_are_the_bottleneck_and_the_speedup_is_their_number() -> None:
    steps = scaling(survey(), ComputeCluster(1), [1, 2, 10])
    assert [step.bottleneck for step in steps] == ["workers"] * 3
    assert [step.speedup for step in steps] == pytest.approx([1, 2, 10], rel=0.01)
    assert [step.efficiency for step in steps] == pytest.approx([1, 1, 1], rel=0.01)


@pytest.mark.slow
def test_each_other_bottleneck_is_named() -> None:
    assert bottleneck(survey(plan_s=(40.0, *(1.0,) * 9)), 1000) == "recordings"
    assert bottleneck(survey(tile_s=(40.0, *(1.0,) * 199)), 1000) == "tiles"
    assert bottleneck(survey(merge_s=30.0), 1000) == "merge"
    heavy = survey(tile_bytes=1000)
    assert bottleneck(heavy, 1000, ComputeCluster(1, storage_bytes_per_s=5000.0)) == "storage"
    assert bottleneck(heavy, 1000, ComputeCluster(1, link_bytes_per_s=100.0)) == "links"
    assert bottleneck(survey(), 1000, ComputeCluster(1, scheduler_s=0.1)) == "scheduler"


def test_a_survey_without_work_has_no_bottleneck() -> None:
    step = scaling(survey((0.0,), (0.0,), 0.0), ComputeCluster(1), [10])[0]
    assert (step.bottleneck, step.speedup) == ("none alone", 1.0)


def test_what_a_limit_costs_is_what_its_absence_saves() -> None:
    step = scaling(survey(merge_s=18.0), ComputeCluster(1), [1000])[0]
    assert step.wall_s == pytest.approx(1.0 + 1.0 + 18.0)
    assert step.saved["merge"] == pytest.approx(18.0 / 20.0)
    assert step.saved["scheduler"] == 0.0


@pytest.mark.parametrize("workers", [1, 3, 30])
def test_tasks_in_pieces_are_the_same_work_and_keep_their_places(workers: int) -> None:
    tasks, cluster = survey((4.0, 2.0), (3.0, 9.0), 1.0, tile_bytes=77), ComputeCluster(workers)
    for limit in ("recordings", "tiles"):
        went = without(limit, tasks, cluster)
        assert went.computing_s == pytest.approx(19.0)
        assert went.moved_bytes == pytest.approx(2 * 77, abs=workers)
        assert went.ended_s["merge"] == went.wall_s
    assert without("tiles", tasks, cluster).ended_s["merge"] == pytest.approx(
        (6.0 if workers == 1 else 4.0) + 12.0 / workers + 1.0
    )
    if workers > 1:
        assert without("recordings", tasks, cluster).wall_s == pytest.approx(6.0 / workers + 10.0)


@pytest.mark.parametrize("limit", LIMITS)
def test_no_survey_is_slower_without_a_limit_where_workers_share_nothing(limit: str) -> None:
    tasks = survey(tuple(float(k) for k in range(10)), merge_s=2.0, tile_bytes=1000)
    cluster = ComputeCluster(50, 0.001, link_bytes_per_s=1e4)
    assert scaling(tasks, cluster, [50])[0].saved[limit] >= -1e-9


def task(kind: Kind, name: str, cpu_s: float, *after: str) -> TaskTime:
    return TaskTime(kind=kind, name=name, cpu_s=cpu_s, read_bytes=0, written_bytes=0, after=after)


def two_maps() -> list[TaskTime]:
    """A map of a tile that was cut in two, and after it that of a dive of two tiles."""
    return [
        task("plan", "plan", 2.0),
        task("tile", "whole", 3.0, "plan"),
        task("tile", "half", 4.0, "whole"),
        task("tile", "other half", 1.0, "whole"),
        task("merge", "merge", 0.5, "half", "other half", "whole"),
        task("tile", "dive's large", 6.0, "merge"),
        task("tile", "dive's small", 2.0, "merge"),
        task("merge", "merge dive", 0.25, "dive's large", "dive's small"),
    ]


@pytest.mark.parametrize("tasks", [two_maps(), two_maps()[::-1]])
def test_maps_that_are_made_one_after_the_other_stay_so_in_pieces(tasks: list[TaskTime]) -> None:
    assert simulate(tasks, ComputeCluster(9)).wall_s == pytest.approx(2 + 3 + 4 + 0.5 + 6 + 0.25)
    went = without("tiles", tasks, ComputeCluster(4))
    assert went.ended_s["merge"] == pytest.approx(2.0 + 8.0 / 4 + 0.5)
    assert went.wall_s == pytest.approx(4.5 + 8.0 / 4 + 0.25)
    assert without("recordings", tasks, ComputeCluster(4)).wall_s == pytest.approx(0.5 + 13.75)
    assert went.computing_s == pytest.approx(18.75)
