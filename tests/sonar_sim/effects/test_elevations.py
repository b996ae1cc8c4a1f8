"""Rays of `auto` end where no echo shows, for every ping of a cell of poses."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from sonar_sim import load_scenario
from sonar_sim.effects.directivity import elevations_that_show
from sonar_sim.effects.image_difference import Tolerance, level_change_db
from sonar_sim.effects.plan import EffectSelection
from sonar_sim.effects.planner import Planner
from sonar_sim.effects.preview import PoseSlack
from sonar_sim.effects.previewer import Previewer
from sonar_sim.engine import PingEngine
from sonar_sim.geometry.trajectory import Drift
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.fan import ALL_ELEVATIONS_RAD, MAX_ELEVATION_RAD, ray_fan
from sonar_sim.scene.scenario import sonar_pose
from sonar_sim.scene.scene import Bubbles, CloudSpec, Scene, Surface

from tests.sonar_sim.effects.previews import LOUD, floor, pose, rectangle, view_of

STILL = PoseSlack()
NEAR = Scene((floor(),))
"""2 m under a level sonar."""


def limits(scene: Scene, slack: PoseSlack = STILL) -> tuple[float, float]:
    return elevations_that_show(view_of(scene=scene, sonar=LOUD), Tolerance(), 0.25, slack)


def planned(choice: str) -> Physics:
    sonar = replace(LOUD, demanded_range_m=8.0)
    planner = Planner(Previewer(NEAR, sonar), EffectSelection.read(choice), Tolerance())
    return planner.at(pose()).physics


def test_a_floor_is_looked_for_below_only() -> None:
    down_rad, up_rad = limits(NEAR)
    assert down_rad == -math.pi / 2.0
    assert up_rad == MAX_ELEVATION_RAD


def test_only_auto_ends_rays_early() -> None:
    assert planned("auto").elevations_rad == (-math.pi / 2.0, MAX_ELEVATION_RAD)
    assert planned("auto").mirrored_elevations_rad == ALL_ELEVATIONS_RAD
    for choice in ("all", "auto,+all_elevations"):
        assert planned(choice).elevations_rad == ALL_ELEVATIONS_RAD
    # A mirror's flash moves with the sonar.
    assert planned("auto,+specular").elevations_rad == ALL_ELEVATIONS_RAD


def test_the_slack_of_poses_widens_the_limits() -> None:
    """The floor's near edge lies 48 to 60 degrees below the sonar."""
    strip = rectangle("floor", [(1.2, -5, -5), (1.7, -5, -5), (1.7, 5, -5), (1.2, 5, -5)])
    scene = Scene((strip,))
    assert limits(scene)[0] == pytest.approx(-math.radians(68.0))
    for slack in (PoseSlack(turn_rad=0.25), PoseSlack(move_m=0.6)):
        assert limits(scene, slack)[0] == -math.pi / 2.0


def thread(x_m: float, z_m: float) -> Surface:
    """A crosswise one, too thin for the preview."""
    corners = [(0.0, 0.003), (0.002, 0.003), (0.002, 0.009), (0.0, 0.009)]
    return rectangle("thread", [(x_m + x, y, z_m) for x, y in corners])


def test_what_the_coarse_rays_miss_is_not_left_out() -> None:
    scene = Scene((floor(), thread(0.71, -2.0)))
    assert 1 not in view_of(scene=scene, sonar=LOUD).echoes.surface
    assert limits(scene)[1] >= math.atan(1.0 / 0.72)
    for beyond in (thread(0.71, 100.0), thread(-0.71, -2.0)):
        assert limits(Scene((floor(), beyond)))[1] == MAX_ELEVATION_RAD


def test_a_ping_that_leans_looks_over_what_is_a_little_behind() -> None:
    scene = Scene((floor(), thread(-0.3, 2.0)))
    assert limits(scene)[1] == MAX_ELEVATION_RAD
    assert limits(scene, PoseSlack(turn_rad=0.1))[1] == math.pi / 2.0


