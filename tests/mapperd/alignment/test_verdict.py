"""When a result is used: each rule of the verdict, on graphs with known answers."""

from dataclasses import replace

import numpy as np
import pytest

from mapperd.alignment.align import MIN_LOOPS, _judge
from mapperd.alignment.pose_graph import PoseGraph, PositionFix
from tests.mapperd.alignment.test_pose_graph import circle, graph_of, loop_of, revisits


def solved(graph: PoseGraph, odometry_deviation_m: float = 1.0) -> str:
    graph.solve()
    graph.prepare_covariances()
    return _judge(graph, odometry_deviation_m)[1]


def odometry_deviation_m() -> float:
    graph = graph_of(circle())
    graph.solve()
    graph.prepare_covariances()
    return _judge(graph, 1.0)[0]["deviation_m"]


def test_good_revisits_convince() -> None:
    graph = graph_of(circle())
    graph.loops = revisits(circle())
    assert solved(graph, odometry_deviation_m()) == ""


def test_few_revisits_do_not() -> None:
    graph = graph_of(circle())
    graph.loops = revisits(circle())[: MIN_LOOPS - 1]
    assert "needed" in solved(graph, odometry_deviation_m())


def test_contradictory_revisits_do_not() -> None:
    truth = circle()
    graph = graph_of(truth)
    rng = np.random.default_rng(3)
    wrong = [loop_of(truth, k, k + 17, rng.uniform(-4, 4, 3)) for k in range(12)]
    graph.loops = revisits(truth) + wrong
    assert "contradict" in solved(graph, odometry_deviation_m())


def test_vague_revisits_do_not() -> None:
    graph = graph_of(circle())
    graph.loops = [replace(one, information=one.information / 1e4) for one in revisits(circle())]
    assert "uncertainty" in solved(graph, odometry_deviation_m())


def test_a_correction_within_its_deviation_does_not() -> None:
    graph = graph_of(circle(), scale=0.0, crab=0.0, turn_radps=0.0)
    graph.loops = revisits(circle())
    assert "correction" in solved(graph, odometry_deviation_m())


@pytest.mark.parametrize(("count", "is_used"), [(2, False), (3, True)])
def test_fixes_stand_in_for_revisits_if_they_are_accepted(count: int, is_used: bool) -> None:  # noqa: FBT001
    truth = circle()
    graph = graph_of(truth)
    nodes = np.linspace(0, len(truth) - 1, count).astype(int).tolist()
    graph.fixes = [PositionFix(node, truth[node, :2], 0.1) for node in nodes]
    assert (solved(graph, odometry_deviation_m()) == "") == is_used
