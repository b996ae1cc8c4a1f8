import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim.engine import PingEngine
from sonar_sim.errors import SceneError, SonarSimError
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.geometry.trajectory import Drift
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import (
    Cloud,
    Mirror,
    Physics,
    Reverberation,
    SoundSpeedProfile,
)
from sonar_sim.raycast.fan import ALL_ELEVATIONS_RAD
from sonar_sim.raycast.meshes import NOTHING, SEA
from sonar_sim.scene.material import Material
from sonar_sim.scene.scene import PointTarget, Scene, Sea, Surface
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.water import Water
from sonar_sim.simulator import Simulator
from sonar_sim.validation.setups import (
    CHALK,
    DULL,
    MEAN,
    cell_power,
    decibel,
    floor,
    narrow_sonar,
    pose_at,
    rectangle,
    sphere,
    target,
)

HERE = pose_at((0.0, 0.0, 0.0))
SPECKLED = dataclasses.replace(MEAN, speckle=True)
FULL = dataclasses.replace(
    SPECKLED,
    vertical_width_rad=math.radians(20.0),
    beam_width_rad=math.radians(1.0),
    side_lobe_db=30.0,
    range_spread=True,
    attenuation_db_per_m=0.22,
    noise_level_db=95.0,
    tvg=True,
    gain=True,
    gamma=True,
    saturation=True,
    quantised=True,
)
MODES = pytest.mark.parametrize("physics", [MEAN, SPECKLED, FULL], ids=["mean", "speckled", "full"])


def picture(scene: Scene, physics: Physics, range_m: float = 6.0, **more: Any) -> NDArray[Any]:
    sonar = narrow_sonar(range_m, 0.01)
    amplitude: NDArray[Any] = PingEngine(scene, sonar).ping(HERE, physics, **more).amplitude
    assert np.isfinite(amplitude).all()
    assert (amplitude >= 0.0).all()
    return amplitude


def plate(range_m: float, name: str = "plate", cuts: int = 1) -> Surface:
    whole = rectangle((range_m, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), DULL, cuts)
    return dataclasses.replace(whole, name=name)


@MODES
def test_a_target_and_a_plate_at_a_tenth_of_a_metre(physics: Physics) -> None:
    for scene in (Scene(targets=(target((0.1, 0.0, 0.0)),)), Scene((plate(0.1),))):
        assert np.argmax(picture(scene, MEAN, 1.0).max(axis=1)) in (9, 10)
        assert picture(scene, physics, 1.0).max() > 0.0


@MODES
def test_an_empty_scene_is_silent_but_for_noise(physics: Physics) -> None:
    silent = dataclasses.replace(physics, noise_level_db=None)
    assert not picture(Scene(), silent).any()


@MODES
def test_inside_a_mesh(physics: Physics) -> None:
    around = sphere((0.0, 0.0, 0.0), 3.0, CHALK)
    amplitude = picture(Scene((around,)), dataclasses.replace(physics, noise_level_db=None))
    loud = np.flatnonzero(amplitude.max(axis=1) > 0.5 * amplitude.max()) * 0.01
    assert abs(loud.min() - 3.0) < 0.08
    assert abs(loud.max() - 3.0) < 0.08


@MODES
@pytest.mark.parametrize("height_m", [1e-6, 1e-3])
def test_grazing_a_floor(physics: Physics, height_m: float) -> None:
    silent = dataclasses.replace(physics, noise_level_db=None)
    rows = picture(Scene((floor(-height_m),)), silent).max(axis=1)
    assert 0 < rows.max() == rows[:2].max()  # straight below
    ahead = picture(Scene((floor(-0.8),)), silent).max(axis=1)[100:]
    assert rows[100:].max() < 0.05 * ahead.max()
    assert picture(Scene((floor(-height_m),)), physics).any()


