"""The simulated cluster against cases whose answer is known without it."""

from heapq import heapify, heapreplace
from math import inf

import numpy as np
import pytest
from mapper_survey.cluster_simulation import ComputeCluster, simulate
from mapper_survey.run_record import Kind, TaskTime


def task(
    name: str,
    cpu_s: float = 0.0,
    read: int = 0,
    written: int = 0,
    *,
    after: tuple[str, ...] = (),
    kind: Kind = "tile",
) -> TaskTime:
    return TaskTime(
        kind=kind, name=name, cpu_s=cpu_s, read_bytes=read, written_bytes=written, after=after
    )


def alike(count: int, cpu_s: float = 0.0, read: int = 0, written: int = 0) -> list[TaskTime]:
    return [task(f"tile {k}", cpu_s, read, written) for k in range(count)]


@pytest.mark.parametrize("workers", [1, 2, 3, 7, 10, 1000])
def test_equal_tasks_take_whole_rounds(workers: int) -> None:
    went = simulate(alike(10, cpu_s=3.0), ComputeCluster(workers))
    assert went.wall_s == -(-10 // workers) * 3.0
    assert went.computing_s == 30.0


def test_one_huge_task_is_the_least_that_a_survey_takes() -> None:
    went = simulate([task("huge", 50.0), *alike(100, cpu_s=0.1)], ComputeCluster(100))
    assert went.wall_s == 50.0


def test_a_task_waits_for_others() -> None:
    tasks = [
        task("merge", 1.0, after=("a", "b"), kind="merge"),
        task("a", 2.0, after=("plan",)),
        task("b", 5.0, after=("plan",)),
        task("plan", 3.0, kind="plan"),
    ]
    went = simulate(tasks, ComputeCluster(8))
    assert went.ended_s == {"plan": 3.0, "a": 5.0, "b": 8.0, "merge": 9.0}
    assert simulate(tasks, ComputeCluster(1)).wall_s == 11.0


@pytest.mark.parametrize("workers", [1, 4, 40])
def test_storage_is_shared_alike_and_never_carries_more_than_it_can(workers: int) -> None:
    tasks = alike(40, read=30, written=20)
    assert simulate(
        tasks, ComputeCluster(workers, storage_bytes_per_s=100.0)
    ).wall_s == pytest.approx(20)


def test_a_link_holds_its_own_worker_back_and_no_other() -> None:
    tasks = alike(4, read=100)
    link = {"link_bytes_per_s": 50.0}
    assert simulate(tasks, ComputeCluster(1, **link)).wall_s == pytest.approx(8.0)
    assert simulate(tasks, ComputeCluster(4, **link)).wall_s == pytest.approx(2.0)
    both = ComputeCluster(4, storage_bytes_per_s=100.0, link_bytes_per_s=50.0)
    assert simulate(tasks, both).wall_s == pytest.approx(4.0)


def test_a_transfer_goes_faster_when_another_one_is_over() -> None:
    tasks = [task("short", read=100), task("long", read=300)]
    went = simulate(tasks, ComputeCluster(2, storage_bytes_per_s=100.0))
    assert went.ended_s == pytest.approx({"short": 2.0, "long": 4.0})


def test_a_transfer_that_begins_later_slows_one_that_goes_on() -> None:
    tasks = [task("long", read=300), task("late", cpu_s=1.0, written=100)]
    went = simulate(tasks, ComputeCluster(2, storage_bytes_per_s=100.0))
    assert went.ended_s == pytest.approx({"long": 4.0, "late": 3.0})


def test_reading_of_one_goes_on_while_another_computes() -> None:
    tasks = alike(2, cpu_s=1.0, read=100)
    assert simulate(tasks, ComputeCluster(2, storage_bytes_per_s=100.0)).wall_s == pytest.approx(
        3.0
    )
    assert simulate(tasks, ComputeCluster(1, storage_bytes_per_s=100.0)).wall_s == pytest.approx(
        4.0
    )


def test_the_scheduler_hands_out_one_task_after_another() -> None:
    went = simulate(alike(100, cpu_s=0.5), ComputeCluster(1000, scheduler_s=0.1))
    assert went.wall_s == pytest.approx(100 * 0.1 + 0.5)
    assert went.scheduling_s == pytest.approx(10.0)


def test_a_scheduler_faster_than_the_workers_costs_each_round_its_own_time() -> None:
    went = simulate(alike(5, cpu_s=2.0), ComputeCluster(1, scheduler_s=0.25))
    assert went.wall_s == pytest.approx(5 * 2.25)


@pytest.mark.parametrize("workers", [1, 3, 16])
def test_tasks_of_any_length_go_to_the_worker_that_is_free_first(workers: int) -> None:
    lengths_s = np.random.default_rng(workers).exponential(1.0, 200).tolist()
    free_s = [0.0] * workers
    heapify(free_s)
    for length_s in lengths_s:
        heapreplace(free_s, free_s[0] + length_s)
    tasks = [task(f"tile {k}", length_s) for k, length_s in enumerate(lengths_s)]
    assert simulate(tasks, ComputeCluster(workers)).wall_s == pytest.approx(max(free_s))


@pytest.mark.parametrize("seed", range(5))
def test_no_survey_is_faster_than_any_of_its_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tasks = [
        task(
            f"tile {k}",
            float(rng.exponential()),
            int(rng.integers(1000)),
            int(rng.integers(1000)),
            after=tuple({f"tile {rng.integers(k)}" for _ in range(2)}) if k else (),
        )
        for k in range(100)
    ]
    cluster = ComputeCluster(7, 0.01, storage_bytes_per_s=5000.0, link_bytes_per_s=2000.0)
    went = simulate(tasks, cluster)
    assert went.wall_s >= went.computing_s / 7
    assert went.wall_s >= went.moved_bytes / 5000.0
    assert went.wall_s >= went.scheduling_s
    for reported in tasks:
        transfer_s = (reported.read_bytes + reported.written_bytes) / 2000.0
        began_s = max((went.ended_s[name] for name in reported.after), default=0.0)
        assert went.ended_s[reported.name] - began_s >= reported.cpu_s + transfer_s + 0.01 - 1e-9


@pytest.mark.parametrize(
    "wrong",
    [
        {"workers": 0},
        {"workers": 1, "scheduler_s": -1.0},
        {"workers": 1, "storage_bytes_per_s": 0.0},
        {"workers": 1, "link_bytes_per_s": -inf},
    ],
)
def test_a_cluster_that_cannot_be_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="a cluster"):
        ComputeCluster(**wrong)  # type: ignore[arg-type]
