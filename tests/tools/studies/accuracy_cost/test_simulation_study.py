"""The simulator's study: what its settings mean, and a measurement of a small scene."""

import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sonar_sim import load_scenario, sonar_preset
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.errors import EffectError
from sonar_sim.raycast.fan import MARGIN_BEAMS
from studies.accuracy_cost.simulation import STUDY, ours, scenes
from studies.accuracy_cost.simulation.ours import widened
from studies.accuracy_cost.simulation.reference import (
    finer,
    in_cells,
    levelled,
    load_reference,
    margin_beams,
)
from studies.accuracy_cost.simulation.scenes import ELEVATIONS, NODES_PER_BEAM, making_of
from studies.accuracy_cost.simulation.study import NOT_RECORDED
from studies.accuracy_cost.study import Setting, StudyDive


def test_names_are_read_into_effects_tolerance_and_sampling() -> None:
    making = making_of(
        {
            "sim.effects": "all",
            "sim.effect.noise": False,
            "sim.effect.doppler": True,
            "sim.tolerance.level_db": 2.0,
            "sim.elevations": 16,
            "sim.nodes_per_beam": 2,
            "sim.beams": 128,
        }
    )
    assert making.effects.ground == "all"
    assert making.effects.forced == {"noise": False, "doppler": True}
    assert making.tolerance.level_db == 2.0
    assert (making.elevations, making.nodes_per_beam, making.beams) == (16, 2.0, 128)
    assert making.camera is None
    assert making_of({"sim.camera": "760x169"}).camera == (760, 169)


def test_without_overrides_all_is_as_recorded() -> None:
    making = making_of({})
    assert making.effects.ground == "auto"
    assert not making.effects.forced
    assert (making.elevations, making.nodes_per_beam) == (ELEVATIONS, NODES_PER_BEAM)


@pytest.mark.parametrize("name", ["sim.elevation", "sim.tolerance.level", "sim.effect.rain"])
def test_a_name_that_does_not_exist_is_refused(name: str) -> None:
    with pytest.raises((ValueError, EffectError), match=name.rpartition(".")[2]):
        making_of({name: 1})


def test_every_knob_has_one_default_and_knows_its_names() -> None:
    assert len({knob.name for knob in STUDY.knobs}) == len(STUDY.knobs)
    columns = {column.name for column in STUDY.columns}
    for knob in STUDY.knobs:
        assert [setting.key for setting in knob.settings].count("") == 1, knob.name
        assert knob.error is None or knob.error in columns
        for setting in knob.settings:
            making_of(setting.overrides)
    assert {STUDY.error, STUDY.cost} <= columns


def test_each_effect_is_a_knob_of_its_own() -> None:
    switched = {
        name.removeprefix("sim.effect.")
        for knob in STUDY.knobs
        for setting in knob.settings
        for name in setting.overrides
        if name.startswith("sim.effect.")
    }
    assert switched == set(EFFECTS) - NOT_RECORDED


def test_the_study_can_be_sent_to_another_process() -> None:
    assert pickle.loads(pickle.dumps(STUDY)) == STUDY  # noqa: S301 our own bytes


def test_finer_sonar_has_a_beam_at_each_bearing_of_the_sonars() -> None:
    sonar = sonar_preset(beams=64)
    fine = finer(sonar)
    sines = (np.arange(sonar.beams) - (sonar.beams - 1) / 2.0) * sonar.sine_pitch
    fine_sines = (np.arange(fine.beams) - (fine.beams - 1) / 2.0) * fine.sine_pitch
    margin = 4 * margin_beams(sonar)
    assert margin > 0
    assert fine_sines[margin : len(fine_sines) - margin : 4] == pytest.approx(sines)
    assert margin_beams(sonar_preset()) == MARGIN_BEAMS


def test_fewer_beams_are_compared_by_the_power_between_them() -> None:
    wide = widened(np.array([[0.0, 1.0, 1.0]]), 5)
    assert wide == pytest.approx(np.sqrt([[0.0, 0.5, 1.0, 1.0, 1.0]]))


def test_plan_view_is_read_where_the_published_pipeline_draws() -> None:
    plan = np.zeros((400, 578))
    # 8.5 m ahead, and the same range at 30° to starboard; see `classic.scan.cells`.
    plan[399 - 200, 289] = 0.5
    plan[399 - int(8.5 * math.cos(math.pi / 6) * 400 / 17), 289 + 100] = 0.25
    sonar = sonar_preset(beams=131, half_aperture_rad=math.radians(65.0), demanded_range_m=10.0)
    seen = in_cells(plan, math.radians(88.65), sonar)
    row = int(np.argmin(np.abs(sonar.row_centres_m - 8.51)))
    beam = round(0.5 / sonar.sine_pitch + 65.0)
    assert seen[row, 65] == 0.5
    assert np.isnan(seen[row, 0])
    assert np.isnan(seen[row, -1])
    around = seen[row - 4 : row + 5, beam - 1 : beam + 2]
    assert around.max() == 0.25


def test_its_values_are_read_as_the_levels_that_they_fit_best() -> None:
    sonar = sonar_preset()
    values = np.array([[0.1, 0.5, 0.9, np.nan]])
    truth = 10.0 ** ((-40.0 + 30.0 * np.array([[0.1, 0.5, 0.9, 0.2]])) / 20.0)
    read = levelled(values, truth, sonar)
    assert read[0, :3] == pytest.approx(truth[0, :3])
    assert np.isnan(read[0, 3])


