"""Rules that compare displacements with a part of a cell."""

import math
from dataclasses import replace

import numpy as np
import pytest
from sonar_sim.effects.displacement import Displacement, path_bending
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.rule_check import RuleChecker
from sonar_sim.effects.texture import FAR_QUANTILE
from sonar_sim.geometry.pose import Mounting
from sonar_sim.geometry.trajectory import Drift, Motion, Trajectory, Waypoint
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import PointTarget, Scene
from sonar_sim.scene.water import Water

from tests.sonar_sim.effects.previews import SONAR, floor, motion, pose, verdict, view_of, wall

STILL = Trajectory(
    [Waypoint(0.0, 0.0, -3.0, 0.0), Waypoint(0.1, 0.0, -3.0, 0.0)],
    Motion(speed_mps=0.01, sway_deg=0.0, heave_m=0.0),
)


@pytest.mark.parametrize("count", [1, 2, 9, 100])
def test_a_displacement_is_that_of_all_but_a_few_parts(count: int) -> None:
    rows = np.random.default_rng(count).normal(size=count)
    expected = np.quantile(np.abs(rows), FAR_QUANTILE)
    assert Displacement(rows, np.zeros(count)).cells == pytest.approx(expected)
    assert Displacement(np.zeros(0), np.zeros(0)).cells == 0.0


@pytest.mark.parametrize(("off_mps", "on"), [(0.1, False), (2.0, True)])
def test_a_wrong_speed_of_sound_shifts_rows(off_mps: float, *, on: bool) -> None:
    sonar = replace(SONAR, told_speed_mps=Water().speed_of_sound_mps + off_mps)
    found = verdict("sound_speed", view_of(wall(9.0), sonar=sonar, at=pose(0.0)))
    assert found.on is on


def test_motion_is_called_for_above_half_a_row_or_beam() -> None:
    # 10 m, 16 mm rows: v R / c over half a row is 1.2 m/s. omega 2 R / c over half of the beams'
    # distance ahead, 0.2 degrees, is 7.5 degrees a second.
    def on(forward_mps: float, turn_dps: float) -> bool:
        view = view_of(wall(9.99), at=pose(0.0), moving=motion(forward_mps, turn_dps))
        return verdict("motion", view).on

    assert not on(1.0, 0.0)
    assert on(1.4, 0.0)
    assert not on(0.0, 6.0)
    assert on(0.0, 9.0)
    assert not verdict("motion", view_of(floor())).on


def test_doppler_is_the_chirps_coupling() -> None:
    def on(forward_mps: float) -> bool:
        return verdict("doppler", view_of(wall(9.0), at=pose(0), moving=motion(forward_mps))).on

    # v f T / B with B of one 16 mm row: 16 mm shift at 1 m/s.
    assert not on(0.3)
    # Doppler and travel time shift against each other: 1.5 rows less 0.6.
    assert on(1.5)


@pytest.mark.parametrize("name", ["motion", "doppler"])
def test_targets_that_move_are_displaced_too(name: str) -> None:
    target = PointTarget("fish", (0.0, 0.0, 0.0), 0.0)
    for velocity_mps, on in (((-1.8, 0.0, 0.0), True), ((0.0, 0.0, 0.0), False)):
        path = Drift(position_m=(9.0, 0.0, 0.0), velocity_mps=velocity_mps)
        scene = Scene(targets=(replace(target, motion=path),))
        assert verdict(name, view_of(scene=scene, at=pose(0.0))).on is on


def test_refraction_goes_with_the_gradient() -> None:
    def found(g_per_s: float, range_m: float = 40.0) -> bool:
        water = Water(profile=((0.0, 1500.0), (200.0, 1500.0 + 200.0 * g_per_s)))
        sonar = replace(SONAR, demanded_range_m=range_m, noise_excess_db=-60.0)
        return verdict(
            "refraction", view_of(scene=Scene((floor(4.0),), water=water), sonar=sonar)
        ).on

    assert not found(0.0)
    assert not found(0.01, 10.0)
    assert found(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("warmer_mps", "on"), [(0.5, False), (12.0, True)])
def test_the_engine_agrees_on_what_a_thermocline_does(warmer_mps: float, *, on: bool) -> None:
    """With and without bent paths, through the whole simulator: shown iff called for."""
    water = Water(profile=((0.0, 1500.0 + warmer_mps), (3.5, 1500.0 + warmer_mps), (4.5, 1500.0)))
    sonar = replace(SONAR, beams=96, forced_rows=250, beam_width_rad=0.03, gain_percent=75.0)
    ahead = Mounting((0.0, 0.0, 0.0), pitch_deg=0.0)
    scenario = Scenario("thermocline", Scene((floor(),), water=water), sonar, STILL, ahead)
    check = RuleChecker(scenario).check(0.0)
    assert ("refraction" in check.plan.names) is on
    assert check.left_out.within(Tolerance())
    if on:
        assert not check.without["refraction"].within(Tolerance())


def test_paths_are_as_long_as_their_time_requires() -> None:
    # Half of the way at 1510 m/s, half at 1490: the mean slowness is that of 1499.93 m/s.
    water = Water(profile=((0.0, 1510.0), (4.999, 1510.0), (5.001, 1490.0), (10.0, 1490.0)))
    view = view_of(scene=Scene((floor(8.0),), water=water), at=pose(2.0))
    assert path_bending(view).stretch == pytest.approx(
        np.full(len(view.echoes.range_m), view.speed_of_sound_mps * (0.5 / 1510.0 + 0.5 / 1490.0)),
        rel=1e-6,
    )


def test_paths_leave_by_half_of_the_bend() -> None:
    water = Water(profile=((0.0, 1500.0), (100.0, 1550.0)))
    view = view_of(
        scene=Scene((wall(40.0, half_m=0.5),), water=water),
        at=pose(0.0),
        sonar=replace(SONAR, demanded_range_m=45.0),
    )
    # g R / (2 c), g 0.5 per second over 40 m.
    assert abs(path_bending(view).turn_rad).max() == pytest.approx(0.5 * 40.0 / 3000.0, rel=0.15)


def test_beams_by_angle_would_be_far_off() -> None:
    assert verdict("bearing_table", view_of(floor())).on
    narrow = replace(SONAR, half_aperture_rad=math.radians(2.0), beams=32)
    assert not verdict("bearing_table", view_of(floor(), sonar=narrow)).on


def test_grain_can_be_declared_unimportant() -> None:
    blind = Tolerance(texture=0.9)
    assert verdict("speckle", view_of(floor())).on
    assert not verdict("speckle", view_of(floor()), blind).on
    assert verdict("range_spread", view_of(floor())).on
    assert not verdict("range_spread", view_of(floor()), blind).on


@pytest.mark.parametrize("beams", [512, 64, 16])
def test_few_beams_hear_less_than_the_water_between_them(beams: int) -> None:
    sonar = replace(SONAR, beams=beams)
    found = verdict("azimuth_pattern", view_of(floor(), sonar=sonar))
    assert found.on
    # The power of a Gaussian beam is as wide as sqrt(pi / (8 ln 2)) of its -3 dB width.
    equal = math.sqrt(math.pi / (4.0 * math.log(2.0))) * sonar.beam_width_rad / sonar.sine_pitch
    assert found.predicted_db == pytest.approx(abs(10.0 * math.log10(equal)), abs=0.3)
