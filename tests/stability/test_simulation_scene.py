"""Hard cases of the simulator: what rays meet, and where."""

from __future__ import annotations

import dataclasses
import math

import mpmath
import numpy as np
import pytest
from mpmath import mpf
from numpy.typing import NDArray
from sonar_sim import _core
from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import FramePose, quaternion_of, rotation_of
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.propagation.physics import SoundSpeedProfile
from sonar_sim.propagation.refraction import _rotations, _table
from sonar_sim.raycast.meshes import NOTHING, Meshes
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Scene, Sea, Surface
from sonar_sim.scene.water import Water
from sonar_sim.validation.setups import (
    CHALK,
    DULL,
    MEAN,
    floor,
    narrow_sonar,
    pose_at,
    rectangle,
    sphere,
    target,
)

Floats = NDArray[np.float64]
UTM = (566_000.0, 4_649_776.0, 0.0)
AHEAD = np.array([[1.0, 0.0, 0.0]], np.float32)


def surface(corners: list[list[float]], faces: list[list[int]]) -> Surface:
    return Surface("odd", np.array(corners, float), np.array(faces), MATERIALS["sand"])


def met(scene: Scene, origin: tuple[float, ...], rays: NDArray[np.float32]) -> Floats:
    found = Meshes(scene).cast(np.array(origin, float), rays, 0.0, np.inf)
    return np.where(found.face == NOTHING, np.nan, found.range_m).astype(np.float64)


def moved(one: Surface, by: tuple[float, ...]) -> Surface:
    return dataclasses.replace(one, vertices_m=one.vertices_m + np.array(by))


def test_triangles_without_area_are_met_by_nobody() -> None:
    """Meshes from drawings hold triangles of two equal corners, or of three on a line.

    Naively their normal is 0 / 0, and one such triangle makes every echo beside it no number.
    """
    good = [[2.0, -1, -1], [2.0, 1, -1], [2.0, 0, 1]]
    flat = [[1.0, 0, 0], [1.0, 0, 0], [1.0, 1, 0], [1.0, 2, 0], [1.0, 3, 0]]
    faces = [[0, 1, 2], [3, 4, 5], [5, 6, 7], [3, 3, 3]]
    meshes = Meshes(Scene((surface(good + flat, faces),)))
    assert np.isfinite(meshes.planes).all()
    assert len(meshes.planes) == 2  # and the sea's
    assert met(Scene((surface(good + flat, faces),)), (0.0, 0, 0), AHEAD) == pytest.approx([2.0])


def test_a_scene_of_nothing_but_triangles_without_area_is_open_water() -> None:
    """A mesh may be degenerate as a whole: a point, saved as an object.

    Naively there is an extent of 0 to compare areas with, and a tree over no triangles.
    """
    point = surface([[1.0, 0, 0]] * 3, [[0, 1, 2]])
    engine = PingEngine(Scene((point,)), narrow_sonar(5.0, 0.05))
    shown = engine.ping(pose_at((0.0, 0.0, 0.0)), MEAN).amplitude
    assert (shown == 0).all()


@pytest.mark.parametrize("gap_m", [0.0, 1e-6, 1e-3])
def test_a_sonar_in_a_wall_or_a_hair_before_it_sees_what_is_ahead(gap_m: float) -> None:
    """A sonar bolted to a wall, or lying on the floor, starts its rays in a triangle or a hair off.

    Naively they meet it at range 0, or at one that is a rounding, where spreading is infinite, and
    nothing else: the sonar is blind.
    """
    wall = rectangle((3.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), CHALK)
    behind = rectangle((-gap_m, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), CHALK)
    behind = dataclasses.replace(behind, name="behind")
    sonar = narrow_sonar(5.0, 0.05)
    for beside in (behind, dataclasses.replace(floor(-gap_m), name="floor")):
        scene = Scene((wall, beside))
        shown = PingEngine(scene, sonar).ping(pose_at((0.0, 0.0, 0.0)), MEAN).amplitude
        assert np.isfinite(shown).all()
        assert abs(int(np.argmax(shown[20:, 32])) + 20 - 60) <= 1


def test_an_echo_from_next_to_the_transducer_is_finite() -> None:
    """A fish before the sonar's face: power falls as 1 / r⁴, and r goes to nothing.

    Naively the first row's echo is infinite and takes the picture's mean, its crosstalk and its
    scale with it.
    """
    sonar = narrow_sonar(2.0, 0.02)
    for range_m in (1e-9, 1e-3, 0.02, 0.5):
        near = Scene(targets=(target((range_m, 0.0, 0.0)),))
        plate = rectangle((range_m, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), CHALK)
        for scene in (near, Scene((plate,))):
            shown = PingEngine(scene, sonar).ping(pose_at((0.0, 0.0, 0.0)), MEAN).amplitude
            assert np.isfinite(shown).all()
            assert shown.max() < 1e18


