"""Hard cases of the simulator: levels, losses and pixels."""

from __future__ import annotations

import dataclasses
import math

import mpmath
import numpy as np
import pytest
from mpmath import mpf
from sonar_sim import _core
from sonar_sim.effects.image_difference import (
    expected_clipped,
    level_change_db,
    quantiser_change_db,
)
from sonar_sim.engine import PingEngine
from sonar_sim.propagation.beam_pattern import azimuth_amplitude, vertical_two_way_power
from sonar_sim.propagation.clouds import box_crossing, cloud_gain
from sonar_sim.propagation.physics import Cloud, Physics
from sonar_sim.receiver.gain import FULL_SCALE_DB, quantise, row_gain
from sonar_sim.scene.material import specular_lobe
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.suspended_matter import sediment_db_per_m
from sonar_sim.scene.water import Water, thermal_noise_db
from sonar_sim.simulator import Simulator
from sonar_sim.validation.setups import MEAN, narrow_sonar, pose_at, rectangle

WALL = rectangle((5e4, 0.0, 0.0), (0.0, 2e4, 0.0), (0.0, 0.0, 2e4))


def test_a_range_of_100_km_is_silence_and_not_nan() -> None:
    """At 100 km absorption is 25000 dB each way, and the varied gain makes up for it.

    Naively both are ratios: the gain overflows to infinity, the echo underflows to 0, and infinity
    times 0 is not a number.
    """
    sonar = SonarSettings(max_range_m=1e5, demanded_range_m=1e5, beams=32)
    lossy = dataclasses.replace(MEAN, attenuation_db_per_m=0.25, tvg=True, gain=True)
    shown = PingEngine(Scene((WALL,)), sonar).ping(pose_at((0.0, 0.0, 0.0)), lossy).amplitude
    assert np.isfinite(shown).all()
    assert shown.max() == 0.0
    gain = row_gain(sonar, lossy, 0.25).astype(np.float64)
    assert np.isfinite(gain).all()
    assert (np.diff(gain) >= 0).all()


def test_a_loss_of_60_db_is_right_to_a_hundred_thousandth() -> None:
    """Absorption takes 60 dB of an echo from 120 m, a thousandth of its pressure.

    Naively it is multiplied up row by row in single precision, and the last of 480 rows has the
    roundings of all.
    """
    sonar, pose = narrow_sonar(120.0, 0.25), pose_at((0.0, 0.0, 0.0))
    plain = dataclasses.replace(MEAN, spreading=False, tvg=True, specular=False)
    lossy = dataclasses.replace(plain, attenuation_db_per_m=0.25)
    for range_m in (10.0, 110.0):
        wall = rectangle((range_m, 0.0, 0.0), (0.0, 400.0, 0.0), (0.0, 0.0, 400.0))
        engine = PingEngine(Scene((wall,)), sonar)
        less = engine.ping(pose, lossy).amplitude.astype(np.float64)
        more = engine.ping(pose, plain).amplitude.astype(np.float64)
        row = round(range_m / 0.25)
        lost_db = 20 * np.log10(less[row, 32] / more[row, 32])
        assert lost_db == pytest.approx(-0.5 * sonar.row_centres_m[row], abs=1e-5)


@pytest.mark.parametrize("radius_m", [1e-4, 1e-3])
def test_a_wall_behind_impenetrable_mud_stays_hidden(radius_m: float) -> None:
    """Dense mud takes from 200 to 100000 dB of a wall's echo: the rule must find that it matters.

    Naively the picture without mud is worked out from the one with it: what is lost beside the
    noise, or underflows to 0, does not come back by any factor. Mud then seems to change nothing,
    is left out, and the wall behind it shines.
    """
    mud = Water(sediment_kg_per_m3=100.0, sediment_radius_m=radius_m)
    wall = rectangle((25.0, 0.0, 0.0), (0.0, 60.0, 0.0), (0.0, 0.0, 60.0))
    sonar = dataclasses.replace(SonarSettings(), demanded_range_m=40.0, beams=32, forced_rows=80)
    muddy, clear = (Simulator(Scene((wall,), water=w), sonar) for w in (mud, Water()))
    pose = pose_at((0.0, 0.0, 0.0))
    assert muddy.plan(pose).plan.names.count("turbidity") == 1
    at = slice(48, 52)
    hidden = muddy.ping(pose).amplitude[at].mean()
    assert hidden < 0.25 * clear.ping(pose).amplitude[at].mean()


