"""Dives: odometry that drifts as configured, and when the right mode counts as found."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from studies.localization.dives import WITHIN_M, Certainty, certainty_line, judged
from studies.localization.runs import FilterUpdate, settings
from studies.localization.world import WORLDS, DiveTrack, OdometryDrift, drifted, track_of

from mapperd.config.loader import config_from_text
from mapperd.config.tree import AmclConfig, LocalizationConfig
from mapperd.geometry.gaussian import Belief, PlanarGaussian

HARBOUR = WORLDS["harbour"]
ROOT = Path(__file__).resolve().parents[4]
PROFILE = (ROOT / "config" / "localization.yaml").read_text(encoding="utf-8")


def test_profile_is_the_one_that_was_measured() -> None:
    """What it does not name keeps its default, there as in the dives."""
    dived, offered = settings(HARBOUR, 0), config_from_text(PROFILE)
    for name in AmclConfig.__struct_fields__:
        measured = getattr(dived.amcl, name)
        if isinstance(measured, float):
            assert getattr(offered.amcl, name) == pytest.approx(measured, rel=1e-3), name
        else:
            assert getattr(offered.amcl, name) == measured, name
    for name in set(LocalizationConfig.__struct_fields__) - {"mode", "scan"}:
        wanted = getattr(dived.localization, name)
        # So many steps of way are 9.9 m there.
        about = pytest.approx(wanted, rel=0.02) if name == "alternative_interval" else wanted
        assert getattr(offered.localization, name) == about, name


def test_profile_is_the_one_of_the_page() -> None:
    page = (ROOT / "docs" / "guides" / "localization.md").read_text(encoding="utf-8")
    text = page.split("into `/etc/mapperd/conf.d`:")[1].split("```yaml\n")[1].split("```")[0]
    assert yaml.safe_load(text) == yaml.safe_load(PROFILE)


def test_odometry_is_off_by_its_share_of_the_way_and_turns() -> None:
    track = track_of(HARBOUR, 120.0, 0.4, seed=3)
    stated = drifted(track, HARBOUR, OdometryDrift(), seed=3)
    steps = np.hypot(*np.diff(stated[:, :2], axis=0).T)
    true = np.hypot(*np.diff(track.place[:, :2], axis=0).T)
    ratio = steps.sum() / true.sum()
    assert abs(ratio - 1.0) == pytest.approx(0.02, abs=1e-6)
    turned = np.unwrap(stated[:, 2] - track.place[:, 5])
    minutes = (track.time_s[-1] - track.time_s[0]) / 60.0
    assert abs(turned[-1] - turned[0]) == pytest.approx(math.radians(minutes), rel=1e-6)


def test_water_that_nobody_sees_carries_odometry_off() -> None:
    track = track_of(HARBOUR, 60.0, 0.4, seed=3)
    blind = drifted(track, HARBOUR, OdometryDrift(0.0, 0.0, through_water=True), seed=3)
    seen = drifted(track, HARBOUR, OdometryDrift(0.0, 0.0), seed=3)
    off_m = float(np.hypot(*(blind[-1] - seen[-1])[:2]))
    assert off_m == pytest.approx(0.05 * 60, rel=0.05)


def test_odometry_does_not_notice_being_carried_off() -> None:
    track = track_of(HARBOUR, 60.0, 0.4, seed=3)
    place = track.place.copy()
    place[75:, :2] += (8.0, -3.0)
    place[75:, 5] += 1.0
    stated = drifted(DiveTrack(track.time_s, place, 75), HARBOUR, OdometryDrift(0.0, 0.0), seed=3)
    assert stated[75, :2] == pytest.approx(stated[74, :2])
    assert stated[75, 2] == pytest.approx(stated[74, 2])
    assert np.hypot(*np.diff(stated[:, :2], axis=0).T).max() < 0.25
    toward = np.arctan2(*np.diff(stated[100:, :2], axis=0).T[::-1]) - stated[100:-1, 2]
    true = np.arctan2(*np.diff(place[100:, :2], axis=0).T[::-1]) - place[100:-1, 5]
    assert np.cos(toward - true).min() > 0.999


def moment(
    way_m: float, error_m: float, elsewhere: float = 0.0, turn_rad: float = 0.0
) -> FilterUpdate:
    there = PlanarGaussian(error_m, 0, turn_rad, np.eye(3))
    belief = Belief(there, there, np.ones(1), elsewhere, 1.0)
    return FilterUpdate(2 * way_m, way_m, np.zeros(3), belief, 0.0)


def test_right_mode_is_found_when_it_lasts_and_is_sure() -> None:
    ways = np.arange(0.0, 200.0, 5.0)
    found = judged((moment(w, 9.0 if w < 40 else 0.1) for w in ways), 1.0)
    assert (found.after_m, found.wrong, found.wrong_and_sure) == (40.0, 8, 8)
    unsure = judged((moment(w, 9.0 if w < 40 else 0.1, elsewhere=0.5) for w in ways), 1.0)
    assert (unsure.after_m, unsure.wrong_and_sure) == (None, 0)
    turned = judged((moment(w, 0.1, turn_rad=math.pi) for w in ways), 1.0)
    assert turned.after_m is None
    late = judged((moment(w, 9.0 if w < WITHIN_M + 10 else 0.1) for w in ways), 1.0)
    assert late.after_m is None


def test_being_carried_off_counts_from_then() -> None:
    ways = np.arange(0.0, 200.0, 5.0)
    found = judged((moment(w, 0.1 if w < 50 or w >= 100 else 9.0) for w in ways), 1.0, 100.0)
    assert found.after_m == 50.0


def test_certainty_counts_wrong_and_right_updates() -> None:
    line = certainty_line("tank", [Certainty(10, 1, 20, 15, 3.0), Certainty(5, 0, 7, 0, math.inf)])
    assert line.startswith("tank: 1 of 15 wrong and 15 of 27 right updates are certain;")