def test_two_surfaces_in_one_place_echo_as_one() -> None:
    """Two drawings of one quay lie on each other, triangle upon triangle.

    Naively each ray meets one or the other by the last bit, and from each edge between them it is
    traced again; or both echo, 3 dB too loud.
    """
    wall = rectangle((3.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), DULL)
    twin = dataclasses.replace(wall, name="twin")
    cut = rectangle((3.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), DULL, cuts=7)
    sonar, pose = narrow_sonar(5.0, 0.05), pose_at((0.0, 0.0, 0.0))
    once = PingEngine(Scene((wall,)), sonar).ping(pose, MEAN).amplitude.astype(float)
    for other in (twin, dataclasses.replace(cut, name="cut")):
        twice = PingEngine(Scene((wall, other)), sonar).ping(pose, MEAN).amplitude.astype(float)
        assert np.square(twice).sum() == pytest.approx(np.square(once).sum(), rel=0.01)


def test_a_harbour_in_universal_coordinates_looks_as_at_the_origin() -> None:
    """Scenes from surveys lie 4650 km from the zero of their zone.

    Naively triangles and rays are in single precision there, in steps of half a metre: a wall is a
    staircase, or not met.
    """
    parts = (
        rectangle((3.0, 0.5, 0.0), (0.0, 2.0, 0.0), (0.3, 0.0, 2.0), CHALK),
        sphere((2.0, -0.3, 0.1), 0.1, DULL),
        floor(-1.0),
    )
    sonar = narrow_sonar(5.0, 0.02)
    here = PingEngine(Scene(parts), sonar).ping(pose_at((0.0, 0.0, 0.0)), MEAN).amplitude
    far_parts = tuple(moved(part, UTM) for part in parts)
    far = PingEngine(Scene(far_parts), sonar).ping(pose_at(UTM), MEAN).amplitude
    loud = here > 0.01 * here.max()
    assert np.median(np.abs(far[loud] / here[loud] - 1)) < 1e-3
    assert np.square(far.astype(float)).sum() == pytest.approx(
        np.square(here.astype(float)).sum(), rel=2e-3
    )


@pytest.mark.parametrize("height_m", [1e-6, 1e-3, 0.1])
def test_a_floor_seen_along_has_no_infinite_patch(height_m: float) -> None:
    """A sonar that lies on the floor sees it at an angle of a millionth.

    Naively a patch's area is a cell's over the sine of grazing, and a cell reaches from here to the
    horizon: the floor is brighter than a wall.
    """
    sonar, pose = narrow_sonar(20.0, 0.1), pose_at((0.0, 0.0, height_m))
    shown = PingEngine(Scene((floor(0.0),)), sonar).ping(pose, MEAN).amplitude
    assert np.isfinite(shown).all()
    wall = rectangle((10.0, 0.0, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, 20.0), DULL)
    facing = PingEngine(Scene((wall,)), sonar).ping(pose, MEAN).amplitude
    assert shown[95:105, 32].mean() < 0.05 * facing[95:105, 32].max()


def test_rays_at_the_sea_s_surface_meet_it_once_or_never() -> None:
    """A sonar may float at z = 0 exactly, and a ray run along the surface.

    Naively the range is a height of 0 over a rise of 0, or a ray from the surface meets it at once.
    """
    scene = Scene(sea=Sea())
    up = np.array([[0.0, 0, 1], [1.0, 0, 0], [1.0, 0, 1e-30], [1.0, 0, -0.0]], np.float32)
    assert np.isnan(met(scene, (0.0, 0.0, 0.0), up)).all()
    assert np.isnan(met(scene, (0.0, 0.0, 1.0), up)).all()
    below = met(scene, (0.0, 0.0, -5e-324), up)
    assert (np.isnan(below) | (below >= 0)).all()
    deep = met(scene, (0.0, 0.0, -100.0), up)
    assert deep[0] == pytest.approx(100.0)
    assert np.isnan(deep[[1, 3]]).all()
    assert np.isnan(deep[2]) or deep[2] > 1e6


def test_a_gradient_that_goes_to_nothing_bends_as_little() -> None:
    """Sound bends in circles of radius c / gradient, which is infinite in even water.

    Naively the circle is drawn: its centre is at 1e20 m, and the place on it a difference of two
    such numbers.
    """
    for gradient in (0.0, 1e-15, 1e-9, 1e-3, 0.3):
        speeds = np.array([1500.0, 1500.0 + 100 * gradient])
        layers = SoundSpeedProfile(np.array([0.0, 100.0]), speeds)
        point = np.array([[0.0, 0.0, -20.0]])
        direction = np.array([[math.cos(0.1), 0.0, math.sin(0.1)]])
        angle = mpf("0.1")
        for step in range(16):
            speed, direction = _core.turned_rays(
                _table(layers), point, direction, 2.0, 2.0 if step else 1.0
            )
            point = point + 2.0 * direction
        # Snell: cos(angle) / c is the same all along.
        end = mpmath.acos(mpmath.cos(angle) * mpf(float(speed[0])) / mpf(1500 + 20 * gradient))
        got = math.asin(float(direction[0, 2]))
        assert got == pytest.approx(float(end), abs=1e-4 * gradient + 3e-9)
        assert np.linalg.norm(direction[0]) == pytest.approx(1.0, abs=1e-12)