@MODES
def test_a_floor_through_the_sonar_has_no_echo(physics: Physics) -> None:
    assert not picture(
        Scene((floor(0.0),)), dataclasses.replace(physics, noise_level_db=None)
    ).any()
    picture(Scene((floor(0.0),)), physics)


@MODES
def test_a_plate_edge_on_has_no_echo(physics: Physics) -> None:
    edge_on = Scene((rectangle((3.0, 0, 0), (2.0, 0, 0), (0, 0, 2.0)),))
    assert not picture(edge_on, dataclasses.replace(physics, noise_level_db=None)).any()
    picture(edge_on, physics)


def test_degenerate_triangles_change_nothing() -> None:
    good = plate(3.0)
    point, line = [[0, 0, 0]], [[0, 1, 1]]
    faces = np.concatenate([good.faces, point, line]).astype(np.int64)
    with_bad = Surface(good.name, good.vertices_m, faces, good.material)
    assert np.array_equal(picture(Scene((good,)), SPECKLED), picture(Scene((with_bad,)), SPECKLED))
    nothing = Surface("none", good.vertices_m, np.array(point), good.material)
    assert not picture(Scene((nothing,)), SPECKLED).any()


def test_coplanar_surfaces_echo_once() -> None:
    one = np.square(picture(Scene((plate(3.0),)), MEAN)).sum()
    both = np.square(picture(Scene((plate(3.0), plate(3.0, "other"))), MEAN)).sum()
    assert decibel(both / one) == pytest.approx(0.0, abs=0.1)


def test_vertices_that_are_not_finite_are_refused() -> None:
    bad = plate(3.0).vertices_m.copy()
    bad[0, 1] = math.nan
    with pytest.raises(SceneError, match="plate"):
        Surface("plate", bad, plate(3.0).faces, DULL)


def test_the_farthest_range() -> None:
    sonar = SonarSettings(beams=256, demanded_range_m=120.0)
    engine = PingEngine(Scene((floor(-10.0), plate(100.0))), sonar)
    ping = engine.ping(HERE, FULL)
    assert ping.image.shape == (sonar.rows, 256)
    assert np.isfinite(ping.amplitude).all()
    alone = cell_power(PingEngine(Scene((plate(60.0),)), sonar), HERE, MEAN)
    row = int(60.0 / sonar.range_resolution_m)
    assert abs(int(alone.sum(axis=1).argmax()) - row) <= 1


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_everything_saturated_stays_at_full_scale(bits: int) -> None:
    sonar = dataclasses.replace(
        narrow_sonar(6.0, 0.01), source_level_db=380.0, bits=bits, gamma_byte=127
    )
    ping = PingEngine(Scene((floor(-0.8), plate(5.0))), sonar).ping(HERE, FULL)
    lit = np.asarray(ping.image)[300:480]
    assert lit.dtype.itemsize * 8 == bits
    # Speckle leaves a dark dot here and there, however loud.
    assert np.count_nonzero(lit == np.iinfo(f"uint{bits}").max) > 0.99 * lit.size
    assert np.array_equal(ping.image == 0, ping.amplitude == 0.0) or bits == 8


def test_speckle_has_the_mean_power() -> None:
    # Many independent cells of a tilted plate.
    slope = rectangle((5.0, 0, -1.0), (6.0, 0, 2.0), (0.0, 6.0, 0.0))
    mean = np.square(picture(Scene((slope,)), MEAN, 9.0)).sum()
    drawn = np.mean(
        [
            np.square(
                PingEngine(Scene((slope,)), narrow_sonar(9.0, 0.01), k)
                .ping(HERE, SPECKLED)
                .amplitude
            ).sum()
            for k in range(4)
        ]
    )
    assert decibel(drawn / mean) == pytest.approx(0.0, abs=0.1)


