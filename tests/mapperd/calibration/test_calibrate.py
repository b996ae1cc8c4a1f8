"""A simulated dive with known errors: the calibration finds those that the dive shows."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sonar_sim.capture import CaptureSettings, write_capture
from sonar_sim.scene_file import load_scenario
from sonar_sim.wire import Network

from mapperd.cli.mapperd import main

SCENE = """\
water: {temperature_c: 10, salinity_ppt: 35, depth_m: 5, volume_strength_db: -95}
terrain:
  relief: {kind: procedural, depth_m: 6.5, relief_m: 0.06, longest_m: 6, shortest_m: 1.5, seed: 4}
  x_m: [-11, 11]
  y_m: [-9, 9]
  cell_m: 0.3
  material: sand
objects:
  - name: pile
    shape: {kind: cylinder, radius_m: 0.15, height_m: 5, open: true, facets: 24}
    material: overgrown_concrete
    position_m: [-4, 2.2, -4.2]
    smooth: true
    repeat: {count: 4, step_m: [2.6, 0.3, 0]}
  - name: post
    shape: {kind: cylinder, radius_m: 0.1, height_m: 3, open: true, facets: 24}
    material: overgrown_steel
    position_m: [-3, -2.6, -5.2]
    smooth: true
    repeat: {count: 4, step_m: [2.2, -0.2, 0]}
  - name: block
    shape: {kind: box, size_m: [0.8, 0.5, 0.6]}
    material: concrete
    position_m: [-3.5, -0.6, 0.3]
    on_floor: true
    yaw_deg: 25
    cell_m: 0.3
    repeat: {count: 4, step_m: [2.3, 0.4, 0]}
  - name: boulder
    shape: {kind: sphere, radius_m: [0.35, 0.3, 0.3], subdivisions: 2}
    material: rock
    position_m: [-5, -4.5, 0.1]
    on_floor: true
    repeat: {count: 6, step_m: [1.7, 1.6, 0]}
sonar: {model: M750d, mode: 1, range_m: 6, ping_rate_hz: 2, beams: 256, told_speed_mps: 1510}
mounting: {position_m: [0.15, 0.0, -0.4], pitch_deg: 90.5, roll_deg: 1.5, yaw_deg: -2.0}
trajectory:
  sway_deg: 3
  waypoints:
"""

WAYPOINTS = (
    (-5, 0.8, -3.2, 0, 0),
    (5, 0.8, -3.2, 0, 15),
    (5, -1.4, -3.2, 180, 0),
    (-5, -1.4, -3.2, 180, -15),
    (-5, 0.6, -1.8, 360, 0),
    (5, 0.4, -1.8, 360, -15),
    (2.5, -4, -1.8, 450, 0),
    (2.5, 4, -1.8, 450, 10),
    (-1.5, 4, -2.8, 630, 0),
    (-1.5, -4, -2.8, 630, -10),
    (-1.5, -3.8, -2.8, 270, 0),
)
"""Lanes over structure: both ways and across, at three heights, rolled, with turns."""

SETTINGS = """\
mounting:
  position: { x: 0.15, y: 0.0, z: -0.4 }
  orientation: { roll: 0.0, pitch: 90.0, yaw: 0.0 }
"""
LATENCY_S = 0.053
SPEED_MPS = 1490.07


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_finds_the_errors_of_a_simulated_dive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = "".join(
        f"    - {{position_m: [{x}, {y}, {z}], yaw_deg: {yaw}, roll_deg: {roll}}}\n"
        for x, y, z, yaw, roll in WAYPOINTS
    )
    scene, settings = tmp_path / "scene.yaml", tmp_path / "settings.yaml"
    scene.write_text(SCENE + points)
    settings.write_text(SETTINGS)
    recording = tmp_path / "dive.mcap"
    network = Network(processing_s=LATENCY_S)
    write_capture(
        recording,
        load_scenario(str(scene)),
        CaptureSettings(seed=11, processes=1, network=network),
    )
    out = tmp_path / "out"
    code = main(["calibrate", str(recording), "--config", str(settings), "--out", str(out)])
    printed = capsys.readouterr().out
    assert code == 0
    found = {one["name"]: one for one in json.loads((out / "calibration.json").read_text())}
    true = Rotation.from_euler("ZYX", [-2.0, 90.5, 1.5], degrees=True)
    start = Rotation.from_euler("ZYX", [0.0, 90.0, 0.0], degrees=True)
    roll, _, yaw = np.degrees((true * start.inv()).as_rotvec())
    assert found["roll"]["change"] == pytest.approx(roll, abs=0.3)
    assert found["yaw"]["change"] == pytest.approx(yaw, abs=0.3)
    assert found["time_offset"]["change"] == pytest.approx(-LATENCY_S, abs=0.010)
    assert found["range_scale"]["change"] + 1 == pytest.approx(SPEED_MPS / 1510, abs=0.003)
    assert not found["pitch"]["observable"]
    assert math.isclose(found["pitch"]["change"], 0.0)
    assert "latency_sec: 0.05" in printed
    assert (out / "calibration.png").stat().st_size > 10_000


def test_names_a_missing_file_and_a_missing_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["calibrate", str(tmp_path / "no.mcap")]) == 66
    assert "no such file" in capsys.readouterr().err
    recording = tmp_path / "dive.mcap"
    recording.write_bytes(b"")
    monkeypatch.setattr("mapperd.cli.calibrate.find_spec", lambda _: None)
    assert main(["calibrate", str(recording)]) == 78
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "to install the extra `calibrate`" in error
