import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.engine import NODES_PER_BEAM
from sonar_sim.geometry.pose import FramePose, Mounting, rotation_of
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.simulator import SPARSE_NODES_PER_BEAM, Simulator

from oculus_driver.encode import bearing_table_cdeg

Plate = Callable[..., Scene]
SONAR = SonarSettings(demanded_range_m=5.0, gain_percent=65.0)


def brightest(image: np.ndarray) -> tuple[int, int]:
    """Middle row and column of what is bright."""
    rows, columns = np.nonzero(image > image.max() // 2)
    return round(float(np.median(rows))), round(float(np.median(columns)))


@pytest.mark.parametrize("bearing_deg", [-50.0, -10.0, 0.0, 30.0, 60.0])
def test_plate_appears_at_its_range_and_bearing_and_starboard_is_positive(
    plate: Plate, level_pose: FramePose, bearing_deg: float
) -> None:
    bearing = math.radians(bearing_deg)
    # y points to port, so a positive bearing is at negative y.
    towards = np.array([math.cos(bearing), -math.sin(bearing), 0.0])
    across = np.array([math.sin(bearing), math.cos(bearing), 0.0])
    scene = plate(tuple(3.0 * towards), tuple(0.1 * across), (0.0, 0.0, 0.1))
    # One draw of so small a plate's speckle moves its brightest beams by up to a degree.
    draws = [Simulator(scene, SONAR, seed).ping(level_pose, 0).image for seed in range(8)]
    row, column = brightest(np.mean(draws, axis=0))
    assert (row + 0.5) * SONAR.range_resolution_m == pytest.approx(3.0, abs=0.02)
    table_deg = bearing_table_cdeg(SONAR.beams, SONAR.half_aperture_rad) / 100.0
    assert table_deg[column] == pytest.approx(bearing_deg, abs=0.7)


def test_echo_off_the_plane_shows_at_the_bearing_of_its_cone(
    plate: Plate, level_pose: FramePose
) -> None:
    azimuth, elevation = math.radians(40.0), math.radians(10.0)
    at = 3.0 * np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            -math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    across = (0.1 * math.sin(azimuth), 0.1 * math.cos(azimuth), 0.0)
    small = plate(tuple(at), across, (0.0, 0.0, 0.1))
    images = [Simulator(small, SONAR, seed).ping(level_pose, 0).image for seed in range(5)]
    table_deg = bearing_table_cdeg(SONAR.beams, SONAR.half_aperture_rad) / 100.0
    found = [table_deg[brightest(image)[1]] for image in images]
    assert np.median(found) == pytest.approx(39.27, abs=0.5)


def test_mounting_looks_down_with_the_fan_across_and_roll_turns_it_to_port(plate: Plate) -> None:
    # 2 m below the sonar and 1.5 m to port of a vehicle that heads north: at x = -1.5.
    scene = plate((-1.5, 0.0, -2.5), (0.2, 0.0, 0.0), (0.0, 0.2, 0.0))
    level = FramePose(np.zeros(3), rotation_of(0.0, 0.0, math.radians(90.0)))
    rolled = FramePose(np.zeros(3), rotation_of(math.radians(20.0), 0.0, math.radians(90.0)))
    table_deg = bearing_table_cdeg(SONAR.beams, SONAR.half_aperture_rad) / 100.0
    seen_deg = [
        table_deg[brightest(Simulator(scene, SONAR).ping(base @ Mounting().pose, 0).image)[1]]
        for base in (level, rolled)
    ]
    assert seen_deg[0] == pytest.approx(-math.degrees(math.atan2(1.5, 2.0)), abs=1.0)
    # Rolled to port the fan's centre comes nearer to the plate (0.5 m of lever arm moves it too).
    assert seen_deg[0] + 10.0 < seen_deg[1] < 0.0


def test_noise_rises_with_range_and_stays_below_the_echoes() -> None:
    empty = Scene(())
    sonar = SonarSettings(demanded_range_m=10.0, gain_percent=70.0)
    image = Simulator(empty, sonar).ping(FramePose(np.zeros(3), np.eye(3)), 0).image
    assert image[:100].mean() < image[-100:].mean() < 35.0
    assert image[-100:].mean() > 1.0


@pytest.mark.parametrize("pitch_deg", [0.0, 10.0])
def test_sand_two_metres_below_is_seen_to_fifteen(pitch_deg: float) -> None:
    """Its rows are at least 6 dB above the noise, and brighter in the pixels."""
    sonar = SonarSettings(demanded_range_m=20.0, gain_percent=70.0)
    turned = Rotation.from_euler("y", pitch_deg, degrees=True).as_matrix()
    look = FramePose(np.array([0.0, 0.0, -2.0]), turned)
    corners = 200.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) - [0.0, 0.0, 4.0]
    sand = Surface("sand", corners, np.array([[0, 1, 2], [0, 2, 3]]), MATERIALS["sand"])
    seen, empty = (Simulator(scene, sonar).ping(look) for scene in (Scene((sand,)), Scene(())))
    rows = np.abs(sonar.row_centres_m - 14.5) < 0.5
    powers = [np.square(ping.amplitude[rows, 128:-128]).mean() for ping in (seen, empty)]
    assert 10.0 * np.log10(powers[0] / powers[1] - 1.0) > 6.0
    pixels = [ping.image[rows, 128:-128].mean() for ping in (seen, empty)]
    assert pixels[0] > 1.5 * pixels[1]


