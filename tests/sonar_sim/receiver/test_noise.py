import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.physics import InterferencePulse, Physics, Reverberation
from sonar_sim.receiver.beamformer import beam_former
from sonar_sim.receiver.noise import (
    add_arrival,
    add_crosstalk,
    add_random,
    add_tail,
    column_sines,
    noise_rms,
    pose_key,
    stream_key,
    tail_power,
    volume_rms,
)
from sonar_sim.scene.material import Material
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.setups import MEAN, cell_power, rectangle

SONAR = dataclasses.replace(SonarSettings(), demanded_range_m=1.6)
MARGIN = 12
COLUMNS = SONAR.beams + 2 * MARGIN
SPEED = 1500.0


def physics(**changes: object) -> Physics:
    settings: dict[str, object] = {
        "beam_width_rad": SONAR.beam_width_rad,
        "side_lobe_db": 30.0,
        "sine_bearings": True,
        "range_spread": True,
        "spreading": True,
        "vertical_width_rad": SONAR.vertical_width_rad,
    }
    return Physics(**(settings | changes))  # type: ignore[arg-type]


def field() -> np.ndarray:
    return np.zeros((SONAR.rows, COLUMNS), dtype=np.complex64)


def power() -> np.ndarray:
    return np.zeros((SONAR.rows, COLUMNS), dtype=np.float32)


def level_db(cells: np.ndarray) -> float:
    values = np.square(np.abs(cells)) if np.iscomplexobj(cells) else cells
    return float(10.0 * np.log10(np.mean(values, dtype=np.float64)))


def test_streams_have_keys_of_their_own() -> None:
    keys = {stream_key(seed, name, ping) for seed in (0, 1) for name in "ab" for ping in (0, 1)}
    assert len(keys) == 8
    assert all(0 <= key < 2**64 for key in keys)
    assert stream_key(1, 23) != stream_key(12, 3)


@pytest.mark.parametrize("cells", [field(), power()], ids=["field", "power"])
@pytest.mark.parametrize("side_lobe_db", [None, 30.0])
def test_noise_has_its_level_in_the_beams(cells: np.ndarray, side_lobe_db: float | None) -> None:
    cells = np.zeros_like(cells)
    settings = physics(noise_level_db=63.0, side_lobe_db=side_lobe_db)
    former = beam_former(SONAR, settings, MARGIN)
    everywhere = np.ones(COLUMNS, dtype=np.float32)
    add_random(cells, noise_rms(SONAR, settings, former.noise_gain), everywhere, key=5)
    assert level_db(former.form(cells)[5:-5, 30:-30]) == pytest.approx(63.0, abs=0.15)


