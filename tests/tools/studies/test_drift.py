"""The study of drift: its odometry beside closed forms, its figures beside known errors."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint
from studies.drift import dives as dives_module
from studies.drift import judge, run
from studies.drift.dives import DIVES, KINDS, DriftingDive, DriftKind, navigation, write_odometry
from studies.drift.judge import PoseTrack, loop_errors, read_loops, track_errors

from mapperd.config.tree import Config

START_S = 1.7e9


class Straight(DriftingDive):
    """Due east at 1 m/s for 100 s, without waves."""

    def path(self) -> Trajectory:
        points = [Waypoint(0, 0, -2, 0), Waypoint(100, 0, -2, 0)]
        return Trajectory(points, Motion(1.0, smoothing_s=0.01, sway_deg=0.0, heave_m=0.0))


STRAIGHT = Straight("straight", "flat_floor", 8.0, 50.0, 20.0, 60.0, (), -2.0, 1.0, (40.0, 60.0))


def drifted(monkeypatch: pytest.MonkeyPatch, drift: DriftKind) -> dives_module.DriftedTrack:
    monkeypatch.setitem(KINDS, "tried", drift)
    return navigation(STRAIGHT, "tried", 1)


def test_scale_and_crab_move_the_end_of_a_straight_way(monkeypatch: pytest.MonkeyPatch) -> None:
    end_m = drifted(monkeypatch, DriftKind(0.03, 0.04, 0.0)).position_m[-1]
    assert abs(end_m[0] - 100.0) == pytest.approx(3.0, abs=0.3)
    assert abs(end_m[1]) == pytest.approx(4.0, abs=0.4)
    assert end_m[2] == pytest.approx(-2.0, abs=0.1)


def test_drift_of_the_gyro_bends_a_straight_way(monkeypatch: pytest.MonkeyPatch) -> None:
    track = drifted(monkeypatch, DriftKind(0.0, 0.0, 3.0))
    turn_rad = math.radians(3.0) * 100.0 / 60.0
    yaw_rad = math.atan2(track.rotation[-1, 1, 0], track.rotation[-1, 0, 0])
    assert abs(yaw_rad) == pytest.approx(turn_rad, abs=0.005)
    assert abs(track.position_m[-1, 1]) == pytest.approx(50.0 * turn_rad, rel=0.1)
    assert abs(track.turn_rates_rps[:, 2].mean()) == pytest.approx(turn_rad / 100.0, rel=0.1)


def test_varying_drift_stays_within_its_size_and_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    track = drifted(monkeypatch, DriftKind(0.1, 0.0, 0.0, varies=True))
    over = track.velocity_mps[10:-10, 0] - 1.0
    assert np.abs(over).max() < 0.1 + 5 * dives_module.VELOCITY_NOISE_MPS
    assert np.ptp(over) > 0.05


def test_outages_are_marked_and_off_by_their_size(monkeypatch: pytest.MonkeyPatch) -> None:
    track = drifted(monkeypatch, DriftKind(0.0, 0.0, 0.0, outages=2))
    edges = np.flatnonzero(np.diff(track.in_outage.astype(int)))
    assert len(edges) == 4
    off_mps = track.velocity_mps[track.in_outage, :2] - (1.0, 0.0)
    size_mps = np.hypot(*off_mps.T)
    assert size_mps.min() > 0.05
    assert size_mps.max() < 0.25


def test_odometry_survives_its_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    track = drifted(monkeypatch, DriftKind())
    write_odometry(tmp_path / "odometry.mcap", track)
    read = judge.read_odometry_track(tmp_path / "odometry.mcap")
    np.testing.assert_allclose(read.position_m, track.position_m)
    np.testing.assert_allclose(np.diff(read.time_s), 0.1, atol=1e-6)


def circle(turn_rad: float = 0.0, shift_m: tuple[float, float] = (0.0, 0.0)) -> PoseTrack:
    """Once round a circle of 10 m in 60 s, seen from another frame."""
    angle = np.linspace(0.0, math.tau, 601)
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    x, y = 10.0 * np.cos(angle), 10.0 * np.sin(angle)
    yaw = angle + math.pi / 2 + turn_rad
    places = np.column_stack([c * x - s * y + shift_m[0], s * x + c * y + shift_m[1], 0 * x - 3])
    zero = np.zeros_like(yaw)
    return PoseTrack(
        START_S + np.linspace(0.0, 60.0, 601),
        places,
        np.column_stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)]),
    )


PINGS_S = START_S + np.arange(1.0, 59.0, 1.0 / 3.0)


def test_another_frame_of_the_same_track_is_no_error() -> None:
    errors = track_errors(circle(0.7, (5.0, -2.0)), circle(), PINGS_S)
    assert errors.rms_m == pytest.approx(0.0, abs=1e-6)
    assert errors.rms_deg == pytest.approx(0.0, abs=1e-4)
    assert errors.covered == 1.0


def test_error_is_counted_from_the_first_ping() -> None:
    track, true = circle(), circle()
    since_s = track.time_s - PINGS_S[0]
    moved = track.position_m + np.outer(np.maximum(since_s, 0.0), (0.03, 0.04, 0.0))
    errors = track_errors(replace(track, position_m=moved), true, PINGS_S)
    grown_m = 0.05 * (PINGS_S - PINGS_S[0])
    assert errors.rms_m == pytest.approx(math.sqrt(np.mean(grown_m**2)), rel=1e-6)
    assert errors.max_m == pytest.approx(grown_m[-1], rel=1e-6)


def test_wrong_depth_is_an_error() -> None:
    track = circle()
    raised_m = track.position_m + np.array([0.0, 0.0, 0.3])
    errors = track_errors(replace(track, position_m=raised_m), track, PINGS_S)
    assert errors.rms_m == pytest.approx(0.3)


def test_wrong_roll_is_an_error_of_the_attitude_alone() -> None:
    track, half_rad = circle(), math.radians(2.0) / 2.0
    w, _, _, z = track.quaternion.T
    c, s = math.cos(half_rad), math.sin(half_rad)
    rolled = np.column_stack([c * w, s * w, s * z, c * z])
    errors = track_errors(replace(track, quaternion=rolled), track, PINGS_S)
    assert errors.rms_deg == pytest.approx(2.0, abs=1e-3)
    assert errors.rms_m == pytest.approx(0.0, abs=1e-6)


def test_track_that_ends_early_covers_less() -> None:
    whole = circle()
    part = PoseTrack(whole.time_s[:301], whole.position_m[:301], whole.quaternion[:301])
    assert track_errors(part, whole, PINGS_S).covered == pytest.approx(0.5, abs=0.02)


def test_loops_are_judged_in_the_frame_of_their_first_node(tmp_path: Path) -> None:
    """A quarter of a circle on lies 10 m ahead and 10 m to port, turned by 90 degrees."""
    begin_s, end_s = START_S + 5.0, START_S + 20.0
    rows = [
        f"{begin_s},{end_s},10,10,{math.pi / 2},1",
        f"{begin_s},{end_s},10.6,10.8,{math.pi / 2},1",
        f"{begin_s},{end_s},10,10,{math.pi / 2 - math.tau + 0.02},1",
        f"{begin_s},{end_s},90,10,0,0",
    ]
    path = tmp_path / "loops.csv"
    path.write_text("\n".join(["t_i_s,t_j_s,x_m,y_m,yaw_rad,accepted", *rows]))
    errors = loop_errors(read_loops(path), circle())
    assert (errors.count, errors.wrong) == (3, 1)
    assert errors.worst_m == pytest.approx(1.0, abs=1e-3)
    assert errors.worst_deg == pytest.approx(math.degrees(0.02), abs=1e-2)
    assert errors.median_m == pytest.approx(0.0, abs=1e-3)


def tell_the_truth(recording: Path, _: Path, __: Config, out: Path) -> None:
    """An aligner that looks into the answers."""
    truth = judge.read_tum(recording.parent / "truth.tum")
    judge.write_tum(out / "trajectory.tum", truth)
    (out / "verdict.json").write_text(json.dumps({"corrected": True}))


def fail(*_: object) -> None:
    raise RuntimeError("no idea")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A short dive at a row of piles."""
    folder = tmp_path_factory.mktemp("drift")
    rounds = (((-9.0, 0.0), (-5.0, 0.0), (-5.0, 1.0)),)
    short = replace(DIVES["pile12"], rounds=rounds, range_m=6.0, gap_s=(4.0, 6.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(DIVES, "pile12", short)
        dives_module.simulate(short, folder, [1])
        yield folder


def task(folder: Path, kind: str, function: str) -> run.DriftTask:
    aligner = f"{__name__}:{function}"
    return run.DriftTask("pile12", kind, 1, 1, aligner, function, {}, maps=True, folder=folder)


@pytest.mark.slow
def test_true_poses_have_no_error_and_make_the_true_map(folder: Path) -> None:
    asked = task(folder, "constant", "tell_the_truth")
    run.run_task(asked)
    row = json.loads(asked.row_file.read_text())
    assert row["estimate"]["rms_m"] < 1e-6
    assert row["odometry"]["rms_m"] > 0.01
    assert row["maps"]["estimate"]["median_m"] == pytest.approx(
        row["maps"]["true"]["median_m"], abs=0.01
    )
    assert "corrected" in run.summary_table([row])


@pytest.mark.slow
def test_gap_leaves_out_its_pings_alone(folder: Path) -> None:
    dive = DIVES["pile12"]
    pings = [
        judge.mapped_voxels(folder / "pile12" / name, None, Config())[1]
        for name in ("pings.mcap", "pings-gap.mcap")
    ]
    assert pings == [len(dive.ping_times_s(gap=gap)) for gap in (False, True)]
    assert pings[0] - pings[1] == 6


@pytest.mark.slow
def test_row_is_kept_and_failure_is_told(folder: Path) -> None:
    asked = task(folder, "mild", "fail")
    assert "no idea" in run.run_task(asked)
    assert "is there" in run.run_task(asked)
    changed = replace(asked, settings={"filtering.intensity_threshold": 50.0})
    assert "is there" not in run.run_task(changed)
    rows = [json.loads(asked.row_file.read_text())]
    assert "RuntimeError" in run.table_of_rows(rows)
    assert "failed" in run.summary_table(rows)
