import math
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import pytest
from sonar_sim.errors import SceneError
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import Bubbles, Sea, Sediment
from sonar_sim.scene.sonar import SonarSettings, sonar_preset
from sonar_sim.scene.water import Water
from sonar_sim.scene_file import load_scenario, scene_names

Load = Callable[..., Scenario]


def test_shortest_file_has_every_default(load: Load) -> None:
    scenario = load()
    assert scenario.name == "scene"
    assert scenario.sonar == SonarSettings()
    assert scenario.scene.water == Water()
    assert scenario.scene.sea is None
    assert scenario.scene.surfaces == ()
    assert scenario.vehicle.odometry_rate_hz == 25.0


def test_units_of_the_file_become_ours(load: Load) -> None:
    scenario = load("""
water: {sediment_kg_per_m3: 0.1, sediment_radius_um: 20, profile: [[0, 1500], [10, 1490]]}
sea: {rms_height_mm: 3, lambert_db: -12}
materials: {ice: {lambert_db: -22, roughness_mm: 0.5}}
objects:
  - {name: floe, shape: {kind: box, size_m: [1, 1, 1]}, material: ice, position_m: [3, 0, -1]}
emitters:
  - {name: pinger, position_m: [9, 0, -3], frequency_khz: 700, bandwidth_khz: 50,
     source_level_db: 180, period_s: 0.5, pulse_ms: 2, offset_s: 0.1}
clouds:
  - {name: wake, low_m: [0, 0, -2], high_m: [1, 1, 0],
     matter: {kind: bubbles, radius_um: 100, per_m3: 1e5}}
  - {name: plume, low_m: [0, 0, -5], high_m: [1, 1, -4], matter: {kind: sediment, kg_per_m3: 2}}
sonar: {model: M1200d, mode: 2, range_m: 4, rows: 300, bits: 16, told_speed_mps: 1480}
vehicle: {odometry: {rate_hz: 50, outages_s: [[1, 2]]}}
""")
    scene = scenario.scene
    assert scene.water.sediment_radius_m == pytest.approx(20e-6)
    assert scene.water.profile == ((0.0, 1500.0), (10.0, 1490.0))
    assert scene.sea == Sea(0.003, -12.0)
    assert scene.surfaces[0].material.roughness_m == pytest.approx(5e-4)
    assert scene.emitters[0].frequency_hz == 700e3
    assert scene.emitters[0].pulse_s == pytest.approx(2e-3)
    assert scene.clouds[0].matter == Bubbles(1e-4, 1e5)
    assert scene.clouds[1].matter == Sediment(2.0, 5e-6)
    assert (scenario.sonar.frequency_hz, scenario.sonar.rows) == (2.1e6, 300)
    assert (scenario.sonar.bits, scenario.sonar.told_speed_mps) == (16, 1480.0)
    assert scenario.vehicle.errors.outages_s == ((1.0, 2.0),)


def test_every_parameter_of_the_sonar_can_be_set(load: Load) -> None:
    sonar = load("""
sonar:
  {model: M1200d, mode: 2, range_m: 4, beams: 256, bits: 16, gain_percent: 70, gamma_byte: 127,
   rows: 300, told_speed_mps: 1480, frequency_khz: 900, aperture_deg: 90, beam_width_deg: 0.5,
   vertical_width_deg: 11, max_range_m: 30, base_row_mm: 3, pulse_ms: 0.5, source_level_db: 190,
   array_gain_db: 30, side_lobe_db: 20, noise_excess_db: 35, tvg_spreading_log: 20,
   crosstalk_db: -50, max_rows: 640, ring_down_db: -40, dynamic_focus: false}
""").sonar
    expected = SonarSettings(
        frequency_hz=900e3,
        beams=256,
        half_aperture_rad=math.radians(45),
        beam_width_rad=math.radians(0.5),
        side_lobe_db=20,
        vertical_width_rad=math.radians(11),
        demanded_range_m=4,
        base_row_m=0.003,
        source_level_db=190,
        array_gain_db=30,
        noise_excess_db=35,
        gain_percent=70,
        tvg_spreading_log=20,
        gamma_byte=127,
        model="M1200d",
        mode=2,
        max_range_m=30,
        max_rows=640,
        bits=16,
        forced_rows=300,
        told_speed_mps=1480,
        pulse_s=0.5e-3,
        crosstalk_db=-50,
        ring_down_db=-40,
        dynamic_focus=False,
    )
    standard = sonar_preset("M1200d", 2)
    for field in fields(SonarSettings):
        value = getattr(sonar, field.name)
        assert value == pytest.approx(getattr(expected, field.name)), field.name
        if field.name not in ("model", "mode"):
            assert value != getattr(standard, field.name), field.name
    assert load("sonar: {model: M1200d, mode: 2}").sonar == standard


