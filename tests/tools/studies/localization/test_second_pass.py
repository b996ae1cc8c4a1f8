"""Two passes over one place: how their maps are compared, and a small dive through all of it."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from sonar_sim import FramePose, SonarSettings
from sonar_sim.capture import CaptureSettings, ping_times_s
from sonar_sim.geometry.pose import rotation_of
from studies.localization.pass_maps import FRESH, Pass, navigation
from studies.localization.second_pass import Fans, SecondPass, agreement, in_fans, run, to_nearest
from studies.localization.world import WORLDS, DiveWorld, OdometryDrift

if TYPE_CHECKING:
    from pathlib import Path

HARBOUR = dataclasses.replace(WORLDS["harbour"], speed_mps=0.8, voxel_m=0.2)
DRIFT_DPM = 1.0
FIRST = Pass(((-3, -3, 80), (3, -3, 80)), drift=FRESH, ping_rate_hz=3.0)
SECOND = Pass(
    ((3, -4, 100), (-4, -4, 100)),
    away=((3, -3, 80), (15, -9, 0), (-15, -9, 0), (15, -9, 0), (3, -9, 90)),
    drift=OdometryDrift(0.02, math.radians(DRIFT_DPM) / 60.0),
    ping_rate_hz=3.0,
    seed=2,
)


def test_maps_agree_by_the_nearest_voxel_either_way() -> None:
    first = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [9, 0, 0]])
    second = np.array([[0.1, 0, 0], [1, 0.2, 0], [2, 0, 0]])
    there, back = to_nearest(second, first), to_nearest(first, second)
    assert there == pytest.approx([0.1, 0.2, 0.0])
    assert back == pytest.approx([0.1, 0.2, 0.0, 7.0])
    figures = agreement(there, 0.1)
    assert (figures.voxels, figures.median_m) == (3, 0.1)
    assert figures.within_voxel == pytest.approx(2 / 3, abs=1e-3)
    assert np.isinf(to_nearest(second, first[:0])).all()
    with pytest.raises(ValueError, match="no voxel"):
        agreement(there[:0], 0.1)


def test_fan_has_what_lies_before_the_sonar() -> None:
    sonar = SonarSettings(demanded_range_m=10.0)
    west = FramePose(np.array([5.0, 1.0, -2.0]), rotation_of(0, 0, math.pi))
    aside, up = sonar.half_aperture_rad, sonar.vertical_width_rad / 2
    points = [
        (-4.5, 1.0, -2.0),
        (-6.0, 1.0, -2.0),
        (6.0, 1.0, -2.0),
        (5 - 4 * math.cos(0.98 * aside), 1 + 4 * math.sin(0.98 * aside), -2.0),
        (5 - 4 * math.cos(1.02 * aside), 1 + 4 * math.sin(1.02 * aside), -2.0),
        (1.0, 1.0, -2 + 4 * math.tan(0.95 * up)),
        (1.0, 1.0, -2 + 4 * math.tan(1.05 * up)),
    ]
    seen = in_fans(np.array(points), Fans([west], sonar))
    assert seen.tolist() == [True, False, False, True, False, True, False]


def test_odometry_begins_at_the_truth_and_drifts_while_the_sonar_is_silent() -> None:
    scenario = SECOND.over(DiveWorld(HARBOUR).scenario, HARBOUR)
    quiet_s = SECOND.quiet_s(HARBOUR)
    stated = navigation(scenario.trajectory, HARBOUR, SECOND)
    assert stated[0].pose.position_m == pytest.approx(
        scenario.trajectory.pose(0.0).position_m, abs=0.03
    )
    pings_s = ping_times_s(scenario, CaptureSettings(quiet_s=quiet_s))
    assert pings_s[0] == pytest.approx(quiet_s + 0.5)
    assert pings_s[-1] < scenario.trajectory.duration_s
    at = next(sample for sample in stated if sample.time_s >= quiet_s)
    off = at.pose.rotation @ scenario.trajectory.pose(at.time_s).rotation.T
    turned_deg = abs(math.degrees(math.atan2(off[1, 0], off[0, 0])))
    assert turned_deg == pytest.approx(DRIFT_DPM * quiet_s / 60, abs=0.4)


@pytest.mark.slow
def test_second_pass_lands_on_the_first(tmp_path: Path) -> None:
    found = run(SecondPass(HARBOUR, FIRST, SECOND, truth_voxels=200), tmp_path)
    assert found.place_end_m < 0.5 * found.odometry_end_m  # it begins half a metre off
    assert found.corrected.to_first.median_m <= found.voxel_m
    assert found.corrected.to_first.within_voxel > found.uncorrected.to_first.within_voxel + 0.1
    assert (tmp_path / "second-pass.png").stat().st_size < 400_000
