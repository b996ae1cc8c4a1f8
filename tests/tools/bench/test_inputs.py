"""The two looks: what they promise of poses and of pixels, and which contenders are chosen."""

from pathlib import Path

import numpy as np
import pytest
from bench import seabed
from bench.contenders import CONTENDERS, GRID_FIRST, GRID_FULL
from bench.inputs import AHEAD, DOWN, LOOKS, SETTINGS, ViewSetting, first_rows, loud_share, simulate
from bench.integrators import RESOLUTIONS_M, chosen, parse

LOOKING_DOWN = [setting for setting in SETTINGS if setting.look == DOWN]


def test_each_look_has_both_ranges() -> None:
    found = {(setting.look, setting.range_m) for setting in SETTINGS}
    assert found == {(look, range_m) for look in (DOWN, AHEAD) for range_m in (10.0, 30.0)}
    assert set(RESOLUTIONS_M) == {0.05, 0.1}


@pytest.mark.parametrize("range_m", [10.0, 30.0])
def test_looking_down_is_a_survey_line_at_0_6_of_the_range(range_m: float) -> None:
    poses = LOOKS[DOWN].poses(range_m, 9)
    positions_m = np.array([pose.position_m for pose in poses])
    forward = np.array([pose.rotation[:, 0] for pose in poses])
    assert np.all(forward[:, 2] < -np.cos(np.radians(2.0)))  # the sea sways it by a degree or so
    # 0.5 m/s and 10 pings a second.
    assert np.diff(positions_m[:, 0]) == pytest.approx(0.05, abs=1e-3)
    floor_m = seabed.height_m(positions_m[:, 0], positions_m[:, 1])
    assert positions_m[:, 2] - floor_m == pytest.approx(0.6 * range_m, abs=0.7)


@pytest.mark.parametrize("setting", LOOKING_DOWN, ids=lambda setting: f"{setting.range_m:g} m")
def test_looking_down_one_to_two_pixels_in_a_hundred_are_loud(setting: ViewSetting) -> None:
    pings = simulate(setting, pings=1, seed=7)
    assert pings.images.shape == (1, 500, 512)
    assert 0.01 < loud_share(pings) < 0.02
    rows = first_rows(pings.images[0], pings.range_resolution_m)[236:276]
    # Straight below there is the seabed, at 0.6 of 500 rows, or something on it. Speckle fades in
    # few beams.
    seen = rows[rows >= 0]
    assert len(seen) > 0.85 * len(rows)
    assert np.all((seen > 240) & (seen < 320))


def test_all_contenders_run_unless_words_choose_some() -> None:
    assert chosen([]) == list(CONTENDERS)
    assert {c.name for c in chosen(["octomap", "grid 2"])} == {
        "octomap",
        "grid 2 first returns",
        "grid 2 full image",
    }


def test_motion_is_timed_with_one_thread_of_the_evidence_grid() -> None:
    timed = [c for c in CONTENDERS if "--motion" in c.words]
    assert timed == [GRID_FIRST, GRID_FULL]


def test_both_looks_by_default() -> None:
    assert parse([]).looks == [DOWN, AHEAD]
    assert parse(["--looks", "down"]).looks == [DOWN]


def test_the_checkout_of_bonxai_comes_from_an_option_or_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("BONXAI_PATH", raising=False)
    assert parse([]).bonxai is None
    monkeypatch.setenv("BONXAI_PATH", "/there")
    assert parse([]).bonxai == Path("/there")
    assert parse(["--bonxai", "/here"]).bonxai == Path("/here")