TINY = StudyDive("tiny", seed=3)
ALL = {"sim_effects": "all"}
Measured = Callable[..., dict[str, float]]


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Measured:
    """Measures overrides on a floor seen by a sonar of few beams and coarse rows."""
    floor = load_scenario("flat_floor")
    sonar = replace(floor.sonar, beams=48, forced_rows=60, half_aperture_rad=math.radians(12.0))
    small = replace(floor, sonar=sonar)
    stretches = scenes.Stretches((0.5,), pings=1, grains=4, elevations=64)
    monkeypatch.setattr(scenes, "load_scenario", lambda _: small)
    monkeypatch.setitem(scenes.STRETCHES, TINY.name, stretches)
    STUDY.prepare(TINY, tmp_path)
    return lambda **overrides: STUDY.measure(
        Setting("", {name.replace("_", ".", 1): value for name, value in overrides.items()}),
        TINY,
        tmp_path,
    )


@pytest.mark.slow
def test_measuring_a_setting_fills_each_column_the_same_way_each_time(measured: Measured) -> None:
    default = measured()
    assert set(default) == {column.name for column in STUDY.columns}
    assert all(math.isfinite(value) for value in default.values())
    assert default["ping_cpu_ms"] > 0.0
    assert default["ping_memory_mb"] > 0.1
    again = measured()
    for column in STUDY.columns:
        assert not column.repeatable or again[column.name] == default[column.name], column.name


@pytest.mark.slow
def test_each_shortcut_is_an_error_of_its_own_kind(measured: Measured) -> None:
    whole = measured(**ALL)
    assert whole["image_rms_db"] < 0.05
    assert whole["grain_spread_db"] < 1.0  # of few pixels
    assert measured()["image_rms_db"] > 10.0 * whole["image_rms_db"]
    # Cells are cut along outlines: few rays err little, and on what is not flat.
    assert measured(**ALL, sim_elevations=4)["image_rms_db"] > 3.0 * whole["image_rms_db"]
    assert measured(**ALL, **{"sim_effect.gain": False})["image_rms_db"] > 10.0
    assert measured(**ALL, **{"sim_effect.quantisation": False})["image_rms_db"] > 0.1

    even = measured(**ALL, **{"sim_effect.speckle": False})
    assert even["grain_spread_db"] == pytest.approx(5.57, abs=0.5)
    assert even["image_rms_db"] == pytest.approx(whole["image_rms_db"])

    # The tail of what lies nearer would fill the gaps between few scatterers.
    no_tail = {"sim_effect.reverberation": False}
    sparse = measured(**ALL, **no_tail, sim_nodes_per_beam=0.2)
    assert sparse["grain_spread_db"] > 4.0 * sparse["grain_spread_chance_db"]
    assert whole["grain_spread_db"] < 3.0 * whole["grain_spread_chance_db"]


@pytest.mark.slow
def test_settings_that_change_nothing_of_the_surfaces_share_a_grain(
    measured: Measured, tmp_path: Path
) -> None:
    quiet, noisy, coarse = (
        measured(**setting)
        for setting in ({"sim_effect.noise": False}, {"sim_effect.noise": True}, {"sim_beams": 24})
    )
    of_grain = [name for name in quiet if name.startswith("grain")]
    assert [quiet[name] for name in of_grain] == [noisy[name] for name in of_grain]
    assert coarse["grain_spread_db"] != quiet["grain_spread_db"]
    assert len(list(tmp_path.glob("grain-*.npy"))) == 2


@pytest.mark.usefixtures("measured")
def test_what_is_cut_off_at_full_scale_is_so_in_the_expected_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usual = scenes.scenario_of(TINY)
    loud = replace(usual, sonar=replace(usual.sonar, gain_percent=90.0))
    monkeypatch.setattr(ours, "scenario_of", lambda _: loud)
    dive = StudyDive(TINY.name, seed=4)  # an engine of its own
    whole, cut = (
        ours.Ours(making_of({"sim.effect.saturation": on}), dive).pictures()[0].expected.max()
        for on in (False, True)
    )
    assert cut <= 2.0 / math.sqrt(math.pi) + 1e-6  # the rms of speckle whose every peak is cut
    assert whole > 2.0


def test_published_pipeline_is_measured_by_the_same_figures(measured: Measured) -> None:
    theirs = measured(sim_camera="76x17")
    assert theirs["image_rms_db"] > 2.0
    assert theirs["grain_spread_db"] == pytest.approx(4.7, abs=0.3)
    assert theirs["ping_cpu_ms"] > 0.0


@pytest.mark.slow
def test_reference_is_made_once_and_is_the_engines_own_picture_nearly(
    measured: Measured, tmp_path: Path
) -> None:
    path = tmp_path / "simulation-tiny.npz"
    made = path.stat().st_mtime_ns
    STUDY.prepare(TINY, tmp_path)
    assert path.stat().st_mtime_ns == made
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    reference = load_reference(TINY, tmp_path)
    (picture,) = reference.pictures
    assert picture.shape == (60, 48)
    assert reference.grain.spread_db == pytest.approx(5.57, abs=0.5)
    assert measured(**ALL)["beyond_tolerance"] < 0.001