def test_large_faces_and_moving_things_may_reach_anywhere() -> None:
    """Vertices out of range do not tell where a face is."""
    full = (-math.pi / 2.0, math.pi / 2.0)
    post = rectangle("post", [(1, -40, -3.1), (1, 40, -3.1), (1, 40, -3.0), (1, -40, -3.0)])
    assert limits(Scene((floor(), post))) == full
    far = replace(post, vertices_m=post.vertices_m + np.array([200.0, 0.0, 0.0]))
    assert limits(Scene((floor(), far)))[1] == MAX_ELEVATION_RAD
    drifting = replace(thread(5.0, -3.0), motion=Drift())
    assert limits(Scene((floor(), drifting))) == full


def test_a_cloud_above_keeps_its_rays() -> None:
    plume = CloudSpec("plume", (0.2, -1.0, -2.0), (1.0, 1.0, -1.0), Bubbles(5e-4, 1e6))
    assert limits(Scene((floor(),), clouds=(plume,)))[1] > math.radians(60.0)
    # It lies less than 68 degrees up, but not for a ping that has come nearer.
    small = CloudSpec("small", (0.9, -0.2, -2.0), (1.2, 0.2, -1.0), Bubbles(5e-4, 1e6))
    near = [limits(Scene((floor(),), clouds=(small,)), PoseSlack(move_m=m))[1] for m in (0.0, 0.5)]
    assert near[0] < near[1]


def test_a_plan_can_be_sent_to_another_process() -> None:
    sonar = replace(LOUD, demanded_range_m=8.0)
    planner = Planner(Previewer(NEAR, sonar), EffectSelection.read("auto"), Tolerance())
    plan = planner.at(pose()).plan
    sent = pickle.loads(pickle.dumps(plan))  # noqa: S301 our own bytes
    view = planner.at(pose()).view
    assert sent.physics(view).elevations_rad == plan.physics(view).elevations_rad


def test_a_fan_of_some_elevations_is_a_part_of_the_whole_one() -> None:
    part = ray_fan(LOUD, limits_rad=(-math.radians(54.0), MAX_ELEVATION_RAD))
    whole = ray_fan(LOUD, limits_rad=ALL_ELEVATIONS_RAD)
    low, high = math.sin(math.radians(54.0)), math.sin(MAX_ELEVATION_RAD)
    within = (whole.directions[:, 2] > -low) & (whole.directions[:, 2] < high)
    np.testing.assert_array_equal(part.cell, whole.cell[within])
    np.testing.assert_array_equal(part.directions, whole.directions[within])


@pytest.mark.parametrize("name", ["flat_floor", "harbour", "pipeline", "wreck"])
def test_what_is_left_out_does_not_show(name: str) -> None:
    scenario = load_scenario(name)
    sonar = replace(scenario.sonar, beams=128, forced_rows=200)
    tolerance = Tolerance()
    engine = PingEngine(scenario.scene, sonar)
    auto = Planner(
        Previewer(scenario.scene, sonar, engine.meshes), EffectSelection.read("auto"), tolerance
    )
    cells = tolerance.cells, tolerance.cells
    for time_s in np.linspace(0.02, 0.98, 12) * scenario.trajectory.duration_s:
        at = sonar_pose(scenario, float(time_s))
        found = auto.at(at, 0, float(time_s))
        if "all_elevations" not in found.plan.names:
            continue
        some = replace(found.physics, speckle=False, quantised=False)
        every = replace(some, elevations_rad=ALL_ELEVATIONS_RAD)
        levels = [
            np.minimum(engine.ping(at, physics, 0, float(time_s)).amplitude, 1.0)
            for physics in (some, every)
        ]
        change_db = level_change_db(levels[0], levels[1], sonar, tolerance.share, cells)
        assert change_db < tolerance.level_db
