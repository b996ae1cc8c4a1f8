import dataclasses
import math

import numpy as np
import pytest
from sonar_sim import _core
from sonar_sim.propagation.beam_pattern import azimuth_amplitude, main_lobe_end
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.beamformer import beam_former, beam_sines, range_response
from sonar_sim.scene.sonar import SonarSettings

SONAR = SonarSettings()
MARGIN = 12
COLUMNS = SONAR.beams + 2 * MARGIN
WIDTH = SONAR.beam_width_rad


def target(column: int, amplitude: float = 1.0) -> np.ndarray:
    cells = np.zeros((5, COLUMNS), dtype=np.complex64)
    cells[2, MARGIN + column] = amplitude
    return cells


def test_without_a_beam_width_each_echo_stays_in_its_own_beam() -> None:
    former = beam_former(SONAR, Physics(sine_bearings=True), MARGIN)
    beams = former.form(target(100))
    assert np.argwhere(beams).tolist() == [[2, 100]]
    assert former.noise_gain == pytest.approx(1.0)


def test_main_lobe_alone_ends_at_its_null() -> None:
    settings = Physics(beam_width_rad=WIDTH, sine_bearings=True)
    with_lobes = dataclasses.replace(settings, side_lobe_db=SONAR.side_lobe_db)
    main, whole = (
        np.abs(beam_former(SONAR, p, MARGIN).form(target(200))[2]) for p in (settings, with_lobes)
    )
    inside = main > 0.0
    assert main[inside] == pytest.approx(whole[inside], abs=1e-5)
    assert inside.sum() < 20
    assert whole[~inside].max() == pytest.approx(10.0 ** (-30.0 / 20.0), rel=0.1)


def test_main_lobe_alone_hears_nothing_beyond_its_null_at_equal_angles() -> None:
    settings = Physics(beam_width_rad=WIDTH)
    at = (MARGIN + 333 - (COLUMNS - 1) / 2.0) * SONAR.sine_pitch
    beams = np.abs(beam_former(SONAR, settings, MARGIN).form(target(333))[2])
    away = np.abs(beam_sines(SONAR, settings) - at)
    null = main_lobe_end(WIDTH, SONAR.side_lobe_db)
    assert beams[away > null].max() == 0.0
    assert beams[away < 0.9 * null].min() > 0.0


def test_powers_are_the_mean_of_fields() -> None:
    settings = Physics(
        beam_width_rad=WIDTH, side_lobe_db=30.0, sine_bearings=True, range_spread=True
    )
    former = beam_former(SONAR, settings, MARGIN)
    power = np.zeros((9, COLUMNS), dtype=np.float32)
    power[4, 200:230] = 3.0
    mean = np.zeros((9, SONAR.beams))
    for key in range(400):
        cells = np.zeros(power.shape, dtype=np.complex64)
        _core.add_gaussian_power(cells, power, key)
        mean += np.square(np.abs(former.form(cells))) / 400.0
    expected = former.form(power)
    assert mean[3:6].sum(axis=1) == pytest.approx(expected[3:6].sum(axis=1), rel=0.05)
    assert expected[4] == pytest.approx(np.maximum(expected[4], 0.0), abs=1e-5)


def test_side_lobes_of_powers_are_never_negative() -> None:
    settings = Physics(beam_width_rad=WIDTH, side_lobe_db=30.0, sine_bearings=True)
    power = np.zeros((1, COLUMNS), dtype=np.float32)
    power[0, 40] = 1e12
    shown = _core.amplitudes(
        beam_former(SONAR, settings, MARGIN).form(power), np.ones(1, dtype=np.float32)
    )
    assert np.all(np.isfinite(shown))
    # The transform's own noise stays far below the side lobes.
    assert np.sort(shown[0])[:100].max() < 1e6 * 10.0 ** (-50.0 / 20.0)


@pytest.mark.parametrize("side_lobe_db", [None, 30.0])
def test_beams_of_equal_angles_hear_the_same_pattern_about_their_own_bearing(
    side_lobe_db: float | None,
) -> None:
    settings = Physics(beam_width_rad=WIDTH, side_lobe_db=side_lobe_db)
    sines = beam_sines(SONAR, settings)
    place = MARGIN + 333
    at = (place - (COLUMNS - 1) / 2.0) * SONAR.sine_pitch
    beams = np.abs(beam_former(SONAR, settings, MARGIN).form(target(333))[2])
    expected = np.abs(azimuth_amplitude(WIDTH, SONAR.side_lobe_db)(sines - at))
    loud = expected > 0.05
    assert beams[loud] == pytest.approx(expected[loud], abs=1e-4)
    angles = np.degrees(np.arcsin(sines))
    assert np.ptp(np.diff(angles)) < 1e-9


def test_equal_angles_put_a_target_elsewhere() -> None:
    column = 100
    shown = [
        int(np.abs(beam_former(SONAR, p, MARGIN).form(target(column))[2]).argmax())
        for p in (
            Physics(beam_width_rad=WIDTH, sine_bearings=True),
            Physics(beam_width_rad=WIDTH),
        )
    ]
    assert shown[0] == column
    bearing = math.degrees(math.asin((column - 255.5) * SONAR.sine_pitch))
    assert shown[1] == pytest.approx((bearing + 65.0) / 130.0 * 511.0, abs=0.6)


def test_range_response_keeps_the_power_of_independent_rows() -> None:
    taps = range_response()
    assert float(np.sum(np.square(taps))) == pytest.approx(1.0)
    assert taps[0] == taps[-1]


