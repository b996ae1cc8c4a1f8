"""Rules in doubt about a cell of poses leave it to each of its pings."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from sonar_sim.effects.effect import Verdict
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import Wish
from sonar_sim.effects.planner import Planner, judged
from sonar_sim.effects.preview import View
from sonar_sim.effects.previewer import Look
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.geometry.pose import Pose
from sonar_sim.scene.scene import Bubbles, CloudSpec, Scene

from tests.sonar_sim.effects.previews import LOUD, floor, pose, view_of

NAME = "crosstalk"


def beside(x_m: float, y_m: float) -> Pose:
    return replace(pose(), position_m=pose().position_m + np.array([x_m, y_m, 0.0]))


def says(told: Callable[[View, float], float]) -> Callable[[View, Tolerance], Verdict]:
    """A rule by what it predicts for a view that is so much brighter."""

    def decide(view: View, tolerance: Tolerance) -> Verdict:
        predicted_db = told(view, tolerance.brighter_db)
        return Verdict(predicted_db > tolerance.level_db, "told to", predicted_db)

    return decide


def decide_by(
    monkeypatch: pytest.MonkeyPatch, name: str, decide: Callable[[View, Tolerance], Verdict]
) -> None:
    ruled = {**EFFECTS, name: replace(EFFECTS[name], decide=decide)}
    monkeypatch.setattr("sonar_sim.effects.plan.EFFECTS", ruled)


def put(monkeypatch: pytest.MonkeyPatch, told: Callable[[View, float], float]) -> None:
    decide_by(monkeypatch, NAME, says(told))


@pytest.mark.parametrize(
    ("dim_db", "bright_db", "doubtful"),
    [
        (0.0, 0.0, False),
        (0.0, 0.2, False),
        (0.0, 0.4, True),
        (0.0, 3.0, True),
        (0.8, 3.0, True),
        (2.0, 3.0, False),
        (0.0, 20.0, False),
    ],
)
def test_a_rule_is_sure_if_brighter_and_dimmer_pings_agree(
    monkeypatch: pytest.MonkeyPatch, dim_db: float, bright_db: float, *, doubtful: bool
) -> None:
    put(monkeypatch, lambda _, brighter_db: bright_db if brighter_db > 0.0 else dim_db)
    found = judged(view_of(floor()), Wish.read("auto"), Tolerance(), {NAME})
    assert found.doubtful == ({NAME} if doubtful else set())


@pytest.mark.parametrize("choice", ["all", "none", f"auto,-{NAME}"])
def test_what_is_not_left_to_the_rules_is_not_doubted(
    monkeypatch: pytest.MonkeyPatch, choice: str
) -> None:
    put(monkeypatch, lambda _, brighter_db: 1.0 if brighter_db > 0.0 else 0.0)
    assert not judged(view_of(floor()), Wish.read(choice), Tolerance(), {NAME}).doubtful


def test_a_ping_in_doubt_is_looked_at_from_its_own_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    def told(view: View, brighter_db: float) -> float:
        if abs(brighter_db) > 1.0:
            return 1.0 + brighter_db / 2.0
        return 5.0 * float(view.map_T_sonar.position_m[0])

    put(monkeypatch, told)
    asked = Planner(Look(Scene((floor(),)), LOUD), Wish.read("auto"), Tolerance())
    here, there = asked.at(pose()), asked.at(beside(0.11, 0.0))
    assert here.view.echoes is there.view.echoes
    assert NAME not in here.plan.names
    assert NAME in there.plan.names
    assert there.physics.crosstalk_db is not None


def test_clouds_in_range_are_looked_at_from_the_ping_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plume = CloudSpec("plume", (4.0, -1.0, -8.0), (5.0, 1.0, 0.0), Bubbles(5e-4, 1e6))
    asked = Planner(Look(Scene((floor(),), clouds=(plume,)), LOUD), Wish.read("auto"), Tolerance())
    seen: list[float] = []
    decide = EFFECTS["bubbles"].decide

    def watched(view: View, tolerance: Tolerance) -> Verdict:
        seen.append(float(view.map_T_sonar.position_m[1]))
        verdict: Verdict = decide(view, tolerance)
        return verdict

    decide_by(monkeypatch, "bubbles", watched)
    assert "bubbles" in asked.at(beside(0.0, 0.2)).plan.names
    assert seen == [0.2]