def test_speckle_is_rayleigh_through_the_beams() -> None:
    slope = rectangle((5.0, 0, -1.0), (6.0, 0, 2.0), (0.0, 6.0, 0.0))
    sonar = dataclasses.replace(narrow_sonar(9.0, 0.008, 128), beam_width_rad=0.0175)
    seen = dataclasses.replace(SPECKLED, beam_width_rad=0.0175, range_spread=True)
    mean = PingEngine(Scene((slope,)), sonar).ping(HERE, dataclasses.replace(seen, speckle=False))
    ratios = []
    for seed in range(3):
        ping = PingEngine(Scene((slope,)), sonar, seed).ping(HERE, seen)
        inside = (slice(400, 800, 2), slice(24, 104, 4))
        ratios.append((ping.amplitude[inside] / mean.amplitude[inside]).ravel())
    ratio = np.concatenate(ratios)
    assert ratio.std() / ratio.mean() == pytest.approx(0.5227, abs=0.02)
    assert np.median(ratio) / ratio.mean() == pytest.approx(0.9394, abs=0.02)


def test_speckle_stays_on_the_surface_when_the_sonar_moves() -> None:
    slope = rectangle((5.0, 0, -1.0), (6.0, 0, 2.0), (0.0, 6.0, 0.0))
    engine = PingEngine(Scene((slope,)), narrow_sonar(9.0, 0.01, 128))
    seen = dataclasses.replace(SPECKLED, beam_width_rad=0.0175, range_spread=True)

    def at(y_m: float) -> NDArray[np.float64]:
        pose = pose_at((0.0, y_m, 0.0))
        mean = engine.ping(pose, dataclasses.replace(seen, speckle=False)).amplitude
        ratio = engine.ping(pose, seen).amplitude[350:600] / mean[350:600]
        return ratio[:, 32:96].astype(np.float64).ravel()

    here = at(0.0)
    assert np.corrcoef(here, at(0.002))[0, 1] > 0.9
    assert abs(np.corrcoef(here, at(0.5))[0, 1]) < 0.1


def test_other_grain_is_that_of_an_engine_of_that_seed() -> None:
    slope = rectangle((5.0, 0, -1.0), (6.0, 0, 2.0), (0.0, 6.0, 0.0))
    scene, sonar = Scene((slope,)), narrow_sonar(9.0, 0.01, 32)
    engine = PingEngine(scene, sonar, 3)
    before = engine.ping(HERE, FULL).amplitude
    other = engine.reseeded(4).ping(HERE, FULL).amplitude
    assert np.array_equal(other, PingEngine(scene, sonar, 4).ping(HERE, FULL).amplitude)
    assert not np.array_equal(other, before)
    assert np.array_equal(engine.ping(HERE, FULL).amplitude, before)


def test_shadows_hide_and_without_them_all_is_heard() -> None:
    scene = Scene((plate(2.0, "near"), plate(4.0, "far")))
    rows = np.square(picture(scene, MEAN)).sum(axis=1)
    assert rows[195:215].sum() > 0.0
    assert not rows[395:405].any()
    open_water = dataclasses.replace(MEAN, shadows=False)
    assert np.square(picture(scene, open_water)).sum(axis=1)[395:405].any()


def test_a_silent_surface_hides_without_an_echo() -> None:
    scene = Scene((plate(2.0, "near"), plate(4.0, "far")))
    assert not picture(scene, dataclasses.replace(MEAN, silent=frozenset({"near"}))).any()


def test_the_sea_ends_the_water_and_scatters_on_request() -> None:
    scene = Scene((plate(5.0),), sea=Sea(lambert_db=-20.0))
    below = pose_at((0.0, 0.0, -1.0))
    sonar = narrow_sonar(6.0, 0.01)
    mute = PingEngine(scene, sonar).ping(below, MEAN, truth=True)
    assert not mute.amplitude[150:400].any()
    loud = PingEngine(scene, sonar).ping(below, dataclasses.replace(MEAN, sea_surface=True))
    assert loud.amplitude[250].any()
    assert mute.truth is not None
    assert (mute.truth.ray_surface == SEA).any()