@pytest.mark.parametrize("frequency_hz", [1.0, 1e3, 750e3, 3e6, 1e9])
def test_absorption_of_all_frequencies_and_of_fresh_water_is_finite(frequency_hz: float) -> None:
    """Without salt the relaxations of boric acid and magnesium have no strength and no frequency.

    Naively f² / (f² + f1²) with both near 0 is 0 / 0, and the square of a relaxation is lost beside
    that of the frequency.
    """
    fresh = Water(salinity_ppt=0.0)
    salt = Water(salinity_ppt=35.0)
    for model in ("ainslie_mccolm_db_per_m", "francois_garrison_db_per_m"):
        low, high = getattr(fresh, model)(frequency_hz), getattr(salt, model)(frequency_hz)
        assert 0 < low <= high < math.inf
    t, f = mpf(10), mpf(frequency_hz) / 1000
    depth_km = mpf("0.005")
    boron, magnesium = mpf("0.78") * mpmath.exp(t / 26), 42 * mpmath.exp(t / 17)
    exact = (
        mpf("0.106") * boron * f**2 / (f**2 + boron**2)
        + mpf("0.52")
        * (1 + t / 43)
        * mpmath.exp(-depth_km / 6)
        * magnesium
        * f**2
        / (f**2 + magnesium**2)
        + mpf("0.00049") * f**2 * mpmath.exp(-(t / 27 + depth_km / 17))
    ) / 1000
    assert salt.ainslie_mccolm_db_per_m(frequency_hz) == pytest.approx(float(exact), rel=1e-13)


def test_grains_from_dust_to_sand_take_a_finite_part() -> None:
    """Suspended grains are from a hundredth of a micrometre to a millimetre.

    Naively Urick's s is squared beside 1: for fine grains friction is a difference of two numbers
    of 1e8.
    """
    for radius_m in (1e-8, 1e-6, 1e-3):
        got = sediment_db_per_m(750e3, 1.0, radius_m)
        omega = 2 * mpmath.pi * 750_000
        beta = mpmath.sqrt(omega / (2 * mpf("1.3e-6"))) * mpf(radius_m)
        s = mpf(9) / (4 * beta) * (1 + 1 / beta)
        tau, sigma = mpf("0.5") + mpf(9) / (4 * beta), mpf(2650) / 1027
        k = omega / 1500
        two_alpha = (k**4 * mpf(radius_m) ** 3 / 6) + k * (sigma - 1) ** 2 * s / (
            s**2 + (sigma + tau) ** 2
        )
        exact = 20 / mpmath.log(10) * two_alpha / 2650 / 2
        assert got == pytest.approx(float(exact), rel=1e-12)


def test_patterns_are_one_on_their_axis_and_finite_abeam() -> None:
    """On the axis the pattern is sin(x) / x at 0, and beams may be a hundredth of a degree wide.

    Naively that is 0 / 0, and a narrow beam's argument abeam is so large that its sine is noise.
    """
    sines = np.array([0.0, 5e-324, 1e-18, 1e-9, 0.5, 1.0, -1.0])
    for width_rad in (1e-4, math.radians(1.0), math.radians(20.0), math.pi / 2):
        vertical = vertical_two_way_power(sines, width_rad)
        beam = azimuth_amplitude(width_rad, 30.0)(sines)
        assert vertical[:3] == pytest.approx(np.ones(3))
        assert beam[:3] == pytest.approx(np.ones(3))
        assert np.isfinite(vertical).all()
        assert np.isfinite(beam).all()
        assert (vertical <= 1.0 + 1e-12).all()