def test_ping_rate_is_no_higher_than_the_sound_allows(load: Load) -> None:
    far = load("sonar: {range_m: 120, ping_rate_hz: 40}")
    speed_mps = far.scene.water.speed_of_sound_mps
    assert far.true_ping_rate_hz == pytest.approx(speed_mps / (2.0 * far.sonar.range_m))
    assert load("sonar: {range_m: 10, ping_rate_hz: 15}").true_ping_rate_hz == 15.0


SILT = "{kind: sediment, kg_per_m3: 1}"
BOX = "{name: b, shape: {kind: box, size_m: [1, 1, 1]}, material: sand"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("watr: {}", r"\$\.watr: there is no such setting; did you mean water\?"),
        ("water: {temprature_c: 3}", r"\$\.water\.temprature_c: .* did you mean temperature_c"),
        ("water: {temperature_c: warm}", r"\$\.water\.temperature_c: warm is not allowed"),
        ("water: {temperature_c: 300}", r"\$\.water\.temperature_c: 300 is not allowed: .*40"),
        ("water: {temperature_c: .nan}", r"line \d+: \.nan is not a finite number"),
        ("water: {profile: [[5, 1500], [5, 1490]]}", r"\$\.water: .*increase"),
        ("objects: [{name: b}]", r"\$\.objects\[0\]: .*shape"),
        (f"objects: [{BOX}, position_m: [1, 2]}}]", r"\$\.objects\[0\]\.position_m"),
        (
            "objects: [{name: b, material: sand, shape: {kind: cube}}]",
            r"\$\.objects\[0\]\.shape\.kind",
        ),
        (f"objects: [{BOX}, on_floor: true}}]", r"\$\.objects\[0\] \(b\): .*no terrain"),
        (f"objects: [{BOX}, position_m: [0, 0, 4]}}]", r"\$\.objects\[0\] \(b\): nothing of it"),
        (
            f"objects: [{BOX}, position_m: [0, 0, -3]}}, {BOX}, position_m: [0, 0, -3]}}]",
            r"\$\.objects: two objects are called b",
        ),
        (
            "objects: [{name: b, shape: {kind: box, size_m: [1, 1, 1]}, material: cheese}]",
            r"\$\.objects\[0\] \(b\): no material is called cheese; there are .*sand",
        ),
        ("sonar: {model: M750d, mode: 2, range_m: 100}", r"\$\.sonar: .*0\.1 to 40 m"),
        ("sonar: {model: M370s, mode: 2}", r"\$\.sonar: no M370s with mode 2"),
        ("vehicle: {odometry: {dropout: 1}}", r"\$\.vehicle\.odometry\.dropout"),
        (
            f"clouds: [{{name: c, low_m: [0, 0, 0], high_m: [1, 1, 0], matter: {SILT}}}]",
            r"\$\.clouds\[0\]: .*below",
        ),
        ("water: {depth_m: 1, depth_m: 2}", r"line 6: depth_m is set twice"),
        ("a: &x 1\nb: *x", r"line \d+: aliases"),
        ("water: [", r"line \d+: not YAML"),
    ],
)
def test_mistake_is_named_with_file_and_place(load: Load, text: str, words: str) -> None:
    with pytest.raises(SceneError, match=r"scene\.yaml: .*" + words) as caught:
        load(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "mapping of sections"),
        ("[1, 2]", "mapping of sections"),
        ("description: nothing else", "trajectory"),
        ("trajectory: {waypoints: [{position_m: [0, 0, 0]}]}", "two waypoints"),
        ("[" * 100, "nested"),
        ("\x00", "not YAML"),
    ],
)
def test_file_that_is_no_scene_is_refused(load: Load, text: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        load(text, whole=True)


def test_unknown_names_and_paths_are_refused_with_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=re.escape("harbour") + ".*wreck"):
        load_scenario("harbor")
    with pytest.raises(SceneError, match="cannot be read"):
        load_scenario(tmp_path / "none.yaml")
    with pytest.raises(SceneError, match="cannot be read"):
        load_scenario(tmp_path / "folder.d")


def test_numbers_are_what_they_look_like(load: Load) -> None:
    assert load("water: {sediment_kg_per_m3: 1e-3}").scene.water.sediment_kg_per_m3 == 1e-3
    with pytest.raises(SceneError, match="'1:30' is not allowed"):
        load("water: {temperature_c: 1:30}")


def test_nine_scenes_are_shipped() -> None:
    assert scene_names() == [
        "calibration",
        "flat_floor",
        "harbour",
        "open_water",
        "pile_field",
        "pipeline",
        "ship_hull",
        "tank",
        "wreck",
    ]
