"""The study of localization: its settings are settings, its figures right, its runs equal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from studies.accuracy_cost.localization import STUDY, dives, measuring
from studies.accuracy_cost.localization.dives import PLANS, FilterPlan, FilterRun
from studies.accuracy_cost.localization.knobs import SCALES, config_for, published_overrides
from studies.accuracy_cost.localization.measuring import Moments, figures_of
from studies.accuracy_cost.study import Setting, StudyDive
from studies.localization.world import WORLDS

from mapperd.config.tree import AmclConfig, Config, LocalizationConfig
from mapperd.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SETTINGS = [*(setting for knob in STUDY.knobs for setting in knob.settings), *STUDY.wholes]
TANK = WORLDS["tank"]
TIMES = {column.name for column in STUDY.columns if not column.repeatable}


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda setting: setting.key or "default")
def test_every_setting_is_one_and_turns_something(setting: Setting) -> None:
    config = config_for(TANK, setting.overrides, 1)
    assert (config == config_for(TANK, {}, 1)) == (not setting.overrides)


def test_a_setting_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ConfigError, match="max_beam"):
        config_for(TANK, {"amcl.max_beam": 60}, 1)


def test_published_is_what_the_defaults_are_but_for_the_map_being_planar() -> None:
    config = config_for(WORLDS["harbour"], published_overrides(), 0)
    assert config.amcl == AmclConfig()
    ours = msgspec.structs.replace(LocalizationConfig(), mode="global", geometry="2d")
    assert config.localization == ours


def test_factors_are_of_the_place() -> None:
    config = config_for(TANK, {"scale.cells": 2.0, "scale.step": 4.0}, 1)
    plain = config_for(TANK, {}, 1)
    assert config.octree.voxel_resolution == 2 * TANK.voxel_m
    assert config.amcl.update_min_d == 4 * plain.amcl.update_min_d == pytest.approx(0.12)
    assert config.localization.update_max_interval == 4 * plain.localization.update_max_interval
    assert config.amcl.laser_sigma_hit == plain.amcl.laser_sigma_hit


def moments(error_m: list[float], *, turn_rad: float = 0.0, unsure: bool = False) -> Moments:
    count = len(error_m)
    return Moments(
        np.array(error_m),
        np.full(count, turn_rad),
        np.full(count, unsure),
        np.full(count, 2.366),
        np.full(count + 1, 0.002),
        np.full(count, 0.004),
    )


def test_a_lost_vehicle_counts_as_far_off_as_it_matters() -> None:
    figures = figures_of([moments([0.1] * 8), moments([0.1] * 4 + [90.0] * 4)], 1.0, 0)
    assert figures["error_m"] == pytest.approx((0.1 + (0.1 + 2.0) / 2) / 2)
    assert figures["error_se_m"] == pytest.approx(0.95 / 2)
    assert figures["success"] == 0.5
    assert figures["wrong_and_sure"] == 0.25
    assert figures["p95_m"] == 90.0


def test_quantiles_are_those_of_errors_and_times_that_differ() -> None:
    spread = np.arange(101) / 100.0
    run = Moments(spread, spread, spread > 2.0, 2.366 * spread, spread, spread)
    figures = figures_of([run], 9.0, 0)
    assert (figures["median_m"], figures["p95_m"]) == pytest.approx((0.5, 0.95))
    assert figures["heading_p95_deg"] == pytest.approx(math.degrees(0.95))
    assert (figures["update_median_ms"], figures["update_p95_ms"]) == pytest.approx((500.0, 950.0))
    assert figures["nees"] == pytest.approx(0.5)


def test_a_turned_pose_is_wrong_and_one_that_is_reported_is_not_sure() -> None:
    figures = figures_of([moments([0.1] * 8, turn_rad=0.5)], 1.0, 3_000_000)
    assert (figures["success"], figures["wrong_and_sure"]) == (0.0, 1.0)
    assert figures["heading_median_deg"] == pytest.approx(math.degrees(0.5))
    assert figures_of([moments([9.0] * 8, unsure=True)], 1.0, 0)["wrong_and_sure"] == 0.0
    assert figures["memory_mb"] == 3.0


def test_time_is_of_every_ping_and_of_updates_apart() -> None:
    figures = figures_of([moments([0.1] * 8)], 1.0, 0)
    assert figures["cpu_ms_per_ping"] == pytest.approx(2.0)
    assert figures["update_median_ms"] == pytest.approx(4.0)
    assert figures["nees"] == pytest.approx(1.0)
    assert set(figures) == {column.name for column in STUDY.columns}


def test_a_run_without_a_pose_is_a_lost_one() -> None:
    figures = figures_of([moments([])], 0.3, 0)
    assert (figures["error_m"], figures["success"]) == (0.6, 0.0)
    assert math.isnan(figures["median_m"])


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[StudyDive, Path]]:
    """A few seconds in the tank, on a coarse map alone."""
    dive, folder = StudyDive("tank", 5), tmp_path_factory.mktemp("tank")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dives, "CELLS", (5.0,))
        patch.setitem(PLANS, "tank", FilterPlan("tank", 6.0, 1, 2))
        STUDY.prepare(dive, folder)
        yield dive, folder


COARSE = Setting("coarse", {"scale.cells": 5.0, "localization.search_poses": 0})


def test_prepared_scans_are_those_that_were_cast(tank: tuple[StudyDive, Path]) -> None:
    dive, folder = tank
    (run,) = dives.load_runs(dive, folder)
    assert len(run.scans) == len(run.true) == len(run.odometry) == 15
    stamps = [scan.stamp_ns for scan in run.scans]
    assert np.diff(stamps).tolist() == [400_000_000] * 14
    for scan in run.scans:
        along = np.linalg.norm(scan.points_m, axis=1)
        assert len(scan) > 20
        assert along == pytest.approx(scan.range_m, abs=1e-9)
    assert run.start is not None
    assert math.hypot(run.start.x_m - run.true[0, 0], run.start.y_m - run.true[0, 1]) < 1.5


def test_what_is_prepared_is_kept(tank: tuple[StudyDive, Path]) -> None:
    dive, folder = tank
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert set(before) == {"cells-5.map", "run-0.npz"}
    STUDY.prepare(dive, folder)
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before


@pytest.mark.slow
def test_a_dive_is_localized_alike_every_time_and_better_than_by_odometry(
    tank: tuple[StudyDive, Path],
) -> None:
    dive, folder = tank
    once, again = (STUDY.measure(COARSE, dive, folder) for _ in range(2))
    assert {name: once[name] for name in once if name not in TIMES} == {
        name: again[name] for name in again if name not in TIMES
    }
    assert once["error_m"] < 0.3
    assert 0 < once["cpu_ms_per_ping"] <= 1e3


@pytest.mark.slow
def test_errors_are_those_of_the_pose_that_the_vehicle_would_use(
    tank: tuple[StudyDive, Path],
) -> None:
    dive, folder = tank
    (run,) = dives.load_runs(dive, folder)
    true = run.true + np.array([0.0, 7.0, 0.0, 0.0, 0.0, 1.0])
    moved = FilterRun(run.scans, true, run.odometry, run.start)
    config = config_for(TANK, COARSE.overrides, 1)
    path = dives.map_path(folder, 5.0)
    ((here,), _), ((there,), _) = (measuring.localize(path, [r], 1, config) for r in (run, moved))
    assert there.error_m == pytest.approx(7.0, abs=2 * here.error_m.max())
    assert there.turn_rad == pytest.approx(1.0, abs=2 * here.turn_rad.max())
    assert there.nees.min() > here.nees.max()


def test_defaults_of_the_knobs_are_the_published_ones_only_where_they_are_reported() -> None:
    published = Config()
    for knob in STUDY.knobs:
        stated = next((s for s in knob.settings if s.label == knob.published), None)
        if stated is None:
            continue
        config = config_for(WORLDS["harbour"], stated.overrides, 0)
        turned = {name for setting in knob.settings for name in setting.overrides}
        for name in (n for turn in turned for n in SCALES.get(turn, (turn,))):
            section, field = name.split(".")
            wanted = getattr(getattr(published, section), field)
            wanted = "2d" if field == "geometry" else wanted
            assert getattr(getattr(config, section), field) == wanted, (knob.name, name)


def test_runs_that_are_lost_know_nothing_or_are_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dives, "CELLS", ())
    monkeypatch.setitem(PLANS, "lost", FilterPlan("pile_field", 0.8, 3, 1, anywhere=1, wrong=1))
    dive = StudyDive("lost", 5)
    STUDY.prepare(dive, tmp_path)
    anywhere, wrong, known = dives.load_runs(dive, tmp_path)
    assert anywhere.start is None
    off_m = [
        math.hypot(run.start.x_m - run.true[0, 0], run.start.y_m - run.true[0, 1])
        for run in (wrong, known)
        if run.start is not None
    ]
    assert off_m[0] > 3.0
    assert off_m[1] < 2.0