def test_volume_follows_its_formula() -> None:
    settings = physics(volume_strength_db=-60.0, attenuation_db_per_m=0.2)
    row_rms, column_rms = volume_rms(SONAR, settings, COLUMNS)
    range_m = SONAR.row_centres_m
    found_db = 20.0 * np.log10(row_rms * column_rms[COLUMNS // 2])
    # The integral of sinc(k w)^4, k = 2.551 for 20 deg, is 2 / 3k: 0.75 of the width.
    column_sr = SONAR.sine_pitch * 2.0 / (3.0 * 2.551)
    expected_db = (
        SONAR.source_level_db
        - 60.0
        - 20.0 * np.log10(range_m)
        - 0.4 * range_m
        + 10.0 * math.log10(SONAR.range_resolution_m * column_sr)
    )
    assert found_db == pytest.approx(expected_db, abs=0.05)
    assert np.ptp(found_db - expected_db) < 1e-3


def test_volume_falls_by_20_db_a_decade() -> None:
    row_rms, _ = volume_rms(SONAR, physics(volume_strength_db=-60.0), COLUMNS)
    slope = np.polyfit(np.log10(SONAR.row_centres_m[20:]), 20.0 * np.log10(row_rms[20:]), 1)[0]
    assert slope == pytest.approx(-20.0, abs=0.01)


def test_whole_sphere_of_columns_is_half_a_sphere_of_water() -> None:
    """Without a vertical pattern the columns between -90 and 90 degrees cover all that is ahead."""
    settings = physics(volume_strength_db=0.0, vertical_width_rad=None)
    wide = dataclasses.replace(SONAR, half_aperture_rad=math.radians(89.99))
    _, column_rms = volume_rms(wide, settings, wide.beams)
    assert float(np.sum(np.square(column_rms, dtype=np.float64))) == pytest.approx(
        2.0 * math.pi, rel=0.003
    )


def test_no_volume_and_no_noise_are_zero() -> None:
    row_rms, _ = volume_rms(SONAR, physics(), COLUMNS)
    assert not row_rms.any()
    assert not noise_rms(SONAR, physics(), 1.0).any()


@pytest.mark.parametrize("empty", [field, power])
def test_arrival_comes_at_its_time_from_its_bearing(empty: type) -> None:
    row_s = 2.0 * SONAR.range_resolution_m / SPEED
    sine = float(column_sines(COLUMNS, SONAR)[300])
    cells = empty()
    add_arrival(
        cells, InterferencePulse(100.0 * row_s, 7.0 * row_s, sine, 120.0), SONAR, SPEED, key=1
    )
    rows, columns = np.nonzero(cells)
    assert set(columns) <= {300, 301}
    assert (rows.min(), rows.max()) in {(100, 106), (99, 106), (100, 107)}
    assert level_db(cells[101:106, 300]) == pytest.approx(120.0, abs=0.1)


@pytest.mark.parametrize("empty", [field, power])
@pytest.mark.parametrize("part", [0.0, 0.25, 0.5])
def test_arrival_between_two_columns_is_as_loud_in_the_beams(empty: type, part: float) -> None:
    sine = float(column_sines(COLUMNS, SONAR)[300]) + part * SONAR.sine_pitch
    cells = empty()
    add_arrival(cells, InterferencePulse(0.0, 1.0, sine, 120.0), SONAR, SPEED, key=1)
    settings = physics(range_spread=False)
    beams = beam_former(SONAR, settings, MARGIN).form(cells)
    loudest = np.square(np.abs(beams)) if np.iscomplexobj(beams) else beams
    assert 10.0 * math.log10(loudest[50].max()) == pytest.approx(120.0, abs=0.3)


@pytest.mark.parametrize(("time_s", "sine"), [(1.0, 0.0), (-1.0, 0.0), (0.0, 0.99), (0.0, -0.99)])
def test_arrival_outside_the_picture_is_not_heard(time_s: float, sine: float) -> None:
    cells = field()
    add_arrival(cells, InterferencePulse(time_s, 1e-4, sine, 120.0), SONAR, SPEED, key=1)
    assert not cells.any()


def test_a_pulse_from_beside_the_first_column_is_heard_by_its_part() -> None:
    cells = field()
    sine = float(column_sines(COLUMNS, SONAR)[0]) - 0.75 * SONAR.sine_pitch
    add_arrival(cells, InterferencePulse(0.0, 1.0, sine, 120.0), SONAR, SPEED, key=1)
    assert np.abs(cells[50, 0]) == pytest.approx(0.25e6, rel=1e-4)
    assert not cells[:, 1:].any()


def test_columns_beyond_the_last_direction_hear_no_water_and_no_nan() -> None:
    columns = math.ceil(2.4 / SONAR.sine_pitch)
    _, heard = volume_rms(SONAR, physics(volume_strength_db=-60.0), columns)
    assert np.isfinite(heard).all()
    assert heard[columns // 2] > 0


@pytest.mark.parametrize("empty", [field, power])
def test_crosstalk_puts_a_part_of_the_rows_mean_power_into_every_beam(empty: type) -> None:
    beams = empty()
    beams[3, 100] = 1000.0
    before = level_db(beams[3])
    add_crosstalk(beams, -50.0, key=1)
    silent = np.delete(beams[3], 100)
    assert level_db(silent) == pytest.approx(before - 50.0, abs=0.01)
    assert not beams[4].any()


TAIL = Reverberation(0.02, 9.0)
EVERYTHING = np.full(SONAR.rows, np.inf)


@pytest.mark.parametrize("row_m", [0.004, 0.03])
def test_an_echo_leaves_its_share_behind_it_that_fades(row_m: float) -> None:
    """All bearings alike: k E dR exp(-(R - R') / L), and nothing before it, whatever the rows."""
    echo_m, energy = 1.2, 7.0
    rows = round(4.0 / row_m)
    power = np.zeros((rows, 9))
    power[int(echo_m / row_m)] = energy / row_m
    found = tail_power(power, np.linspace(-0.9, 0.9, 9), row_m, TAIL)
    behind_m = (np.arange(rows) - int(echo_m / row_m)) * row_m
    expected = np.where(behind_m > 0.0, 0.02 * energy * 10.0 ** (-0.9 * behind_m), 0.0)
    assert found == pytest.approx(np.repeat(expected[:, None], 9, axis=1))


def test_a_tail_spreads_over_bearings_and_loses_nothing_by_it() -> None:
    sines = np.linspace(-0.9, 0.9, 37)
    power = np.zeros((50, 37))
    power[3, 18] = 1.0
    found = tail_power(power, sines, 0.01, TAIL)[10]
    assert found.argmax() == 18
    assert found.sum() == pytest.approx(0.02 * 0.01 * 10.0 ** (-0.9 * 0.07), rel=0.01)
    spread = math.sqrt(np.average(np.square(sines), weights=found))
    assert spread == pytest.approx(0.06, rel=0.05)


def test_the_tail_of_a_field_has_the_power_of_the_mean() -> None:
    cells = np.zeros((SONAR.rows, COLUMNS), dtype=np.complex64)
    cells[5, 200:300] = 100.0
    mean = np.square(np.abs(cells)).astype(np.float32)
    add_tail(mean, TAIL, SONAR, limit=EVERYTHING, key=3)
    total = np.zeros(mean.shape)
    for key in range(200):
        shown = cells.copy()
        add_tail(shown, TAIL, SONAR, limit=EVERYTHING, key=key)
        total += np.square(np.abs(shown)) / 200.0
    assert not mean[:5].any()
    assert total[6:60].sum(axis=1) == pytest.approx(mean[6:60].sum(axis=1), rel=0.02)
    assert total[5] == pytest.approx(mean[5])


def test_a_flash_does_not_swallow_the_tail_beside_it() -> None:
    """Weights of whole columns may be negative, and so mean powers beside something loud."""
    quiet = np.zeros((SONAR.rows, COLUMNS), dtype=np.float32)
    quiet[5, 200:300] = 1e-3
    flash = quiet.copy()
    flash[5, 240:250] += 1e6
    flash[5, 230:240] -= 1e5
    tails = []
    for cells in (quiet, flash):
        before = cells.copy()
        add_tail(cells, TAIL, SONAR, limit=np.full(SONAR.rows, 1e-3), key=3)
        tails.append((cells - before)[20:40, 200:300].sum(axis=0))
    assert np.all(tails[1] > 0.5 * tails[0])


def test_the_tail_stays_while_the_sonar_does() -> None:
    pose = FramePose(np.array([1.0, 2.0, -3.0]), np.eye(3))
    moved = FramePose(np.array([1.001, 2.0, -3.0]), np.eye(3))
    turned = FramePose(pose.position_m, Rotation.from_euler("z", 1.0, degrees=True).as_matrix())
    keys = [pose_key(1, p, 0.002) for p in (pose, pose, moved, turned)]
    assert keys[0] == keys[1]
    assert len({*keys, pose_key(2, pose, 0.002)}) == 4


@pytest.mark.parametrize(("slope_rad", "tail"), [(0.02, False), (None, True)])
def test_a_mirror_s_flash_leaves_no_tail(slope_rad: float | None, *, tail: bool) -> None:
    """A dull wall's own echo is within the limit to the tenth; a flash is far above."""
    dull = Material("dull", -20.0)
    mirror = Material("mirror", -20.0, reflection=0.9, roughness_m=0.0, slope_rad=slope_rad or 1.0)
    sonar = dataclasses.replace(SONAR, demanded_range_m=4.0)
    pose, seen = FramePose(np.zeros(3), np.eye(3)), []
    for material in (dull, dull if slope_rad is None else mirror):
        plate = rectangle((2.0, 0.0, 0.0), (0.0, 0.8, 0.0), (0.0, 0.0, 0.8), material)
        with_tail = dataclasses.replace(MEAN, reverberation=TAIL)
        seen.append(cell_power(PingEngine(Scene((plate,)), sonar), pose, with_tail))
    front = int(2.0 / sonar.range_resolution_m)
    energies = [power[front - 2 : front + 12].sum() for power in seen]
    behind = [power[front + 100 : front + 200].sum() for power in seen]
    if tail:
        behind_m = np.arange(100, 200) * sonar.range_resolution_m
        faded = np.sum(10.0 ** (-0.9 * behind_m)) * sonar.range_resolution_m
        expected = 0.02 * energies[0] * faded
        assert behind[0] == pytest.approx(expected, rel=0.1)
    else:
        assert energies[1] > 30.0 * energies[0]
        assert behind[1] < 8.0 * behind[0]
