"""The rules against the engine; `make sim-check` does this on every scene in full."""

from dataclasses import replace

import pytest
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import EffectPlan
from sonar_sim.effects.rule_check import PictureDifference, RuleCheck, RuleChecker
from sonar_sim.scene.scenario import sonar_pose
from sonar_sim.scene_file import load_scenario, scene_names
from sonar_sim.simulator import Simulator


@pytest.mark.slow
@pytest.mark.parametrize("name", scene_names())
def test_what_is_left_out_does_not_show_and_what_is_computed_does(name: str) -> None:
    scenario = load_scenario(name)
    small = replace(scenario.sonar, beams=96, beam_width_rad=0.03, forced_rows=200)
    # So few pixels need many seeds to tell a change of texture from chance.
    checker = RuleChecker(replace(scenario, sonar=small), seeds=range(8))
    check = checker.check(0.5 * scenario.trajectory.duration_s)
    assert check.faults == ()
    assert len(check.without) > 8


def test_the_tail_of_ghosts_is_not_left_out() -> None:
    """At the start of the tank's path walls repeat each other: without it pixels change 1.7 dB."""
    scenario = load_scenario("tank")
    time_s = 0.05 * scenario.trajectory.duration_s
    simulator = Simulator(scenario.scene, scenario.sonar)
    planned = simulator.plan(sonar_pose(scenario, time_s), 0, time_s)
    assert "reverberation" in planned.plan.names


def test_what_displaces_may_be_idle_only_where_displacement_is_found() -> None:
    tolerance, nothing = Tolerance(), PictureDifference(0.0, 0.0, 0.0)
    lost = PictureDifference(0.0, None, 0.0)
    moved = RuleCheck(EffectPlan(()), nothing, {"motion": lost}, tolerance)
    assert moved.faults == ()
    for name, change in (("motion", nothing), ("specular", lost)):
        assert RuleCheck(EffectPlan(()), nothing, {name: change}, tolerance).faults != ()


@pytest.mark.parametrize(
    ("change", "within"),
    [
        (PictureDifference(0.5, None, 0.05), True),
        (PictureDifference(0.5, 0.5, 0.05), True),
        (PictureDifference(0.6, 0.0, 0.0), False),
        (PictureDifference(0.0, 0.6, 0.0), False),
        (PictureDifference(0.0, 0.0, 0.06), False),
    ],
)
def test_any_of_the_three_can_exceed(change: PictureDifference, *, within: bool) -> None:
    assert change.within(Tolerance()) is within
