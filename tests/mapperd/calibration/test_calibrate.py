"""Simulated dives with known errors: what is called observable is true, the rest is left."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from sonar_sim.capture import CaptureSettings, write_capture
from sonar_sim.scene_file import SHIPPED, load_scenario
from sonar_sim.wire import Network

from mapperd.calibration import dive as dive_module
from mapperd.calibration.agreement import PARAMETERS, Agreement
from mapperd.calibration.dive import read_dive
from mapperd.calibration.estimate import (
    Calibration,
    ParameterEstimate,
    _parameter,
    nearest_angles,
    start_of,
    yaml_lines,
)
from mapperd.cli.calibrate import _read
from mapperd.cli.mapperd import main
from mapperd.config.tree import Config, OrientationConfig
from mapperd.errors import ReplayError
from mapperd.session.recordings import files_in, sessions_of
from tests.mapperd.conftest import START_NS
from tests.support.shell_blocks import SCENE

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

ANGLES = ("roll", "pitch", "yaw")
DOWN = {"roll", "yaw", "time_offset", "range_scale"}
AHEAD = {"yaw", "time_offset"}
TOLERANCES = {"roll": 0.3, "pitch": 0.3, "yaw": 0.3, "time_offset": 0.010, "range_scale": 0.003}


@dataclass(frozen=True)
class Dive:
    """A dive with known errors.

    Attributes:
        pitch_deg: of the mounting in the settings; 90 looks down.
        turn_deg: true turn of the mounting about the vehicle's axes, from the settings.
        latency_s: of the pings.
        sent_mps: speed of sound that the sonar is set to.
        seed: of all noise.
    """

    pitch_deg: float
    turn_deg: tuple[float, float, float]
    latency_s: float
    sent_mps: float
    seed: int

    def mounting(self) -> Rotation:
        start = Rotation.from_euler("Y", self.pitch_deg, degrees=True)
        return Rotation.from_rotvec(self.turn_deg, degrees=True) * start

    def record(self, folder: Path) -> Path:
        scene = yaml.safe_load((SHIPPED / "calibration.yaml").read_text())
        angles = self.mounting().as_euler("ZYX", degrees=True)
        for name, angle in zip(("yaw_deg", "pitch_deg", "roll_deg"), angles, strict=True):
            scene["mounting"][name] = float(angle)
        scene["sonar"]["told_speed_mps"] = self.sent_mps
        if self.pitch_deg < 90.0:
            scene["sonar"]["ping_rate_hz"] = 3
            scene["trajectory"]["waypoints"] = [
                {"position_m": list(place), "yaw_deg": yaw} for *place, yaw in FORWARD
            ]
        file, recording = folder / "scene.yaml", folder / "dive.mcap"
        file.write_text(yaml.safe_dump(scene))
        network = Network(processing_s=self.latency_s)
        capture = CaptureSettings(
            seed=self.seed, processes=1, network=network, effects="auto,+motion"
        )
        write_capture(recording, load_scenario(str(file)), capture)
        return recording


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize(
    ("dive", "shown"),
    [
        (Dive(90.0, (3.0, 1.0, -2.5), 0.070, 1508, 14), DOWN),
        (Dive(90.0, (0.0, 2.0, -3.5), 0.020, 1478, 12), DOWN),
        (Dive(90.0, (-2.0, -1.5, 2.0), 0.045, 1500, 21), DOWN),
        (Dive(30.0, (-1.0, 1.5, 3.0), 0.030, 1480, 32), AHEAD),
        (Dive(30.0, (2.0, -1.0, -2.0), 0.060, 1505, 33), AHEAD),
        (Dive(30.0, (1.0, 1.0, 1.5), 0.025, 1490.07, 34), AHEAD),
    ],
    ids=["down 1", "down 2", "down 3", "ahead 1", "ahead 2", "ahead 3"],
)
def test_what_is_called_observable_is_true_and_the_rest_is_left(
    tmp_path: Path, dive: Dive, shown: set[str]
) -> None:
    settings, out = tmp_path / "settings.yaml", tmp_path / "out"
    settings.write_text(f"mounting: {{orientation: {{pitch: {dive.pitch_deg}}}}}\n")
    recording = dive.record(tmp_path)
    assert main(["calibrate", str(recording), "--config", str(settings), "--out", str(out)]) == 0
    found = {one["name"]: one for one in json.loads((out / "calibration.json").read_text())}
    truth = dict(zip(ANGLES, dive.turn_deg, strict=True))
    truth |= {"time_offset": -dive.latency_s, "range_scale": SPEED_MPS / dive.sent_mps - 1}
    observable = {name for name, one in found.items() if one["observable"]}
    # Looking down, the deviation of the yaw is close to the limit of what counts as observable.
    assert shown - {"yaw"} <= observable <= shown
    for name in observable:
        error = found[name]["change"] - truth[name]
        assert abs(error) < TOLERANCES[name], name
        assert abs(error) < 3 * found[name]["deviation"], name
    for name in found.keys() - observable:
        assert found[name]["change"] == 0.0, name
    lines = yaml.safe_load((out / "calibration.yaml").read_text())
    orientation = [lines["mounting"]["orientation"][name] for name in ("yaw", "pitch", "roll")]
    start = Rotation.from_euler("Y", dive.pitch_deg, degrees=True)
    written = Rotation.from_euler("ZYX", orientation, degrees=True) * start.inv()
    for name, turn_deg in zip(ANGLES, written.as_rotvec(degrees=True), strict=True):
        wanted = truth[name] if name in observable else 0.0
        assert turn_deg == pytest.approx(wanted, abs=TOLERANCES[name]), name
    assert lines["device"]["latency_sec"] == pytest.approx(dive.latency_s, abs=0.010)
    assert ("water" in lines) == ("range_scale" in observable)
    if "water" in lines:
        assert lines["water"]["speed_of_sound"] == pytest.approx(SPEED_MPS, rel=0.003)
    assert (out / "calibration.png").stat().st_size > 10_000


def _turned(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Rotation:
    return Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True)


@pytest.mark.parametrize("pitch_deg", [-90.0, -30.0, 0.0, 60.0, 89.9, 90.0, 90.1, 150.0])
def test_writes_angles_of_the_same_rotation(pitch_deg: float) -> None:
    random = np.random.default_rng(3)
    for _ in range(20):
        roll, yaw, *others = random.uniform(-180, 180, 4)
        rotation = _turned(roll, pitch_deg, yaw)
        angles = nearest_angles(rotation.as_matrix(), OrientationConfig(others[0], 20, others[1]))
        assert (rotation.inv() * _turned(*angles)).magnitude() < 1e-6


@pytest.mark.parametrize(
    ("before", "turn_deg", "after"),
    [
        ((0, 90, 0), (0, 0, -2.5), (0, 90, -2.5)),
        ((10, 90, 20), (0, 0, 5), (10, 90, 25)),
        ((0, 90, 0), (0, 1, 0), (0, 91, 0)),
        ((0, -90, 0), (0, 0, 3), (0, -90, 3)),
        ((180, 30, 0), (0, 0, 2), (180, 30, 2)),
        ((0, 120, 5), (0, 0, 2), (0, 120, 7)),
    ],
)
def test_leaves_the_angles_that_have_not_turned(
    before: tuple[float, float, float],
    turn_deg: tuple[float, float, float],
    after: tuple[float, float, float],
) -> None:
    turned = Rotation.from_rotvec(turn_deg, degrees=True) * _turned(*before)
    angles = nearest_angles(turned.as_matrix(), OrientationConfig(*before))
    assert np.exp(1j * np.radians(angles)) == pytest.approx(np.exp(1j * np.radians(after)))


@pytest.mark.parametrize("name", ["yaw", "range_scale", "time_offset"])
@pytest.mark.parametrize("factor", [-0.9, -1.1])
def test_writes_a_change_only_if_it_exceeds_its_deviation(name: str, factor: float) -> None:
    parameters = tuple(
        ParameterEstimate(one, 0.01 * factor if one == name else 0.0, 0.01) for one in PARAMETERS
    )
    config = Config()
    view, start = start_of(config)
    values = start + [one.change if one.significant else 0.0 for one in parameters]
    found = Calibration(parameters, start, values, view, compared=cast("Agreement", None))
    sections = {"yaw": "mounting", "range_scale": "water", "time_offset": "device"}
    lines = yaml.safe_load(yaml_lines(found, config, 1500.0))
    assert lines is None if factor > -1 else set(lines) == {sections[name]}


def test_reads_the_most_common_images_evenly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = yaml.safe_load(SCENE)
    scene["trajectory"]["waypoints"][1]["position_m"][0] = 6
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    recording = tmp_path / "dive.mcap"
    write_capture(recording, load_scenario(str(tmp_path / "scene.yaml")), CaptureSettings(seed=1))
    found, count = dive_module._pings, 0

    def first_ones_shorter(works: Any, config: Config) -> Iterator[Any]:
        nonlocal count
        for ping in found(works, config):
            count += 1
            yield replace(ping, image=ping.image[:-1]) if count <= 9 else ping

    monkeypatch.setattr(dive_module, "_pings", first_ones_shorter)
    monkeypatch.setattr(dive_module, "MIN_PINGS", 5)
    monkeypatch.setattr(dive_module, "MAX_PINGS", 8)
    (session,) = sessions_of(files_in([recording]))
    dive = read_dive(session, Config())
    assert count > 9 + 8
    assert len(dive.images) == 8
    steps_s = np.diff(dive.t_s)
    assert steps_s.max() < 2.1 * steps_s.min()
    assert dive.t_s[-1] - dive.t_s[0] > 0.6 * (count - 9) * 0.2


@pytest.fixture
def events(
    odometry_bytes: Any, ping_bytes: Any, monkeypatch: pytest.MonkeyPatch
) -> Callable[[int], list[Any]]:
    """Return a maker of a dive of 10 s, whose odometry comes 80 ms later from a record on."""
    monkeypatch.setattr(dive_module, "MIN_PINGS", 5)

    def made(late_from: int) -> list[Any]:
        found = []
        for k in range(100):
            data = odometry_bytes(clk="unix", t=START_NS + k * 10**8, p=(0.05 * k, 0.0, 0.0))
            found.append(("odometry", data, 0.1 * k + (0.08 if k >= late_from else 0.0)))
            found.append(("ping", ping_bytes(k + 1), 0.1 * k + 0.09))
        return found

    return made


@pytest.mark.parametrize(("late_from", "refitted"), [(100, ()), (50, ("vehicle",))])
def test_a_clock_that_is_fitted_anew_withholds_the_time_offset(
    late_from: int, refitted: tuple[str, ...], tmp_path: Path, write_recording: Any, events: Any
) -> None:
    recording = tmp_path / "dive.mcap"
    write_recording(recording, events(late_from))
    (session,) = sessions_of(files_in([recording]))
    dive = read_dive(session, Config())
    assert dive.refitted == refitted
    offset = _parameter("time_offset", 0.08, 0.001, dive.refitted)
    assert offset.observable == (not refitted)
    assert "clock_off" in offset.reason or not refitted
    assert _parameter("yaw", 2.0, 0.1, dive.refitted).observable


def test_uses_the_largest_usable_session_and_names_the_others(
    tmp_path: Path, write_recording: Any, events: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = events(100)
    pings = [one for one in 3 * whole if one[0] == "ping"]
    for name, part in {"a": whole[:20], "b": whole, "c": pings}.items():
        write_recording(tmp_path / f"{name}.mcap", part)
    sessions = [session for file in files_in([tmp_path]) for session in sessions_of([file])]
    assert len(_read(sessions, Config()).images) > 50
    (line,) = capsys.readouterr().err.splitlines()
    assert line.index("b.mcap") < line.index("a.mcap") < line.index("c.mcap")
    with pytest.raises(ReplayError, match="0 pings have poses"):
        _read(sessions[2:], Config())


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
