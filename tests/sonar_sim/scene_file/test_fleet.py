"""Several sonars and vehicles of one file."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sonar_sim.capture import CaptureSettings, write_capture
from sonar_sim.errors import SceneError
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene_file import load_scenario
from sonar_sim.world import World

Load = Callable[..., Scenario]
FLEET = """
sonar: {range_m: 6, beams: 64, rows: 150, ping_rate_hz: 4}
mounting: {pitch_deg: 0, position_m: [0, 0, 0]}
vehicle: {name: one}
sonars:
  - name: down
    sonar: {model: Gemini 720is, range_m: 4, rows: 100, beams: 64}
    mounting: {pitch_deg: 90}
vehicles:
  - vehicle: {name: two, size_m: [0.5, 0.4, 0.3], material: painted_steel}
    trajectory:
      waypoints: [{position_m: [4, 0, -2], yaw_deg: 180}, {position_m: [3, 0, -2], yaw_deg: 180}]
      sway_deg: 0
      heave_m: 0
    sonars:
      - name: eye
        sonar: {range_m: 6, beams: 64, rows: 150, ping_rate_hz: 2}
        mounting: {pitch_deg: 0}
"""


def test_a_file_has_several_sonars_and_vehicles(load: Load) -> None:
    first = load(FLEET)
    names = [(one.name, one.vehicle.name, one.sonar_name) for one in (first, *first.others)]
    assert names == [
        ("scene", "one", "sonar"),
        ("one/down", "one", "down"),
        ("two/eye", "two", "eye"),
    ]
    down, eye = first.others
    assert (down.sonar.model, down.mounting.pitch_deg) == ("Gemini 720is", 90.0)
    assert down.trajectory is first.trajectory
    assert down.scene is eye.scene is first.scene
    assert eye.trajectory.pose(0.0).position_m == pytest.approx([3.9, 0.0, -2.0], abs=0.1)
    assert (eye.ping_rate_hz, eye.vehicle.material.name) == (2.0, "painted_steel")


def test_a_world_of_it_runs_on_its_paths(load: Load) -> None:
    world = World.of(load(FLEET))
    pings = world.step(0.5)
    assert [(p.vehicle, p.sonar, round(p.time_s, 6)) for p in pings] == [
        ("one", "down", 0.2),
        ("one", "sonar", 0.25),
        ("one", "down", 0.4),
        ("one", "sonar", 0.5),
        ("two", "eye", 0.5),
    ]
    last, one = pings[3], world.vehicles["one"]
    row = int(last.ping.amplitude.max(axis=1).argmax())
    away_m = world.vehicles["two"].pose.position_m[0] - 0.25 - last.map_T_sonar.position_m[0]
    rows_m = one.sonars["sonar"].settings.row_centres_m
    assert rows_m[row] == pytest.approx(away_m, abs=0.1)


def test_a_recording_of_the_first_sonar_shows_the_other_vehicle(load: Load, tmp_path: Path) -> None:
    with_other = load(FLEET)
    seen = write_capture(tmp_path / "a.mcap", with_other, CaptureSettings(processes=1))
    points = np.asarray(seen.points_m)
    near = np.abs(points[:, 0] - 3.5) < 0.8
    assert np.count_nonzero(near & (np.abs(points[:, 1]) < 0.3)) > 10


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("name: down", "name: sonar", r"\$\.sonars\[0\]: two sonars of one are called sonar"),
        ("name: two", "name: one", r"\$\.vehicles\[0\]: two vehicles are called one"),
        ("painted_steel", "gold", r"\$\.vehicles\[0\]: no material is called gold"),
        ("model: Gemini 720is", "mode: 3", r"\$\.sonars\[0\]\.sonar\.mode: 3 is not allowed"),
        ("[0.5, 0.4, 0.3]", "[0.5, 0, 0.3]", r"\$\.vehicles\[0\]\.vehicle\.size_m\[1\]"),
    ],
)
def test_what_a_fleet_cannot_is_refused_by_its_place(
    load: Load, old: str, new: str, reason: str
) -> None:
    with pytest.raises(SceneError, match=reason):
        load(FLEET.replace(old, new))


def test_shipped_scenes_have_one_sonar() -> None:
    assert load_scenario("harbour").others == ()
