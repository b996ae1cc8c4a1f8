"""Rules that compare the coarse picture with and without an effect."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from sonar_sim.effects import multipath
from sonar_sim.effects.multipath import Ghosts, mirror_ghosts
from sonar_sim.effects.previewer import Previewer
from sonar_sim.geometry.pose import rotation_of
from sonar_sim.scene.material import MATERIALS, Material
from sonar_sim.scene.scenario import sonar_pose
from sonar_sim.scene.scene import Bubbles, CloudSpec, Emitter, Scene, Sea, Sediment, Surface
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.water import Water
from sonar_sim.scene_file import load_scenario
from sonar_sim.simulator import Simulator
from sonar_sim.validation.setups import sphere

from tests.sonar_sim.effects.previews import LOUD, SONAR, floor, pose, verdict, view_of, wall

QUIET = replace(SONAR, noise_excess_db=-60.0, bits=16)
STILL_WATER = Water(volume_strength_db=-200.0)


def test_absorption_predicts_twice_alpha_r_of_a_wall() -> None:
    scene = Scene((wall(9.0),), water=STILL_WATER)
    found = verdict("absorption", view_of(scene=scene, sonar=QUIET))
    alpha = STILL_WATER.absorption_db_per_m(QUIET.frequency_hz)
    assert found.on
    assert found.predicted_db == pytest.approx(2 * alpha * QUIET.range_m, abs=0.2)


def test_absorption_is_negligible_within_half_a_metre() -> None:
    near = replace(QUIET, demanded_range_m=0.5)
    scene = Scene((wall(0.4),), water=STILL_WATER)
    assert not verdict("absorption", view_of(scene=scene, sonar=near)).on


def test_shadows_matter_only_with_something_behind() -> None:
    alone = verdict("shadows", view_of(floor()))
    screened = verdict(
        "shadows", view_of(wall(4.0, half_m=1.0), wall(6.0), sonar=QUIET, at=pose(0))
    )
    assert not alone.on
    assert screened.on
    assert screened.predicted_db > 10.0


def test_lambert_is_idle_where_all_is_seen_head_on() -> None:
    narrow = replace(QUIET, half_aperture_rad=0.1)
    small = wall(8.0, half_m=0.5)
    assert not verdict("lambert", view_of(small, sonar=narrow, at=pose(0.0))).on
    assert verdict("lambert", view_of(floor(), sonar=QUIET)).on


def test_vertical_pattern_is_idle_on_the_axis() -> None:
    low = wall(9.0, half_m=0.1)
    assert not verdict("vertical_pattern", view_of(low, sonar=QUIET, at=pose(0.0))).on
    assert verdict("vertical_pattern", view_of(floor(), sonar=QUIET)).on


@pytest.mark.parametrize(("material", "on"), [("sand", False), ("glass", True)])
def test_only_a_smooth_wall_flashes(material: str, *, on: bool) -> None:
    view = view_of(wall(5.0, MATERIALS[material]), at=pose(0.0))
    assert verdict("specular", view).on is on


@pytest.mark.parametrize("gain_percent", [20.0, 50.0])
def test_a_small_plate_head_on_flashes(gain_percent: float) -> None:
    """Its flash fills a handful of pixels of 128 000."""
    sonar = replace(SONAR, gain_percent=gain_percent)
    small = wall(8.0, MATERIALS["aluminium"], half_m=0.1)
    plate = verdict("specular", view_of(small, sonar=sonar, at=pose(0.0)))
    assert plate.on
    assert plate.predicted_db > 20.0
    middle = np.array([8.0, 0.0, 0.0])
    about = (small.vertices_m - middle) @ rotation_of(0.0, 0.0, 0.3).T + middle
    turned = replace(small, vertices_m=about)
    assert not verdict("specular", view_of(turned, sonar=sonar, at=pose(0.0))).on


@pytest.mark.parametrize(("material", "on"), [("aluminium", True), ("sand", False)])
def test_a_polished_ball_flashes(material: str, *, on: bool) -> None:
    ball = sphere((4.0, 0.0, 0.0), 0.1, MATERIALS[material])
    view = view_of(ball, at=pose(0.0))
    assert verdict("specular", view).on is on
    if on:
        # The reflection times half the radius, squared, in all.
        assert 0.25 < view.echoes.lobe_m2.sum() / (0.84 * 0.1 / 2.0) ** 2 < 4.0


def test_a_rod_has_a_far_side_to_hide() -> None:
    """Its ring in the picture without shadows is less than a thousandth of all pixels."""
    mesh = trimesh.creation.cylinder(0.02, 0.6, sections=48)
    points = np.asarray(mesh.vertices) + np.array([2.0, 0.0, 0.0])
    rod = Surface("rod", points, np.asarray(mesh.faces, np.int64), MATERIALS["aluminium"])
    assert verdict("shadows", view_of(rod, at=pose(0.0))).on


def test_noise_shows_at_high_gain_and_not_at_none() -> None:
    assert verdict("noise", view_of(floor(), sonar=replace(SONAR, gain_percent=60.0))).on
    assert not verdict("noise", view_of(floor(), sonar=replace(SONAR, gain_percent=0.0))).on


@pytest.mark.parametrize(("strength_db", "on"), [(-120.0, False), (-45.0, True)])
def test_volume_shows_in_turbid_water(strength_db: float, *, on: bool) -> None:
    scene = Scene((floor(),), water=Water(volume_strength_db=strength_db))
    assert verdict("volume", view_of(scene=scene)).on is on


def test_volume_below_one_step_counts_where_it_is_much_of_the_waters_mean() -> None:
    sonar = replace(SONAR, gain_percent=70.0)
    for strength_db, on in ((-68.0, True), (-105.0, False)):
        scene = Scene(water=Water(volume_strength_db=strength_db))
        view = view_of(scene=scene, sonar=sonar)
        # Under a step of the quantiser in every pixel.
        both, noise = (
            view.gains.amplitude(p) for p in (view.picture, view.noise_power + 0.0 * view.picture)
        )
        assert 255.0 * (both - noise).max() < 1.0
        assert verdict("volume", view).on is on
        with_it, without = (
            Simulator(water, sonar, effects="all").ping(pose()).image.astype(float)
            for water in (scene, Scene(water=STILL_WATER))
        )
        rows = slice(sonar.rows // 8, sonar.rows // 4)
        change_db = 20.0 * np.log10(with_it[rows].mean() / max(without[rows].mean(), 0.02))
        assert bool(change_db > 1.0) is on


@pytest.mark.parametrize(("level_db", "on"), [(-18.5, True), (-80.0, False)])
@pytest.mark.filterwarnings("ignore::sonar_sim.effects.plan.EffectWarning")
def test_the_tail_behind_a_wall_is_computed_where_it_shows(level_db: float, *, on: bool) -> None:
    water = Water(reverberation_db=level_db)
    scene = Scene((wall(5.0, half_m=1.0),), water=water)
    at = pose(0.0)
    assert verdict("reverberation", view_of(scene=scene, at=at)).on is on
    assert not verdict("reverberation", view_of(scene=Scene(water=water))).on
    # What the rule foretells is what the engine gives: mean powers behind the wall.
    sonar = replace(SONAR, noise_excess_db=-50.0, bits=16)
    view = view_of(scene=scene, sonar=sonar, at=at)
    quiet = {"speckle": False, "noise": False, "volume": False}
    shown = Simulator(scene, sonar, effects=quiet | {"reverberation": True}).ping(at).amplitude
    behind = np.abs(view.grid.range_m - 6.5) < 0.3
    rows = np.abs(sonar.row_centres_m - 6.5) < 0.3
    coarse = np.square(view.gains.amplitude(view.tail_picture))[behind].mean(axis=0)
    fine = np.square(shown[rows]).mean(axis=0)
    ratio_db = 10.0 * np.log10(fine[128:-128].mean() / coarse[24:-24].mean())
    assert ratio_db == pytest.approx(0.0, abs=1.0)


def test_the_floor_straight_below_is_called_for_only_if_it_shows() -> None:
    """2 m under a level sonar it is all there is; under a loud wall and by night it is lost."""
    near = Scene((floor(),))
    found = verdict("all_elevations", view_of(scene=near, sonar=LOUD))
    assert found.on
    assert not verdict(
        "all_elevations", view_of(scene=near, sonar=replace(SONAR, gain_percent=0.0))
    ).on
    assert not verdict("all_elevations", view_of(wall(9.0, half_m=2.0), sonar=LOUD)).on


def test_near_field_is_for_sonars_without_focus_near_something() -> None:
    blurred = replace(SONAR, dynamic_focus=False)
    assert not verdict("near_field", view_of(wall(3.0))).on
    found = verdict("near_field", view_of(wall(3.0), sonar=blurred))
    assert found.on
    assert found.predicted_db == pytest.approx(10.0 * np.log10(5.15 / 3.0), abs=0.1)
    assert not verdict("near_field", view_of(wall(6.0), sonar=blurred)).on


@pytest.mark.parametrize(
    ("level_db", "gain_percent", "on"),
    [(-31.0, 50.0, True), (-31.0, 0.0, False), (-90.0, 50.0, False), (None, 50.0, False)],
)
def test_the_ring_is_computed_if_the_first_row_shows_it(
    level_db: float | None, gain_percent: float, *, on: bool
) -> None:
    sonar = replace(SONAR, ring_down_db=level_db, gain_percent=gain_percent)
    assert verdict("ring_down", view_of(floor(), sonar=sonar)).on is on


def test_turbidity_goes_with_the_sediment() -> None:
    def found(kg_per_m3: float) -> tuple[bool, float]:
        water = Water(sediment_kg_per_m3=kg_per_m3, volume_strength_db=-200.0)
        decided = verdict("turbidity", view_of(scene=Scene((wall(9.5),), water=water), sonar=QUIET))
        return decided.on, decided.predicted_db

    # 5 µm silt takes 0.42 dB/m and kg/m³ at 750 kHz (Urick), so 8.4 dB over 10 m there and back.
    on, predicted_db = found(1.0)
    assert on
    assert predicted_db == pytest.approx(8.4, abs=0.4)
    assert not found(0.01)[0]


def test_bubbles_need_a_cloud_in_sight() -> None:
    plume = Bubbles(radius_m=1e-4, per_m3=1e7)
    ahead = CloudSpec("plume", (2.0, -1.0, -4.0), (3.0, 1.0, -1.0), plume)
    behind = replace(ahead, low_m=(-3.0, -1.0, -4.0), high_m=(-2.0, 1.0, -1.0))
    assert verdict("bubbles", view_of(scene=Scene((wall(5.0),), clouds=(ahead,)))).on
    assert not verdict("bubbles", view_of(scene=Scene((wall(5.0),), clouds=(behind,)))).on


def test_a_cloud_of_silt_is_turbidity() -> None:
    silt = CloudSpec("silt", (2.0, -9.0, -9.0), (4.0, 9.0, 0.0), Sediment(2.0))
    view = view_of(scene=Scene((wall(5.0),), clouds=(silt,)))
    assert verdict("turbidity", view).on
    assert not verdict("bubbles", view).on


def test_sea_and_floor_are_distinguished() -> None:
    view = view_of(scene=Scene((floor(5.0),), sea=Sea(0.1, -25.0)), at=pose(2.5), sonar=LOUD)
    assert view.bottoms == {"floor"}
    assert verdict("surface_reverberation", view).on
    assert verdict("bottom_reverberation", view).on
    assert not verdict("surface_reverberation", view_of(floor())).on
    assert not verdict("bottom_reverberation", view_of(wall(5.0))).on


@pytest.mark.parametrize(("rms_height_m", "on"), [(0.0, True), (0.05, False)])
def test_only_a_calm_surface_mirrors(rms_height_m: float, *, on: bool) -> None:
    pile = wall(6.0, MATERIALS["concrete"], half_m=1.0)
    scene = Scene((pile,), sea=Sea(rms_height_m, -60.0))
    view = view_of(scene=scene, at=pose(0.8), sonar=replace(SONAR, demanded_range_m=8.0))
    assert verdict("multipath", view).on is on


@pytest.mark.parametrize("name", ["ship_hull", "tank", "wreck"])
def test_a_plane_left_out_by_its_bound_has_no_ghosts(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = load_scenario(name)
    look = Previewer(scenario.scene, scenario.sonar)
    times_s = np.linspace(0.0, scenario.trajectory.duration_s, 6)
    views = [look.at(sonar_pose(scenario, time_s), 0, time_s) for time_s in times_s]

    def ghosts() -> list[Ghosts | None]:
        """Of the planes, and of the same planes where only a shallow bounce leaves an echo."""
        found = []
        for view in views:
            steep = [replace(plane, roughness_m=0.005) for plane in view.planes]
            found += mirror_ghosts(view, [*view.planes, *steep])
        return found

    bounded = ghosts()
    monkeypatch.setattr(multipath, "_steepest_cosine", lambda *_: np.inf)
    pairs = list(zip(bounded, ghosts(), strict=True))
    assert any(bounded)
    for actual, expected in pairs:
        assert (actual is None) == (expected is None)
        if actual and expected:
            np.testing.assert_array_equal(actual.picture, expected.picture)


def test_side_lobes_need_contrast_within_rows() -> None:
    bright = Material("plate", -5.0)
    plate = wall(6.0, bright, half_m=0.4)
    assert verdict("side_lobes", view_of(plate, floor(), at=pose(0.0))).on
    dim = replace(SONAR, side_lobe_db=80.0)
    assert not verdict("side_lobes", view_of(plate, floor(), at=pose(0.0), sonar=dim)).on


def test_crosstalk_goes_with_its_level() -> None:
    bright = wall(6.0, Material("plate", -5.0), half_m=1.0)

    def on(level_db: float | None) -> bool:
        sonar = replace(QUIET, crosstalk_db=level_db)
        return verdict("crosstalk", view_of(bright, sonar=sonar, at=pose(0.0))).on

    assert on(-20.0)
    assert not on(-150.0)
    assert not on(None)


@pytest.mark.parametrize(
    ("change", "on"),
    [({}, True), ({"frequency_hz": 1.2e6}, False), ({"source_level_db": 60.0}, False)],
)
def test_another_sonar_needs_band_and_level(change: dict[str, Any], *, on: bool) -> None:
    emitter = Emitter("other", (8.0, 1.0, -3.0), 750e3, 100e3, 190.0, 0.01, 1e-3)
    scene = Scene((floor(),), emitters=(replace(emitter, **change),))
    assert verdict("interference", view_of(scene=scene)).on is on


@pytest.mark.parametrize(
    ("name", "idle"),
    [
        ("gain", {"gain_percent": 0.0}),
        ("gamma", {"gamma_byte": 255}),
        ("saturation", {"gain_percent": 10.0}),
    ],
)
def test_the_receiver_follows_its_settings(name: str, idle: dict[str, Any]) -> None:
    loud = replace(SONAR, gain_percent=90.0, gamma_byte=127)
    assert verdict(name, view_of(floor(), sonar=loud)).on
    assert not verdict(name, view_of(floor(), sonar=replace(SonarSettings(), **idle))).on


def test_finer_samples_are_rounded_less() -> None:
    def rounded_db(bits: int) -> float:
        return verdict(
            "quantisation", view_of(floor(), sonar=replace(SONAR, bits=bits))
        ).predicted_db

    assert rounded_db(8) > 1.0
    assert rounded_db(32) < 0.01
