"""Pings decided as one: which, and that no ping's decision depends on the others."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import EffectSelection
from sonar_sim.effects.planner import HEADINGS, TURN_SLACK_RAD, PlannedPing, Planner
from sonar_sim.effects.previewer import Previewer
from sonar_sim.geometry.pose import FramePose, rotation_of
from sonar_sim.scene.material import Material
from sonar_sim.scene.scene import Bubbles, CloudSpec, Emitter, Scene, Sea

from tests.sonar_sim.effects.previews import LOUD, SONAR, floor, motion, wall


def planner(*surfaces: object, scene: Scene | None = None) -> Planner:
    shown = scene or Scene(tuple(surfaces))  # type: ignore[arg-type]
    return Planner(Previewer(shown, LOUD), EffectSelection.read("auto"), Tolerance())


def at(x_m: float = 0.0, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> FramePose:
    turn = rotation_of(0.0, np.radians(pitch_deg), np.radians(yaw_deg))
    return FramePose(np.array([x_m, 0.0, -3.0]), turn)


def decisions_of(planned: PlannedPing) -> list[tuple[str, bool, float]]:
    return [(d.effect.name, d.on, d.verdict.predicted_db) for d in planned.plan.decisions]


def test_pings_close_to_one_another_are_decided_as_one() -> None:
    asked = planner(floor())
    first = asked.at(at())
    assert asked.at(at(0.05, 0.3)).view.echoes is first.view.echoes
    assert asked.at(at(), motion=motion(1.0)).view.echoes is first.view.echoes
    assert asked.at(at(2.0)).view.echoes is not first.view.echoes
    assert asked.at(at(0.0, 30.0)).view.echoes is not first.view.echoes


def test_each_ping_is_asked_for_its_own_motion() -> None:
    asked = planner(floor())
    slow, fast = (asked.at(at(), motion=motion(v)).plan.names for v in (0.01, 2.0))
    assert "doppler" in fast
    assert "doppler" not in slow
    assert asked.at(at(), motion=motion(2.0)).view.own_pose is not asked.at(at()).view.map_T_sonar


def test_a_decision_does_not_depend_on_the_pings_before() -> None:
    asked = planner(floor(), wall(6.0))
    for x_m in (0.0, 0.2, 0.4):
        asked.at(at(x_m))
    later, alone = asked.at(at(0.21)), planner(floor(), wall(6.0)).at(at(0.21))
    assert decisions_of(later) == decisions_of(alone)
    assert later.physics.attenuation_db_per_m == alone.physics.attenuation_db_per_m


def test_a_fan_that_looks_down_and_turns_is_rounded_no_farther() -> None:
    asked = planner(floor())
    for yaw_deg in (0.0, 77.0, 179.0):
        pose = at(0.0, yaw_deg, 89.0)
        back = asked.at(pose).view.map_T_sonar.rotation.T @ pose.rotation
        assert np.degrees(np.arccos((np.trace(back) - 1.0) / 2.0)) < 5.3


def test_no_ping_is_turned_farther_from_its_cell_than_the_rules_allow_for() -> None:
    asked = planner(floor())
    attitudes = [*Rotation.random(2000, rng=np.random.default_rng(2)), *Rotation.create_group("O")]
    for attitude in attitudes:
        pose = FramePose(np.zeros(3), attitude.as_matrix())
        middle = Rotation.from_matrix(asked._cell(pose, 0.0, 1.0).pose.rotation)
        assert (middle.inv() * attitude).magnitude() <= TURN_SLACK_RAD


@pytest.mark.parametrize("pitch_deg", [0.0, 15.0, 45.0, 89.0, 90.0])
def test_one_turn_about_the_vertical_crosses_as_many_cells_wherever_the_sonar_looks(
    pitch_deg: float,
) -> None:
    asked = planner(floor())
    yaws_deg = np.arange(0.5, 360.0, 0.5).tolist()
    cells = {asked._cell(at(0.0, yaw_deg, pitch_deg), 0.0, 1.0) for yaw_deg in yaws_deg}
    assert len(cells) == HEADINGS


def test_settings_are_each_pings_own() -> None:
    asked = planner(floor())
    asked.at(at()).physics.quantised = False
    assert asked.at(at()).physics.quantised


def test_nothing_is_decided_from_behind_a_wall() -> None:
    # 10 m of range make cells of 0.625 m, and of 0.21 m where the middle of the larger one lies
    # behind the wall; where that of the smaller one does too, the ping is looked from itself.
    def middle_m(x_m: float, wall_m: float) -> float:
        there = planner(floor(), wall(wall_m)).at(at(x_m)).view.map_T_sonar
        return float(there.position_m[0])

    assert middle_m(0.37, 5.0) == 0.625
    assert middle_m(0.37, 0.5) == pytest.approx(0.41667, abs=1e-4)
    assert middle_m(0.37, 0.4) == 0.37


def test_each_ping_hears_other_sonars_at_its_own_time() -> None:
    emitter = Emitter(
        name="other",
        position_m=(5.0, 0.0, -3.0),
        frequency_hz=SONAR.frequency_hz,
        bandwidth_hz=2e4,
        source_level_db=200.0,
        period_s=1.0,
        pulse_s=1e-3,
        offset_s=0.0,
    )
    asked = planner(scene=Scene((floor(),), emitters=(emitter,)))
    sent, silent = asked.at(at(), time_s=0.0), asked.at(at(), time_s=0.3)
    assert len(sent.physics.arrivals) == 1
    assert silent.physics.arrivals == ()
    assert replace(sent.physics, arrivals=()).noise_level_db == silent.physics.noise_level_db


@pytest.mark.parametrize(("choice", "on"), [("all", True), ("none", False)])
def test_the_wish_is_obeyed(choice: str, *, on: bool) -> None:
    asked = Planner(Previewer(Scene((floor(),)), LOUD), EffectSelection.read(choice), Tolerance())
    assert {d.on for d in asked.at(at()).plan.decisions} == {on}


@pytest.mark.parametrize("height_m", [9.6, 9.75, 9.9])
def test_what_only_shows_in_the_last_rows_is_not_lost(height_m: float) -> None:
    """The middle of a cell of poses may be so high that the floor is out of its range."""
    assert LOUD.range_m == pytest.approx(10.0, abs=0.02)
    down = rotation_of(0.0, np.radians(90.0), 0.0)
    for depth_m in np.linspace(3.0, 3.7, 8):
        pose = FramePose(np.array([0.0, 0.0, -depth_m]), down)
        asked = planner(floor(depth_m + height_m))
        assert "bottom_reverberation" in asked.at(pose).plan.names


def test_a_floor_that_only_a_mirror_may_show_is_computed() -> None:
    """All rays meet the wall, and the wall mirrors."""
    steel = Material("steel", -30.0, 0.9, 0.0, 0.01)
    scene = Scene((floor(5.0), wall(3.0, steel, 5.0), wall(-3.0, steel, 5.0)), sea=Sea())
    for pitch_deg in (-30.0, -60.0, -80.0):
        names = planner(scene=scene).at(at(0.0, 0.0, pitch_deg)).plan.names
        assert "multipath" in names
        assert "bottom_reverberation" in names


def test_clouds_beyond_the_usual_fan_call_for_all_elevations() -> None:
    cloud = CloudSpec("plume", (-1.0, -3.0, -2.9), (1.0, 3.0, -1.0), Bubbles(1e-3, 1e6))
    planned = planner(scene=Scene(clouds=(cloud,))).at(at())
    assert len(planned.view.echoes.range_m) == 0
    assert "all_elevations" in planned.plan.names
