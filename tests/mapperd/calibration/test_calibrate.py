"""Simulated dives with known errors: the calibration finds those that the dives show."""

import json
import math
from pathlib import Path

import pytest
import yaml
from scipy.spatial.transform import Rotation
from sonar_sim.capture import CaptureSettings, write_capture
from sonar_sim.scene_file import SHIPPED, load_scenario
from sonar_sim.wire import Network

from mapperd.cli.mapperd import main

FORWARD = (
    (-7, 0.3, -3.4, 0),
    (-1, 0.3, -3.4, 0),
    (-1, 0.3, -3.4, -60),
    (-1, 0.3, -3.4, 60),
    (0, 4.5, -3.0, -60),
    (1.5, 5.5, -3.0, -120),
    (1.5, 4.5, -3.0, -45),
    (6, 3, -2.6, -160),
    (2.5, 1, -2.6, -190),
    (4, -2, -4.0, -240),
    (4.5, -5.5, -4.0, -270),
    (2, -5.2, -3.5, -240),
    (0, -5, -3.0, -300),
    (-3, -6, -3.0, -260),
    (-6, -4, -3.0, -320),
)
"""Towards structure from several sides, with turns on the spot, at several heights."""

SPEED_MPS = 1490.07
"""In the scene's water."""

NAMES = ("roll", "pitch", "yaw")


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize(
    "dive",
    [
        (90.0, (3.0, 1.0, -2.5), 0.070, 1508, 14),
        (90.0, (0.0, 2.0, -3.5), 0.020, 1478, 12),
        (30.0, (-1.0, 1.5, 3.0), 0.030, 1480, 32),
    ],
    ids=["all errors at once", "another seed", "looking ahead"],
)
def test_finds_the_errors_of_a_simulated_dive(
    tmp_path: Path, dive: tuple[float, tuple[float, float, float], float, float, int]
) -> None:
    pitch_deg, turn_deg, latency_s, told_mps, seed = dive
    scene = yaml.safe_load((SHIPPED / "calibration.yaml").read_text())
    turn = Rotation.from_rotvec(turn_deg, degrees=True)
    mounting = turn * Rotation.from_euler("ZYX", [0.0, pitch_deg, 0.0], degrees=True)
    angles = zip(
        ("yaw_deg", "pitch_deg", "roll_deg"), mounting.as_euler("ZYX", degrees=True), strict=True
    )
    scene["mounting"].update({name: float(angle) for name, angle in angles})
    scene["sonar"]["told_speed_mps"] = told_mps
    if pitch_deg < 90.0:
        scene["sonar"]["ping_rate_hz"] = 3
        scene["trajectory"]["waypoints"] = [
            {"position_m": list(place), "yaw_deg": yaw} for *place, yaw in FORWARD
        ]
    file, settings, out = tmp_path / "scene.yaml", tmp_path / "settings.yaml", tmp_path / "out"
    file.write_text(yaml.safe_dump(scene))
    settings.write_text(f"mounting: {{orientation: {{pitch: {pitch_deg}}}}}\n")
    recording = tmp_path / "dive.mcap"
    network = Network(processing_s=latency_s)
    capture = CaptureSettings(seed=seed, processes=1, network=network, effects="auto,+motion")
    write_capture(recording, load_scenario(str(file)), capture)
    assert main(["calibrate", str(recording), "--config", str(settings), "--out", str(out)]) == 0
    found = {one["name"]: one for one in json.loads((out / "calibration.json").read_text())}
    errors = {
        name: found[name]["change"] - true for name, true in zip(NAMES, turn_deg, strict=True)
    }
    errors["time_offset"] = found["time_offset"]["change"] + latency_s
    errors["range_scale"] = found["range_scale"]["change"] + 1 - SPEED_MPS / told_mps
    if pitch_deg == 90.0:
        assert abs(errors["roll"]) < 0.3
        assert abs(errors["range_scale"]) < 0.003
    assert abs(errors["yaw"]) < 0.3
    assert abs(errors["time_offset"]) < 0.010
    for name in ("roll", "yaw", "time_offset", "range_scale"):
        assert abs(errors[name]) < 2.5 * found[name]["deviation"], name
    assert [one for one in found if not found[one]["observable"]] == ["pitch", "x", "y", "z"]
    assert math.isclose(found["pitch"]["change"], 0.0)
    assert found["pitch"]["deviation"] is None
    lines = yaml.safe_load((out / "calibration.yaml").read_text())
    assert lines["device"]["latency_sec"] == pytest.approx(latency_s, abs=0.010)
    assert lines["water"]["speed_of_sound"] == pytest.approx(SPEED_MPS, abs=9)
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