def test_rows_leak_into_their_neighbours_alone() -> None:
    settings = Physics(range_spread=True, sine_bearings=True)
    beams = np.abs(beam_former(SONAR, settings, MARGIN).form(target(7)))
    assert np.argwhere(beams).tolist() == [[1, 7], [2, 7], [3, 7]]


def test_bytes_do_not_depend_on_threads() -> None:
    settings = Physics(
        beam_width_rad=WIDTH, side_lobe_db=30.0, sine_bearings=True, range_spread=True
    )
    cells = _core.complex_gaussian(4, 97 * COLUMNS).reshape(97, COLUMNS)
    former = beam_former(SONAR, settings, MARGIN)
    assert len({former.form(cells, threads).tobytes() for threads in (1, 2, 3, 5)}) == 1


@pytest.mark.parametrize(
    ("taps", "range_taps"),
    [(np.ones(4), np.ones(1)), (np.ones(3), np.ones(2)), (np.ones((3, 3)), np.ones(1))],
)
def test_responses_without_a_middle_are_refused(taps: np.ndarray, range_taps: np.ndarray) -> None:
    with pytest.raises(ValueError, match="odd number"):
        _core.form_beams(target(1), taps.astype(np.float32), 0, 5, range_taps.astype(np.float32))


def test_field_of_another_shape_or_kind_is_refused() -> None:
    ones = np.ones(5, dtype=np.float32)
    with pytest.raises(ValueError, match="column_rms"):
        _core.add_gaussian(target(1), ones, ones, 1)
    with pytest.raises(TypeError):
        _core.add_gaussian(np.zeros((5, 5), dtype=np.complex128), ones, ones, 1)
    with pytest.raises(ValueError, match="contiguous"):
        _core.add_gaussian(np.zeros((5, 10), dtype=np.complex64)[:, ::2], ones, ones, 1)
    with pytest.raises(ValueError, match="extra_power"):
        _core.add_gaussian(
            np.zeros((5, 5), dtype=np.complex64), ones, ones, 1, 2, ones[:, None] * ones[:2]
        )
    with pytest.raises(ValueError, match="weights"):
        _core.spread_columns(np.ones((5, 3)), np.ones((4, 2)))
    with pytest.raises(ValueError, match="float32 or float64"):
        _core.spread_columns(np.ones((5, 3), dtype=np.int32), np.ones((3, 2)))  # type: ignore[type-var]


FOCUS_M = SONAR.focus_m(1500.0)


def test_focus_is_that_of_the_array_s_length() -> None:
    """L = 0.886 lambda / width: 101.5 mm in both bands of an M750d."""
    high = dataclasses.replace(SONAR, frequency_hz=1.2e6, beam_width_rad=math.radians(0.6))
    assert SONAR.focus_m(1500.0) == pytest.approx(5.2, abs=0.1)
    assert high.focus_m(1500.0) == pytest.approx(8.9, abs=0.1)


@pytest.mark.parametrize("side_lobe_db", [None, 30.0])
@pytest.mark.parametrize("range_m", [0.7, 1.3, 2.6, 4.9, 6.0])
def test_beams_without_focus_are_as_wide_as_the_array_near_it(
    range_m: float, side_lobe_db: float | None
) -> None:
    settings = Physics(
        beam_width_rad=WIDTH, side_lobe_db=side_lobe_db, sine_bearings=True, focus_m=FOCUS_M
    )
    sonar = dataclasses.replace(SONAR, demanded_range_m=8.0)
    cells = np.zeros((sonar.rows, COLUMNS), dtype=np.complex64)
    row = int(range_m / sonar.range_resolution_m)
    cells[row, MARGIN + 256] = 1.0
    near = np.abs(beam_former(sonar, settings, MARGIN).form(cells)[row])
    focused = np.abs(
        beam_former(sonar, dataclasses.replace(settings, focus_m=None), MARGIN).form(cells)[row]
    )
    wide = max(FOCUS_M / range_m, 1.0)
    # Equivalent widths: what is lost at the peak is gained beside it.
    assert np.square(near).sum() == pytest.approx(np.square(focused).sum(), rel=0.02)
    assert np.square(focused.max() / near.max()) == pytest.approx(wide, rel=0.07)


def test_bands_of_widths_join_and_noise_stays_as_loud() -> None:
    settings = Physics(
        beam_width_rad=WIDTH,
        side_lobe_db=30.0,
        sine_bearings=True,
        range_spread=True,
        focus_m=FOCUS_M,
    )
    sonar = dataclasses.replace(SONAR, demanded_range_m=8.0)
    former = beam_former(sonar, settings, MARGIN)
    firsts, lasts = zip(*((first, last) for first, last, _ in former.near), strict=True)
    assert lasts[1:] == firsts[:-1]
    assert (firsts[-1], lasts[0]) == (0, int(FOCUS_M / sonar.range_resolution_m))
    cells = _core.complex_gaussian(7, sonar.rows * COLUMNS).reshape(sonar.rows, COLUMNS)
    power = np.square(np.abs(former.form(cells)))[:, 200:312]
    bands = power[: sonar.rows // 50 * 50].reshape(-1, 50 * power.shape[1]).mean(axis=1)
    spread = np.square(np.abs(_core.complex_gaussian(7, 100000))).mean()
    # The nearest beams are so wide that few of them are independent.
    assert bands[4:] == pytest.approx(spread * former.noise_gain**2, rel=0.25)
    assert bands[-6:].mean() == pytest.approx(spread * former.noise_gain**2, rel=0.05)
