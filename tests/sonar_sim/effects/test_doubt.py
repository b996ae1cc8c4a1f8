"""What is in doubt for a cell of poses is computed for all its pings; nothing looks twice."""

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
    ("bright_db", "on"), [(0.0, False), (0.2, False), (0.3, True), (0.6, True), (20.0, True)]
)
def test_an_effect_is_computed_from_half_of_the_tolerance_on(
    monkeypatch: pytest.MonkeyPatch, bright_db: float, *, on: bool
) -> None:
    put(monkeypatch, lambda _, brighter_db: bright_db if brighter_db > 0.0 else 0.0)
    found = decide_cell(view_of(floor()), EffectSelection.read("auto"), Tolerance(), {NAME})
    assert found.names == ((NAME,) if on else ())
    assert ("in doubt" in found.decisions[0].verdict.reason) == (on and bright_db < 0.5)


@pytest.mark.parametrize(
    ("choice", "on"), [("all", True), ("none", False), (f"auto,-{NAME}", False)]
)
def test_what_is_not_left_to_the_rules_is_not_doubted(
    monkeypatch: pytest.MonkeyPatch, choice: str, *, on: bool
) -> None:
    put(monkeypatch, lambda _, brighter_db: 0.4 if brighter_db > 0.0 else 0.0)
    found = decide_cell(view_of(floor()), EffectSelection.read(choice), Tolerance(), {NAME})
    assert found.names == ((NAME,) if on else ())


def test_what_costs_nothing_is_decided_without_a_look() -> None:
    # A scene without echoes, as of a thing that the coarse rays miss.
    names = {"spreading", "vertical_pattern", "side_lobes", "tvg", "gain"}
    empty = decide_cell(view_of(), EffectSelection.read("auto"), Tolerance(), names)
    assert set(empty.names) == names
    near = replace(LOUD, demanded_range_m=0.3, gain_percent=0.0)
    names = {"absorption", "lambert", "gain"}
    few = decide_cell(view_of(sonar=near), EffectSelection.read("auto"), Tolerance(), names)
    assert few.names == ()


@pytest.mark.parametrize(
    ("at_m", "on"),
    [((6.0, 0.0, -2.0), True), ((6.0, 0.0, 30.0), False), ((-6.0, 0.0, -2.0), False)],
)
def test_clouds_are_computed_where_a_ping_of_the_cell_may_see_them(
    at_m: tuple[float, float, float], *, on: bool
) -> None:
    low = tuple(float(x) - 0.05 for x in at_m)
    high = tuple(float(x) + 0.05 for x in at_m)
    plume = CloudSpec("plume", low, high, Bubbles(5e-4, 1e3))  # type: ignore[arg-type]
    asked = Planner(
        Previewer(Scene((floor(),), clouds=(plume,)), LOUD),
        EffectSelection.read("auto"),
        Tolerance(),
    )
    assert ("bubbles" in asked.at(pose()).plan.names) == on


def test_pings_of_a_cell_share_a_look_though_clouds_are_in_range() -> None:
    plume = CloudSpec("plume", (4.0, -1.0, -8.0), (5.0, 1.0, 0.0), Bubbles(5e-4, 1e6))
    asked = Planner(
        Previewer(Scene((floor(),), clouds=(plume,)), LOUD),
        EffectSelection.read("auto"),
        Tolerance(),
    )
    here, there = asked.at(pose()), asked.at(beside(0.0, 0.1))
    assert here.view.echoes is there.view.echoes
    assert "bubbles" in there.plan.names