def test_equal_seed_pose_and_number_give_equal_bytes(plate: Plate, level_pose: FramePose) -> None:
    scene = plate((3.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.3, 0.0, 2.0))
    one = Simulator(scene, SONAR, seed=5).ping(level_pose, 4).image
    again = Simulator(scene, SONAR, seed=5).ping(level_pose, 4).image
    other = Simulator(scene, SONAR, seed=6).ping(level_pose, 4).image
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)


def test_still_scene_correlates_between_pings_and_noise_does_not(
    plate: Plate, level_pose: FramePose
) -> None:
    scene = plate((4.0, 0.0, 0.0), (0.0, 12.0, 0.0), (0.6, 0.0, 2.0))
    simulator = Simulator(scene, SONAR)
    one, two = (simulator.ping(level_pose, k).image.astype(float) for k in (0, 1))
    bright = (one > 60.0) & (one < 250.0) & (two < 250.0)
    quiet = np.zeros_like(bright)
    quiet[270:300] = True  # a band so thin that the gain is the same all over it
    assert np.corrcoef(one[bright], two[bright])[0, 1] > 0.95
    assert abs(np.corrcoef(one[quiet], two[quiet])[0, 1]) < 0.05


def test_seen_surface_is_what_lies_in_the_aperture_and_is_not_hidden(
    plate: Plate, level_pose: FramePose
) -> None:
    wall = plate((4.0, 0.0, 0.0), (0.0, 30.0, 0.0), (0.0, 0.0, 8.0))
    screen = plate((2.0, -1.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 8.0))
    seen = Simulator(Scene((*wall.surfaces, *screen.surfaces)), SONAR).ping(level_pose, 0).seen_m
    range_m = np.linalg.norm(seen, axis=1)
    assert range_m.max() <= SONAR.range_m
    assert np.abs(np.arcsin(seen[:, 2] / range_m)).max() <= math.radians(10.01)
    on_wall = seen[seen[:, 0] > 3.0]
    assert len(on_wall) > 100
    # The screen hides y from -4 to 0 of the wall.
    assert not np.any((on_wall[:, 1] > -2.6) & (on_wall[:, 1] < -0.05))


def test_rays_and_scatterers_are_as_asked_for(plate: Plate, level_pose: FramePose) -> None:
    scene = plate((4.0, 0.0, 0.0), (0.0, 30.0, 0.0), (0.0, 0.0, 8.0))
    usual = Simulator(scene, SONAR).ping(level_pose)
    fewer_rays = Simulator(scene, SONAR, elevations=16).ping(level_pose)
    fewer_scatterers = Simulator(scene, SONAR, nodes_per_beam=2.0).ping(level_pose)
    # As many points in sight as rays meet the plate.
    assert len(fewer_rays.seen_m) == pytest.approx(len(usual.seen_m) / 4, rel=0.2)
    assert np.array_equal(fewer_scatterers.seen_m, usual.seen_m)
    assert not np.array_equal(fewer_scatterers.image, usual.image)


@pytest.mark.parametrize(
    ("effects", "texture", "nodes_per_beam"),
    [
        ("auto", 0.05, SPARSE_NODES_PER_BEAM),
        ("auto", 0.001, NODES_PER_BEAM),
        ("all", 0.05, NODES_PER_BEAM),
    ],
)
def test_auto_takes_as_few_scatterers_as_its_tolerance_allows(
    plate: Plate, level_pose: FramePose, effects: str, texture: float, nodes_per_beam: float
) -> None:
    scene = plate((4.0, 0.0, 0.0), (0.0, 30.0, 0.0), (0.0, 0.0, 8.0))
    tolerance = Tolerance(texture=texture)
    own, asked = (
        Simulator(scene, SONAR, effects=effects, tolerance=tolerance, nodes_per_beam=nodes)
        for nodes in (None, nodes_per_beam)
    )
    np.testing.assert_array_equal(own.ping(level_pose).image, asked.ping(level_pose).image)
