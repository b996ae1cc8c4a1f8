"""Rules in doubt about a cell of poses leave it to each of its pings."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from sonar_sim.effects.effect import RuleResult
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import EffectSelection
from sonar_sim.effects.planner import Planner, decide_cell
from sonar_sim.effects.preview import PingPreview
from sonar_sim.effects.previewer import Previewer
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.geometry.pose import FramePose
from sonar_sim.scene.scene import Bubbles, CloudSpec, Scene

from tests.sonar_sim.effects.previews import LOUD, floor, pose, view_of

NAME = "crosstalk"


def beside(x_m: float, y_m: float) -> FramePose:
    return replace(pose(), position_m=pose().position_m + np.array([x_m, y_m, 0.0]))


def rule_predicting(
    predict: Callable[[PingPreview, float], float],
) -> Callable[[PingPreview, Tolerance], RuleResult]:
    """A rule by what it predicts for a view that is so much brighter."""

    def decide(view: PingPreview, tolerance: Tolerance) -> RuleResult:
        predicted_db = predict(view, tolerance.brighter_db)
        return RuleResult(predicted_db > tolerance.level_db, "predicted", predicted_db)

    return decide


def decide_by(
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    decide: Callable[[PingPreview, Tolerance], RuleResult],
) -> None:
    ruled = {**EFFECTS, name: replace(EFFECTS[name], decide=decide)}
    monkeypatch.setattr("sonar_sim.effects.plan.EFFECTS", ruled)


def put(monkeypatch: pytest.MonkeyPatch, predict: Callable[[PingPreview, float], float]) -> None:
    decide_by(monkeypatch, NAME, rule_predicting(predict))


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
    found = decide_cell(view_of(floor()), EffectSelection.read("auto"), Tolerance(), {NAME})
    assert found.doubtful == ({NAME} if doubtful else set())


@pytest.mark.parametrize("choice", ["all", "none", f"auto,-{NAME}"])
def test_what_is_not_left_to_the_rules_is_not_doubted(
    monkeypatch: pytest.MonkeyPatch, choice: str
) -> None:
    put(monkeypatch, lambda _, brighter_db: 1.0 if brighter_db > 0.0 else 0.0)
    assert not decide_cell(
        view_of(floor()), EffectSelection.read(choice), Tolerance(), {NAME}
    ).doubtful


def test_a_ping_in_doubt_is_looked_at_from_its_own_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    def predict(view: PingPreview, brighter_db: float) -> float:
        if abs(brighter_db) > 1.0:
            return 1.0 + brighter_db / 2.0
        return 5.0 * float(view.map_T_sonar.position_m[0])

    put(monkeypatch, predict)
    asked = Planner(Previewer(Scene((floor(),)), LOUD), EffectSelection.read("auto"), Tolerance())
    here, there = asked.at(pose()), asked.at(beside(0.11, 0.0))
    assert here.view.echoes is there.view.echoes
    assert NAME not in here.plan.names
    assert NAME in there.plan.names
    assert there.physics.crosstalk_db is not None


def test_clouds_in_range_are_looked_at_from_the_ping_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plume = CloudSpec("plume", (4.0, -1.0, -8.0), (5.0, 1.0, 0.0), Bubbles(5e-4, 1e6))
    asked = Planner(
        Previewer(Scene((floor(),), clouds=(plume,)), LOUD),
        EffectSelection.read("auto"),
        Tolerance(),
    )
    seen: list[float] = []
    decide = EFFECTS["bubbles"].decide

    def watched(view: PingPreview, tolerance: Tolerance) -> RuleResult:
        seen.append(float(view.map_T_sonar.position_m[1]))
        verdict: RuleResult = decide(view, tolerance)
        return verdict

    decide_by(monkeypatch, "bubbles", watched)
    assert "bubbles" in asked.at(beside(0.0, 0.2)).plan.names
    assert seen == [0.2]