def test_moving_objects_stand_where_they_are_by_then() -> None:
    still = rectangle((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    moved = dataclasses.replace(still, motion=Drift((3.0, 0.0, 0.0), velocity_mps=(0.5, 0.0, 0.0)))
    for time_s, range_m in ((0.0, 3.0), (2.0, 4.0)):
        rows = picture(Scene((moved,)), MEAN, time_s=time_s).max(axis=1)
        assert abs(np.flatnonzero(rows)[0] * 0.01 - range_m) < 0.02


@pytest.mark.parametrize("range_m", [3.1, 5.7])
def test_an_object_is_heard_from_where_the_sound_meets_it(range_m: float) -> None:
    """It crosses the fan at 20 m/s: in half of the sound's way it moves range_m / 75."""
    crossing = Drift((range_m, 0.0, 0.0), velocity_mps=(0.0, 20.0, 0.0))
    small = dataclasses.replace(
        rectangle((0.0, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.02)), motion=crossing
    )
    beams = []
    for blocks in (1, 64):
        physics = dataclasses.replace(MEAN, pose_blocks=blocks, beam_width_rad=0.02)
        power = np.square(picture(Scene((small,)), physics)).sum(axis=0)
        beams.append(float(np.average(np.arange(len(power)), weights=power)))
    moved = 20.0 * range_m / Water().speed_of_sound_mps / range_m  # in the sine of the bearing
    assert beams[0] - beams[1] == pytest.approx(moved / narrow_sonar(6.0).sine_pitch, rel=0.1)


def test_the_tail_behind_speckle_has_the_expected_power() -> None:
    physics = dataclasses.replace(
        MEAN, reverberation=Reverberation(0.02, 9.0), beam_width_rad=math.radians(0.6)
    )
    engine = PingEngine(Scene((plate(3.0),)), narrow_sonar(6.0, 0.01))
    expected = np.square(engine.ping(HERE, physics).amplitude)[320:400].sum()
    speckled = dataclasses.replace(physics, speckle=True)
    found = [
        np.square(engine.reseeded(seed).ping(HERE, speckled).amplitude)[320:400].sum()
        for seed in range(12)
    ]
    assert 10.0 * np.log10(np.mean(found) / expected) == pytest.approx(0.0, abs=0.25)


def test_doppler_moves_what_closes() -> None:
    motion = SonarMotion(np.array([2.0, 0.0, 0.0]), np.zeros(3))
    shifted = dataclasses.replace(MEAN, doppler_shift_s=0.02)
    for scene in (Scene((plate(3.0),)), Scene(targets=(target((3.0, 0.0, 0.0)),))):
        plain = np.flatnonzero(picture(scene, MEAN, motion=motion).max(axis=1))[0]
        rows = np.flatnonzero(picture(scene, shifted, motion=motion).max(axis=1))[0]
        assert (rows - plain) * 0.01 == pytest.approx(0.04, abs=0.011)


def test_doppler_shifts_what_approaches() -> None:
    shifted = dataclasses.replace(MEAN, doppler_shift_s=0.02)
    approach = Drift(velocity_mps=(-2.0, 0.0, 0.0))
    for scene in (
        Scene((dataclasses.replace(plate(3.0), motion=approach),)),
        Scene(targets=(dataclasses.replace(target((3.0, 0.0, 0.0)), motion=approach),)),
    ):
        plain = np.flatnonzero(picture(scene, MEAN).max(axis=1))[0]
        rows = np.flatnonzero(picture(scene, shifted).max(axis=1))[0]
        assert (rows - plain) * 0.01 == pytest.approx(0.04, abs=0.011)


def test_a_wrong_speed_of_sound_stretches_ranges() -> None:
    stretched = picture(Scene((plate(4.0),)), dataclasses.replace(MEAN, range_scale=1.05))
    assert np.flatnonzero(stretched.max(axis=1))[0] * 0.01 == pytest.approx(4.2, abs=0.011)


@pytest.mark.parametrize("scale", [0.7, 1.0, 1.4])
def test_a_floor_stays_even_if_its_ranges_are_stretched(scale: float) -> None:
    rows = picture(Scene((floor(-2.0, CHALK),)), dataclasses.replace(MEAN, range_scale=scale))
    level_db = 20.0 * np.log10(rows[round(330 * scale) : round(420 * scale), 10])
    place = np.arange(len(level_db))
    smooth_db = np.polynomial.Polynomial.fit(place, level_db, 3)(place)
    assert np.abs(level_db - smooth_db).max() < 0.1


@pytest.mark.parametrize(
    ("speckle", "aside_m"), [(False, 0.0), (False, 0.037), (False, -0.21), (True, 0.0)]
)
@pytest.mark.slow
def test_a_surface_has_the_ghosts_of_a_target(*, speckle: bool, aside_m: float) -> None:
    """A small plate under a calm surface shows where V10's targets do, and as loud."""
    small = rectangle((10.0, aside_m, -2.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.05), CHALK)
    mirror = Mirror(np.zeros(3), np.array([0.0, 0.0, -1.0]), -1.0)
    physics = dataclasses.replace(MEAN, lambert=False, mirrors=(mirror,), speckle=speckle)
    powers = np.zeros((1100, 65))
    for seed in range(1 if not speckle else 40):
        sonar = narrow_sonar(11.0, 0.01, 65)
        engine = PingEngine(Scene((small,)), sonar, seed)
        powers += cell_power(engine, pose_at((0.0, 0.0, -2.0)), physics)
    rows = powers.sum(axis=1)
    direct, once, twice = (rows[r - 3 : r + 4].sum() for r in (1000, 1038, 1077))
    assert rows.sum() == pytest.approx(direct + once + twice, rel=1e-3)
    # Forty draws of a single cell's power are good for a decibel.
    near = 2.0 if speckle else 0.02
    assert decibel(once / direct) == pytest.approx(5.375, abs=near)
    assert decibel(twice / direct) == pytest.approx(-1.29, abs=near)


def test_a_cloud_swallows_and_scatters() -> None:
    low, high = np.array([1.0, -5.0, -5.0]), np.array([2.0, 5.0, 5.0])
    cloud = Cloud(low, high, attenuation_db_per_m=3.0, volume_strength_db=-40.0)
    scene = Scene((plate(4.0),))
    clear = np.square(picture(scene, MEAN))
    murky = np.square(picture(scene, dataclasses.replace(MEAN, clouds=(cloud,))))
    assert decibel(murky[395:420].sum() / clear[395:420].sum()) == pytest.approx(-6.0, abs=0.2)
    assert murky[110:190].min() > 0.0
    assert not murky[:99].any()
    # Sv dOmega dR / R², dOmega a column's from -40 to 40 degrees of elevation.
    drawn = dataclasses.replace(SPECKLED, clouds=(cloud,))
    fields = [np.square(picture(scene, drawn, ping_id=k))[120:180] for k in range(4)]
    assert decibel(np.mean(fields) / murky[120:180].mean()) == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize("physics", [MEAN, SPECKLED], ids=["mean", "speckled"])
def test_noise_is_heard_once_beside_a_cloud(physics: Physics) -> None:
    cloud = Cloud(np.array([1.0, -5.0, -5.0]), np.array([2.0, 5.0, 5.0]), 3.0, -40.0)
    scene = Scene((plate(4.0),))
    level_db = 20.0 * math.log10(np.median(picture(scene, replaced(MEAN, cloud))[120:180]))
    noisy = dataclasses.replace(physics, noise_level_db=level_db)
    noise = np.square(picture(scene, noisy))
    cloudy = np.square(picture(scene, replaced(physics, cloud)))
    both = np.square(picture(scene, replaced(noisy, cloud)))
    # Equal numbers of noise before the cloud, and the sum of powers in it.
    np.testing.assert_allclose(both[:95], noise[:95], rtol=1e-4)
    inside = [np.mean(power[120:180]) for power in (both, noise, cloudy)]
    assert decibel(inside[0] / (inside[1] + inside[2])) == pytest.approx(0.0, abs=0.5)


def replaced(physics: Physics, cloud: Cloud) -> Physics:
    return dataclasses.replace(physics, clouds=(cloud,))


def test_a_level_sonar_hears_the_floor_straight_below() -> None:
    """From range = height on, by the far lobes: mu pi h² V(h / R) / R⁵ a metre of range."""
    height_m, width_rad = 2.0, math.radians(20.0)
    physics = dataclasses.replace(
        MEAN, vertical_width_rad=width_rad, elevations_rad=ALL_ELEVATIONS_RAD
    )
    sonar = narrow_sonar(3.0, 0.01)
    engine = PingEngine(Scene((floor(-height_m, CHALK),)), sonar)
    rows = cell_power(engine, HERE, physics).sum(axis=1)
    assert not rows[:199].any()
    # So far, all of the ring ahead is within the fan's bearings.
    range_m = np.linspace(height_m, 2.06, 601)
    density = CHALK.mu * math.pi * height_m**2 / range_m**5
    density *= vertical_two_way_power(height_m / range_m, width_rad)
    expected = float(np.trapezoid(density, range_m))
    assert decibel(rows[199:206].sum() / expected) == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("effects", ["auto", "all"])
def test_a_pose_that_is_not_finite_is_refused(effects: str) -> None:
    simulator = Simulator(Scene((floor(-2.0, CHALK),)), narrow_sonar(3.0, 0.01), effects=effects)
    for bad in (math.nan, math.inf):
        with pytest.raises(SonarSimError, match=r"pose at .* is not finite"):
            simulator.ping(pose_at((0.0, 0.0, bad)))
    with pytest.raises(SonarSimError, match="not finite: nan"):
        simulator.ping(HERE, time_s=math.nan)


def test_a_point_target_is_hidden_by_a_wall() -> None:
    hidden = Scene((plate(2.0),), targets=(PointTarget("t", (4.0, 0.0, 0.0), 30.0),))
    assert not picture(hidden, MEAN)[395:].any()
    assert picture(hidden, dataclasses.replace(MEAN, shadows=False))[395:].any()


def test_mirrors_of_polished_plates_glint() -> None:
    glass = Material("glass", -60.0, 0.8, 0.0, 0.01)
    facing = dataclasses.replace(plate(3.0), material=glass)
    dull = np.square(picture(Scene((facing,)), dataclasses.replace(MEAN, specular=False))).sum()
    bright = np.square(picture(Scene((facing,)), MEAN)).sum()
    level = decibel(bright) + 10.0
    assert bright > 1e3 * dull
    assert level == pytest.approx(20.0 * math.log10(0.8 / 6.0), abs=0.2)


def test_truth_names_what_rays_and_pixels_show() -> None:
    scene = Scene((floor(-2.0), dataclasses.replace(plate(4.0), name="wall")))
    sonar = narrow_sonar(8.0, 0.02)
    truth = PingEngine(scene, sonar).ping(HERE, SPECKLED, truth=True).truth
    assert truth is not None
    middle = truth.surface[:, 32]
    assert middle[200] == 1
    assert middle[350] == 0
    assert middle[50] == NOTHING
    assert np.isnan(truth.range_m[50, 32])
    assert truth.range_m[200, 32] == pytest.approx(4.01, abs=1e-3)
    assert np.allclose(truth.normal[200, 32], (-1.0, 0.0, 0.0), atol=1e-6)
    assert np.allclose(truth.normal[350, 32], (0.0, 0.0, 1.0), atol=1e-6)
    assert truth.elevation_rad[350, 32] == pytest.approx(-math.asin(2.0 / 7.01), abs=0.01)
    assert truth.incidence_rad[350, 32] == pytest.approx(math.acos(2.0 / 7.01), abs=0.01)
    assert np.allclose(np.linalg.norm(truth.ray_direction, axis=1), 1.0, atol=1e-6)


def test_bent_rays_meet_what_straight_ones_would_miss() -> None:
    """Speed falls by 1 m/s a metre downwards: rays sag by g R² / 2c, 0.53 m at 40 m."""
    layers = SoundSpeedProfile(np.array([0.0, 100.0]), np.array([1550.0, 1450.0]))
    deep = pose_at((0.0, 0.0, -50.0))
    sonar = narrow_sonar(44.0, 0.05)
    ledge = rectangle((40.0, 0.0, -52.0), (0.0, 8.0, 0.0), (0.0, 0.0, 2.9), DULL)
    top = dataclasses.replace(MEAN, vertical_width_rad=None)
    water = Water(profile=((0.0, 1500.0),))
    engine = PingEngine(Scene((ledge,), water=water), sonar, elevations=1120)
    bent = engine.ping(deep, dataclasses.replace(top, layers=layers), truth=True).truth
    plain = engine.ping(deep, top, truth=True).truth
    assert bent is not None
    assert plain is not None
    higher = bent.ray_elevation_rad.max() - plain.ray_elevation_rad.max()
    assert higher == pytest.approx(0.5 * 40.0 / 1500.0, abs=0.002)
    assert bent.ray_range_m.min() == pytest.approx(40.0, abs=0.03)


def test_a_thin_bar_is_as_loud_in_layers_of_one_speed() -> None:
    """It leans: the parts of cells that lie along it do, too."""
    bar = rectangle((5.0, 0.0, -0.2), (0.0, 0.003, -0.003), (0.0, 0.4, 0.4), CHALK)
    speed = Water().speed_of_sound_mps
    layers = SoundSpeedProfile(np.array([0.0, 50.0]), np.array([speed, speed]))
    pose = pose_at((0.0, 0.0, -2.0))
    moved = dataclasses.replace(bar, vertices_m=bar.vertices_m - np.array([0.0, 0.0, 2.0]))
    engine = PingEngine(Scene((moved,)), narrow_sonar(6.0, 0.01))
    straight, bent = (
        np.square(engine.ping(pose, dataclasses.replace(MEAN, layers=found)).amplitude).sum()
        for found in (None, layers)
    )
    assert 10.0 * np.log10(bent / straight) == pytest.approx(0.0, abs=0.1)


def test_layers_of_one_speed_bend_nothing() -> None:
    scene = Scene((floor(-2.0),), water=Water(profile=((0.0, 1500.0),)))
    layers = SoundSpeedProfile(np.array([0.0, 10.0]), np.array([1500.0, 1500.0]))
    bent = np.square(picture(scene, dataclasses.replace(MEAN, layers=layers))).sum(axis=1)
    plain = np.square(picture(scene, MEAN)).sum(axis=1)
    assert np.allclose(bent[320:580], plain[320:580], rtol=0.02)


def test_a_pixel_shows_what_is_loudest_in_it() -> None:
    """Sea and floor are as far; the sea is fainter, or silent where its echo is not computed."""
    sonar = narrow_sonar(6.0, 0.02)
    for sea_db, physics, shown in (
        (-60.0, dataclasses.replace(MEAN, sea_surface=True), 0),
        (-5.0, dataclasses.replace(MEAN, sea_surface=True), SEA),
        (-5.0, MEAN, 0),
    ):
        scene = Scene((floor(-4.0),), sea=Sea(0.1, sea_db))
        truth = PingEngine(scene, sonar).ping(pose_at((0.0, 0.0, -2.0)), physics, truth=True).truth
        assert truth is not None
        owners = truth.surface[180:, 32]
        assert np.mean(owners == shown) > 0.9


def test_a_pixel_shows_the_flash_and_not_the_larger_dull_thing() -> None:
    """A pane head on behind which a chalk wall of the same range leans over it."""
    glass = Material("glass", -60.0, 0.8, 0.0, 0.02)
    pane = rectangle((4.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.4), glass)
    wall = rectangle((3.94, 0.0, 0.7), (0.0, 4.0, 0.0), (0.0, 0.0, 0.8), DULL)
    scene = Scene((pane, wall))
    sonar = narrow_sonar(6.0, 0.05)
    row = int(4.0 / 0.05)
    flashing, dull = (
        PingEngine(scene, sonar).ping(HERE, physics, truth=True).truth
        for physics in (MEAN, dataclasses.replace(MEAN, specular=False))
    )
    assert flashing is not None
    assert dull is not None
    assert flashing.surface[row, 32] == 0
    assert dull.surface[row, 32] == 1


def test_a_grazing_floor_has_no_stripes() -> None:
    """Rows that lie between two rays are filled like their neighbours."""
    flat = rectangle((6.0, 0.0, -1.0), (30.0, 0.0, 0.0), (0.0, 30.0, 0.0))
    power = np.square(picture(Scene((flat,)), MEAN, 10.0))[300:600, 32]
    smooth = np.convolve(power, np.ones(9) / 9.0, "same")
    assert power[5:-5] == pytest.approx(smooth[5:-5], rel=0.1)


def test_a_small_plate_far_away_is_seen() -> None:
    """1 m at 100 m: whole columns of 3.6 mrad make it one of 2 or 3, which is -1.5 to +0.3 dB."""
    plate = rectangle((100.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    sonar = SonarSettings(demanded_range_m=110.0)
    for lift_m in np.linspace(0.0, 1.0, 5):
        engine = PingEngine(Scene((plate,)), sonar)
        power = cell_power(engine, pose_at((0.0, 0.0, float(lift_m))), MEAN).sum()
        assert decibel(power * 100.0**4 / plate.material.mu) == pytest.approx(-0.6, abs=1.0)


@pytest.mark.parametrize("gain_percent", [50.0, 70.0])
def test_the_ring_lights_the_first_rows_alike_in_each_ping(gain_percent: float) -> None:
    sonar = SonarSettings(demanded_range_m=2.0, gain_percent=gain_percent)
    engine = PingEngine(Scene(), sonar)
    physics = Physics(
        beam_width_rad=sonar.beam_width_rad,
        side_lobe_db=30.0,
        sine_bearings=True,
        speckle=True,
        tvg=True,
        gain=True,
        ring_down_db=-31.0,
    )
    pose = FramePose(np.zeros(3), np.eye(3))
    shown = [engine.ping(pose, physics, ping_id).amplitude for ping_id in (1, 2)]
    level_db = 10.0 * np.log10(np.square(shown[0][:4, 50:-50]).mean(axis=1))
    expected = -31.0 - 1300.0 * sonar.row_centres_m[:4] + 0.96 * (gain_percent - 50.0)
    assert level_db == pytest.approx(expected, abs=1.0)
    assert np.array_equal(shown[0], shown[1])


@pytest.mark.parametrize("physics", [MEAN, SPECKLED], ids=["mean", "speckled"])
def test_water_clouds_and_noise_add_their_powers(physics: Physics) -> None:
    cloud = Cloud(np.array([1.0, -5.0, -5.0]), np.array([5.0, 5.0, 5.0]), 0.0, -55.0)
    parts: list[dict[str, Any]] = [
        {"clouds": (cloud,)},
        {"noise_level_db": 93.0},
        {"volume_strength_db": -60.0},
    ]
    heard = [
        float(np.mean(np.square(picture(Scene(()), dataclasses.replace(physics, **part))[300:400])))
        for part in (*parts, parts[1] | parts[2], parts[0] | parts[1] | parts[2])
    ]
    assert min(heard[:3]) > 0.1 * max(heard[:3])
    assert decibel(heard[3] / (heard[1] + heard[2])) == pytest.approx(0.0, abs=0.1)
    assert decibel(heard[4] / sum(heard[:3])) == pytest.approx(0.0, abs=0.1)
