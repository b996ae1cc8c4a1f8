import pickle

import numpy as np
import pytest
from sonar_sim.geometry.trajectory import Trajectory
from sonar_sim.scene_file import load_scenario, scene_names

NAMES = scene_names()


@pytest.mark.parametrize("name", NAMES)
def test_shipped_scene_is_whole(name: str) -> None:
    scenario = load_scenario(name)
    triangles = scenario.scene.triangles_m
    still = [s for s in scenario.scene.surfaces if s.motion is None]
    assert scenario.description.endswith(".")
    assert np.isfinite(triangles).all()
    edges = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert np.linalg.norm(edges, axis=1).min() > 0.0
    for surface in still:  # a triangle that reaches out of the water has one corner in it
        assert surface.vertices_m[surface.faces][..., 2].min(axis=1).max() < 0.0, surface.name


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_shipped_scene_is_the_same_every_time_and_can_be_sent(name: str) -> None:
    one, again = load_scenario(name), load_scenario(name)
    sent = pickle.loads(pickle.dumps(one))  # noqa: S301 our own bytes
    assert np.array_equal(one.scene.triangles_m, again.scene.triangles_m)
    assert np.array_equal(sent.scene.triangles_at_m(3.0), again.scene.triangles_at_m(3.0))


@pytest.mark.parametrize("name", NAMES)
def test_vehicle_stays_in_the_water_and_does_not_turn_wildly(name: str) -> None:
    path = load_scenario(name).trajectory
    times_s = np.linspace(0.0, path.duration_s, 200)
    assert 20.0 < path.duration_s < 300.0
    assert max(path.pose(t).position_m[2] for t in times_s) < -0.2
    assert max(_turn_rate_dps(path, t) for t in times_s) < 60.0


def test_harbour_is_large_enough_to_measure_speed_in() -> None:
    assert len(load_scenario("harbour").scene.triangles_m) > 100_000


def test_open_water_has_a_diver_that_moves_and_a_tank_still_water() -> None:
    open_water = load_scenario("open_water").scene
    divers = [s for s in open_water.surfaces if s.motion is not None]
    assert {s.name for s in divers} == {"diver", "diver's bottle"}
    gone_m = divers[0].vertices_at_m(5.0) - divers[0].vertices_at_m(0.0)
    assert np.linalg.norm(gone_m, axis=1).min() > 1.0
    sea = load_scenario("tank").scene.sea
    assert sea is not None
    assert sea.rms_height_m == 0.0


def test_tank_has_the_rods_and_the_plate_of_the_published_comparison() -> None:
    surfaces = {s.name: s for s in load_scenario("tank").scene.surfaces}
    plate = surfaces["plate"].vertices_m
    assert np.ptp(plate[:, 2]) == pytest.approx(0.6)
    along = np.linalg.norm(plate[:, None, :2] - plate[None, :, :2], axis=2).max()
    assert along == pytest.approx(0.5, abs=0.01)
    assert {"vertical rod", "horizontal rod"} < set(surfaces)


def _turn_rate_dps(path: Trajectory, time_s: float) -> float:
    return float(np.degrees(np.linalg.norm(path.turn_rates_rps(float(time_s)))))


def test_no_scene_depends_on_numbers_drawn_afresh(monkeypatch: pytest.MonkeyPatch) -> None:
    def drawn(*_: object) -> None:
        raise AssertionError("a random number that no seed gives")

    # Of this scene's floor some points see an edge of the pipe.
    monkeypatch.setattr("trimesh.util.random_generator", drawn)
    assert load_scenario("pipeline").scene.surfaces