@pytest.mark.parametrize("slope_rad", [0.001, 0.1, 1.0])
def test_a_mirror_s_lobe_is_finite_from_head_on_to_grazing(slope_rad: float) -> None:
    """The lobe of a rough mirror is sec⁴ of incidence times exp(-tan²), and grazing is 90°.

    Naively sec⁴ is infinite there and the exponential 0: no number, over every floor seen along.
    """
    cosines = np.array([1.0, 1 - 1e-16, 0.5, 1e-3, 1e-9, 5e-324, 0.0])
    ones = np.ones(len(cosines))
    got = specular_lobe(cosines, ones, 0.0 * ones, slope_rad * ones, 3000.0)
    assert np.isfinite(got).all()
    exact = [
        mpf(1)
        / (8 * mpmath.pi * mpf(slope_rad) ** 2)
        / mpf(c) ** 4
        * mpmath.exp(-(1 / mpf(c) ** 2 - 1) / (2 * mpf(slope_rad) ** 2))
        for c in cosines[:4].tolist()
    ]
    assert got[:4] == pytest.approx([float(e) for e in exact], rel=1e-9, abs=1e-300)
    assert got[-1] < 1e-100 or slope_rad == 1.0


def test_a_cloud_is_passed_along_its_faces_and_edges() -> None:
    """A ray may run exactly along a face of a box of bubbles, or start in a corner.

    Naively the distance to a parallel face is 0 / 0, and the ray is in the cloud for no number.
    """
    cloud = Cloud(np.array([1.0, -1.0, -1.0]), np.array([3.0, 1.0, 1.0]), 2.0, -40.0)
    rays = np.array(
        [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [1, 1e-30, 0], [1, 0, -0.0]], np.float32
    )
    reach = np.full(len(rays), 10.0)
    for origin in ((0.0, 1.0, 1.0), (0.0, 0.0, 0.0), (1.0, -1.0, -1.0), (3.0, 1.0, 1.0)):
        enter, leave = box_crossing(cloud, np.array(origin), rays, reach)
        assert np.isfinite(enter).all()
        assert (leave >= enter).all()
        assert (leave - enter <= 2.0 + 1e-9).all()
        gain = cloud_gain([cloud], np.array(origin), rays, reach)
        assert ((gain >= 0) & (gain <= 1)).all()
    enter, leave = box_crossing(cloud, np.zeros(3), rays, reach)
    assert (enter[0], leave[0]) == pytest.approx((1.0, 3.0))
    enter, leave = box_crossing(cloud, np.zeros(3), rays, np.full(len(rays), 2.5))
    assert (enter[0], leave[0]) == pytest.approx((1.0, 2.5))


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_the_brightest_and_the_darkest_pixels_are_the_ends_of_their_width(bits: int) -> None:
    """Amplitudes are from nothing to a thousand times full scale, and gamma takes any root of them.

    Naively full scale of 32 bits is 4294967295 as a float, which is one more than there is: the
    brightest pixel wraps to black.
    """
    shown = np.array([[0.0, 1e-45, 1e-38, 0.5, 1.0, np.nextafter(np.float32(1), 2), 1e3, 3e38]])
    for gamma_byte in (1, 127, 255):
        image = quantise(
            shown.astype(np.float32), Physics(quantised=True, gamma=True), gamma_byte, bits
        )
        assert image[0, 0] == 0
        assert (image[0, 4:].astype(np.int64) == 2**bits - 1).all()
        assert (np.diff(image[0].astype(np.int64)) >= 0).all()