def test_a_bent_ray_straight_up_or_down_stays_so() -> None:
    """A ray that crosses the layers at right angles has no angle to bend by.

    Naively its level part, by which it is divided, is 0.
    """
    layers = SoundSpeedProfile(np.array([0.0, 10.0, 11.0]), np.array([1530.0, 1530.0, 1480.0]))
    for z in (1.0, -1.0):
        direction = np.array([[0.0, 0.0, z], [1e-12, 0.0, z]])
        point = np.array([[0.0, 0.0, -10.5], [0.0, 0.0, -10.5]])
        for _ in range(8):
            _, direction = _core.turned_rays(_table(layers), point, direction, 0.5, 0.5)
            point = point + 0.5 * direction
        assert direction == pytest.approx(np.array([[0.0, 0, z]] * 2), abs=1e-6)


def test_the_turn_between_directions_all_but_equal_is_a_rotation() -> None:
    """A bent path is reported as a straight one with a tiny rotation.

    Naively the turn is about the cross product's axis, made a unit vector: 0 / 0 for equal ones.
    """
    start = np.array([[1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], [0.6, 0.8, 0.0], [0.6, 0.8, 0.0]])
    near = [math.cos(1e-4), 0, math.sin(1e-4)]
    end = np.array([[1.0, 0, 0], [1.0, 1e-12, 0], near, [0, 0, 1.0], [1.0, 0, 0]])
    turns = _rotations(start, end)
    assert np.einsum("nij,nj->ni", turns, start) == pytest.approx(end, abs=1e-11)
    assert turns @ turns.transpose(0, 2, 1) == pytest.approx(np.tile(np.eye(3), (5, 1, 1)))


def test_quaternions_of_half_turns_are_unit_and_right() -> None:
    """A rotation by 180° has no real part, and about any axis one of its parts may be 0.

    Naively the quaternion is the matrix's differences over four times the real part: 0 / 0.
    """
    turns = [np.diag(axis) for axis in ((1.0, -1, -1), (-1.0, 1, -1), (-1.0, -1, 1))]
    turns += [rotation_of(math.pi, 1e-9, 0), rotation_of(1e-9, math.pi, 0), np.eye(3)]
    for rotation in turns:
        w, x, y, z = quaternion_of(rotation)
        assert w >= 0
        back = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        assert back == pytest.approx(rotation, abs=1e-12)


def test_a_path_that_turns_back_on_the_spot_has_finite_rates() -> None:
    """A vehicle may turn by many rounds where it stands, or pass one waypoint twice.

    Naively a leg of no length takes no time, and two knots of one moment have no slope.
    """
    spot = [Waypoint(1.0, 2.0, -3.0, yaw) for yaw in (0.0, 0.0, 720.0, -180.0)]
    path = Trajectory(spot, Motion(sway_deg=0.0, heave_m=0.0))
    times = np.linspace(0.0, path.duration_s, 50)
    rates = np.array([path.turn_rates_rps(t) for t in times])
    speeds = np.array([path.velocity_mps(t) for t in times])
    assert np.isfinite(rates).all()
    assert np.abs(rates).max() < math.radians(60.0)
    assert np.abs(speeds).max() < 1e-9


def test_one_speed_over_all_depths_bends_nothing_far_out_and_deep() -> None:
    """A profile of one speed is a straight way, also far from the layers' own depths.

    Naively depths beyond the profile are carried on along its last slope, to a speed of 0.
    """
    even = Water(profile=((0.0, 1500.0), (10.0, 1480.0)))
    assert even.speed_at_mps(1e9) == 1480.0
    assert even.speed_at_mps(-1e9) == 1500.0
    layers = SoundSpeedProfile(np.array([0.0, 10.0]), np.array([1500.0, 1480.0]))
    wall = rectangle((3.0, 0.0, -6000.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), CHALK)
    engine = PingEngine(Scene((wall,)), narrow_sonar(5.0, 0.05))
    pose = FramePose(np.array([0.0, 0.0, -6000.0]), np.eye(3))
    straight = engine.ping(pose, MEAN).amplitude
    bent = engine.ping(pose, dataclasses.replace(MEAN, layers=layers)).amplitude
    assert np.argmax(bent[:, 32]) == pytest.approx(np.argmax(straight[:, 32]), abs=1)
