"""The study of mapping on its smallest dive."""

import math
from pathlib import Path

import numpy as np
import pytest
from studies.accuracy_cost.mapping import STUDY
from studies.accuracy_cost.mapping.dives import capture_of, made_by
from studies.accuracy_cost.mapping.knobs import (
    KNOBS,
    PROFILE_FOLDER,
    PUBLISHED,
    PUBLISHED_FILE,
    WHOLES,
    Thinning,
    config_for,
)
from studies.accuracy_cost.mapping.measuring import CONVERGED, Driven, drive, same_rule
from studies.accuracy_cost.mapping.metrics import reliability
from studies.accuracy_cost.mapping.recalibration import FILE, estimates_and_truth
from studies.accuracy_cost.study import Setting, StudyDive

from mapperd.config.loader import load_config
from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from mapperd.export.calibration import load_calibration
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.recording import OCULUS, open_recording
from oculus_driver.stream import StreamParser

BASIN = next(dive for dive in STUDY.dives if dive.quick)
DEFAULT = Setting("default", {})
COARSE = {"octree.voxel_resolution": 0.1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("dives")
    STUDY.prepare(BASIN, made)
    return made


def driven(folder: Path, **overrides: float | str | bool) -> Driven:
    stated = COARSE | {name.replace("__", "."): value for name, value in overrides.items()}
    return drive(Setting("tried", stated), made_by(BASIN), capture_of(BASIN, folder))


def first_ping(folder: Path) -> Ping:
    parser = StreamParser()
    with open_recording(capture_of(BASIN, folder)) as recording:
        for chunk in recording:
            if chunk.encoding == OCULUS:
                for message in parser.feed(chunk.data, chunk.arrival_ns):
                    ping = decode_ping(message)
                    assert isinstance(ping, Ping)
                    return ping
    raise AssertionError


@pytest.mark.slow
def test_every_ping_is_mapped_and_all_figures_are_there(folder: Path) -> None:
    row = STUDY.measure(Setting("coarse", COARSE), BASIN, folder)
    assert list(row) == [column.name for column in STUDY.columns]
    assert row["mapped_share"] == 1.0
    assert 0.0 < row["accuracy_median_m"] < row["accuracy_p95_m"] < 1.0
    assert 0.5 < row["roc_area"] <= 1.0
    assert row["ping_cpu_ms"] > 0.0
    assert math.isnan(row["log_odds_error"])  # another grid
    again = STUDY.measure(Setting("coarse", COARSE), BASIN, folder)
    for column in STUDY.columns:
        if column.repeatable:
            assert row[column.name] == pytest.approx(again[column.name], abs=0, nan_ok=True)


def test_preparing_again_leaves_the_files_alone(folder: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    STUDY.prepare(BASIN, folder)
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_the_converged_map_has_no_error_and_a_coarser_grid_has_some(folder: Path) -> None:
    assert STUDY.measure(CONVERGED, BASIN, folder)["log_odds_error"] == 0.0
    default = STUDY.measure(DEFAULT, BASIN, folder)["log_odds_error"]
    loose = STUDY.measure(Setting("loose", {"mapping.detail": 0.25}), BASIN, folder)
    assert 0.0 < default < loose["log_odds_error"]


def test_profiles_err_less_than_the_published_aperture_on_their_grids(folder: Path) -> None:
    wholes = {whole.label: whole for whole in WHOLES}
    found = []
    for name, voxel_m in (("survey", 0.05), ("balanced", 0.1), ("low_power", 0.2)):
        assert wholes[name].overrides["octree.voxel_resolution"] == voxel_m
        wide = {"octree.voxel_resolution": voxel_m, "sonar.vertical_aperture": 20.0}
        settings = (wholes[name], Setting("wide", wide))
        own, other = (STUDY.measure(setting, BASIN, folder)[STUDY.error] for setting in settings)
        assert own < 0.97 * other, name
        found.append(own)
    assert found == sorted(found)


def test_calibrated_probabilities_are_shares_where_the_curve_was_not_fitted(folder: Path) -> None:
    log_odds, solid = estimates_and_truth(BASIN, folder)
    assert reliability(log_odds, solid).worst > 0.2
    mended = load_calibration(FILE).log_odds_of(log_odds)
    assert reliability(mended, solid).worst < 0.1


def test_frame_skip_costs_pings_and_their_time_counts_for_all(folder: Path) -> None:
    skipping = driven(folder, processing__frame_skip=4)
    assert (skipping.pings, len(skipping.mapped_ms)) == (16, 4)
    assert skipping.ms_per_ping == pytest.approx(sum(skipping.mapped_ms) / 16)


@pytest.mark.parametrize("name", ["low_power", "balanced", "survey"])
def test_a_profile_is_a_file_of_settings(name: str) -> None:
    assert load_config(PROFILE_FOLDER / f"{name}.yaml").octree.voxel_resolution in (0.05, 0.1, 0.2)


def test_pose_policies_give_different_maps(folder: Path) -> None:
    maps = {
        policy: driven(folder, time_sync__policy=policy).map.sha256()
        for policy in ("interpolate", "nearest", "latest")
    }
    assert len(set(maps.values())) == 3


def test_thinning_keeps_the_fan_and_the_loudest(folder: Path) -> None:
    ping = first_ping(folder)
    thin = Thinning(beams=4, rows=5).of(ping)
    assert (thin.beams, thin.rows) == (ping.beams // 4, ping.rows // 5)
    assert thin.max_range_m == pytest.approx(ping.max_range_m)
    assert np.array_equal(thin.image[3], ping.image[15:20, 2::4].max(axis=0))
    assert np.array_equal(thin.bearings_rad, ping.bearings_rad[2::4])
    assert Thinning().of(ping) is ping


def test_settings_reach_the_daemon_and_wrong_ones_are_refused() -> None:
    made = made_by(BASIN)
    config, thinning = config_for(Setting("s", {"iwlo.sharpness": 1.5, "study.beams": 2}), made)
    assert config.iwlo.sharpness == 1.5
    assert config.mounting.orientation.pitch == made.mounting.pitch_deg
    assert thinning == Thinning(beams=2)
    with pytest.raises(ConfigError, match="no such setting"):
        config_for(Setting("s", {"iwlo.sharpnes": 1.5}), made)


def test_a_sonar_that_is_asked_for_fewer_beams_sends_fewer() -> None:
    asked = Setting("s", {"device.beams": 256})
    wide = next(dive for dive in STUDY.dives if made_by(dive).sonar.beams == 512)
    assert config_for(asked, made_by(wide))[1] == Thinning(beams=2)
    assert config_for(asked, made_by(BASIN))[1] == Thinning()  # it has no more


def test_each_knob_has_its_default_and_the_published_setting() -> None:
    for knob in KNOBS:
        labels = [setting.label for setting in knob.settings]
        assert [s.label for s in knob.settings if not s.overrides] != [], knob.name
        assert len({setting.key for setting in knob.settings}) == len(labels), knob.name
        assert knob.published is None or knob.published in labels, knob.name
        for setting in knob.settings:
            config_for(setting, made_by(BASIN))


def test_a_knob_of_its_own_error_has_one_at_each_setting() -> None:
    own = [knob for knob in KNOBS if knob.error is not None]
    assert own
    for knob in own:
        assert knob.error in {column.name for column in STUDY.columns}
        assert all(same_rule(setting, DEFAULT) for setting in knob.settings), knob.name


def test_a_default_without_overrides_is_the_daemons_default() -> None:
    for knob in KNOBS:
        default = next(setting for setting in knob.settings if not setting.overrides)
        for setting in knob.settings:
            for name, value in setting.overrides.items():
                if name.startswith("study."):
                    continue
                section, field = name.split(".")
                now = getattr(getattr(Config(), section), field)
                assert value != now or len(setting.overrides) > 1, (knob.name, default.label)


def test_a_default_is_labelled_as_what_the_daemon_has() -> None:
    labelled = 0
    for knob in KNOBS:
        names = {name for setting in knob.settings for name in setting.overrides}
        numbers = all(setting.label[0].isdigit() for setting in knob.settings)
        if len(names) > 1 or not numbers or next(iter(names)).startswith("study."):
            continue
        section, field = next(iter(names)).split(".")
        default = next(setting for setting in knob.settings if not setting.overrides)
        value = getattr(getattr(Config(), section), field)
        assert default.label.rstrip(" m°") == str(value), knob.name
        labelled += 1
    assert labelled > 8


def test_the_published_system_is_slow_to_see_and_old_in_its_poses() -> None:
    config, _ = config_for(PUBLISHED, made_by(BASIN))
    assert config.mapping.integrator == "rays"
    assert config.time_sync.policy == "latest"
    assert (config.processing.frame_skip, config.octree.voxel_resolution) == (5, 0.05)
    assert config.adaptive.min_ratio == 0.0
    assert config.sonar.vertical_aperture == 20.0  # of the data sheet, one way
    assert PUBLISHED in WHOLES


def test_the_sonars_of_all_dives_are_those_of_the_default_aperture() -> None:
    for dive in STUDY.dives:
        both_ways_deg = np.degrees(made_by(dive).sonar.vertical_width_rad) / np.sqrt(2)
        assert Config().sonar.vertical_aperture == pytest.approx(both_ways_deg, rel=0.02)
        assert config_for(DEFAULT, made_by(dive))[0].sonar == Config().sonar


def test_the_published_file_is_coarse_and_trusts_each_echo_alike() -> None:
    config, _ = config_for(PUBLISHED_FILE, made_by(BASIN))
    assert config.mapping.integrator == "rays"
    assert (config.processing.frame_skip, config.octree.voxel_resolution) == (5, 0.2)
    assert (config.filtering.intensity_threshold, config.filtering.min_range) == (100.0, 1.0)
    assert (config.iwlo.L_occ, config.iwlo.L_free) == (2.0, -4.0)
    assert (config.iwlo.L_min, config.iwlo.L_max) == (-12.0, 8.0)
    assert (config.iwlo.sharpness, config.iwlo.min_alpha) == (0.1, 0.3)
    assert (config.iwlo.decay_rate, config.mapping.occupied_threshold) == (0.1, 0.7)
    assert config.sonar.vertical_aperture == 20.0
    assert PUBLISHED_FILE in WHOLES


def test_other_rules_are_not_compared_with_the_converged_map() -> None:
    assert same_rule(Setting("s", {"mapping.integrator": "rays", "study.beams": 2}), DEFAULT)
    for name in ("iwlo.min_alpha", "octree.voxel_resolution", "mapping.aggregation"):
        assert not same_rule(Setting("s", {name: 0.3}), DEFAULT), name


def test_an_unknown_dive_is_refused() -> None:
    with pytest.raises(KeyError):
        made_by(StudyDive("moon", 1))