def test_levels_of_black_pictures_differ_by_nothing() -> None:
    """Rules compare pictures in dB, and a picture of open water is black.

    Naively 20 log of 0 is minus infinity, and the difference of two such no number: the rule for
    each effect answers no, or yes, for ever.
    """
    sonar = SonarSettings()
    black, faint = np.zeros((50, 64), np.float32), np.full((50, 64), 1e-30, np.float32)
    white = np.full((50, 64), 3e38, np.float32)
    assert level_change_db(black, black, sonar, 0.001) == 0.0
    assert level_change_db(black, faint, sonar, 0.001, (0.5, 0.5)) == 0.0
    change = level_change_db(black, np.ones_like(black), sonar, 0.001)
    assert change == pytest.approx(20 * math.log10(2 * 255), abs=1e-3)
    assert quantiser_change_db(black, sonar, 0.001) == 0.0
    assert quantiser_change_db(white, sonar, 0.001) == 0.0
    assert level_change_db(white, white, sonar, 0.001) == 0.0
    wide = dataclasses.replace(sonar, bits=32)
    louder = np.full((50, 64), 1e200)  # beyond single precision, as squares of the other are
    assert level_change_db(louder, white, wide, 0.001, (0.5, 0.5)) == 0.0
    assert 500.0 < level_change_db(white, black, wide, 0.001, (0.5, 0.5)) < 1000.0
    assert 500.0 < level_change_db(louder, black, wide, 0.001, (0.5, 0.5)) < 1000.0


def test_speckle_of_next_to_no_mean_is_as_clipped_as_by_the_law() -> None:
    """The mean of clipped speckle is m erf(1 / m), from a mean of nothing to one beyond full scale.

    Naively 1 / m is infinite at 0, and at large m the product is that of a huge and a tiny number.
    """
    m = np.array([0.0, 1e-30, 1e-6, 0.01, 1.0, 30.0, 1e6], np.float32)
    got = expected_clipped(m).astype(np.float64)
    exact = [float(mpf(x) * mpmath.erf(1 / mpf(x))) for x in m[2:].astype(float).tolist()]
    assert got[2:] == pytest.approx(exact, rel=1e-6)
    assert (got[:2] <= 1e-6).all()
    assert got[-1] == pytest.approx(2 / math.sqrt(math.pi), rel=1e-5)


def test_noise_of_a_faint_and_of_a_loud_cell_has_its_power() -> None:
    """Cells are from a millionth to a billion of a micropascal, side by side in one image.

    Naively noise is made of the whole image's spectrum in single precision, and what is faint is
    the rounding of what is loud.
    """
    powers = np.array([1e-12, 1.0, 1e18])
    field = np.zeros((192, 512), np.complex64)
    _core.add_gaussian_power(field, np.resize(powers, (512, 192)).T.astype(np.float32).copy(), 7)
    seen = np.square(np.abs(field.astype(np.complex128))).reshape(64, 3, 512).mean(axis=(0, 2))
    assert seen == pytest.approx(powers, rel=0.03)


def test_thermal_noise_of_narrow_and_wide_bands_is_by_the_decade() -> None:
    """Noise goes with the logarithm of the band, from a hertz to all of the sonar's.

    Naively a band of less than a hertz makes it negative and is cut off at 0 dB.
    """
    at = [thermal_noise_db(750e3, band) for band in (1e-3, 1.0, 1e6)]
    assert at[1] - at[0] == pytest.approx(30.0)
    assert at[2] - at[1] == pytest.approx(60.0)
    assert at[1] == pytest.approx(float(-15 + 20 * mpmath.log10(750)), abs=1e-9)


def test_full_scale_is_the_same_at_every_gain() -> None:
    """The gain may be asked for at 0 or 100 %, near the sonar where log R is negative.

    Naively the first row is at range 0 and its gain is minus infinity dB.
    """
    for range_m in (0.1, 120.0):
        sonar = dataclasses.replace(SonarSettings(), demanded_range_m=range_m)
        gain = row_gain(sonar, Physics(tvg=True, gain=True), 0.25)
        assert np.isfinite(gain).all()
        assert gain[0] > 0
        first_m = mpf(sonar.range_resolution_m) / 2
        exact_db = 30 * mpmath.log10(first_m) + first_m / 2 + mpf("0.96") * 50 - FULL_SCALE_DB
        assert gain[0] == pytest.approx(float(10 ** (exact_db / 20)), rel=1e-6)
