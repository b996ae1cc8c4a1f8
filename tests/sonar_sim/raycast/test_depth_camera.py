import math
from collections.abc import Callable

import numpy as np
import pytest
from sonar_sim.geometry.pose import FramePose, rotation_of
from sonar_sim.raycast.depth_camera import DepthCamera, Pinhole, pinhole_of
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings

CAMERA = Pinhole(80, 40, math.radians(60.0))


def test_a_wall_across_has_one_depth_and_growing_range(
    plate: Callable[..., Scene], level_pose: FramePose
) -> None:
    view = DepthCamera(plate((5, 0, 0), (0, 40, 0), (0, 0, 40))).look(CAMERA, level_pose)
    assert view.depth_m == pytest.approx(5.0, rel=1e-5)
    x, y = np.meshgrid(np.arange(80) - 39.5, np.arange(40) - 19.5)
    away = 5.0 * np.sqrt(1.0 + (x**2 + y**2) / CAMERA.focal_px**2)
    assert view.range_m == pytest.approx(away, rel=1e-5)
    assert view.normals == pytest.approx(np.broadcast_to([0.0, 0.0, -1.0], (40, 80, 3)), abs=1e-6)
    assert view.cos_incidence == pytest.approx(5.0 / away, rel=1e-5)


def test_starboard_is_right_and_up_is_up(
    plate: Callable[..., Scene], level_pose: FramePose
) -> None:
    view = DepthCamera(plate((5, -1, 1), (0, 0.5, 0), (0, 0, 0.5))).look(CAMERA, level_pose)
    row, column = np.argwhere(view.hit).mean(axis=0)
    assert row < 19.5
    assert column > 39.5


def test_normals_are_in_the_optical_frame(
    level_pose: FramePose, plate: Callable[..., Scene]
) -> None:
    view = DepthCamera(plate((5, -1, 0), (2, -2, 0), (0, 0, 4))).look(CAMERA, level_pose)
    half = np.sqrt(0.5)
    assert view.normals[view.hit] == pytest.approx(
        np.broadcast_to([half, 0.0, -half], (int(np.count_nonzero(view.hit)), 3)), abs=1e-5
    )


def test_points_lie_where_the_surface_is(plate: Callable[..., Scene]) -> None:
    pose = FramePose(np.array([1.0, 2.0, 3.0]), rotation_of(0.1, 0.2, 0.3))
    view = DepthCamera(plate((6, 4, 2), (0, 30, 0), (0, 0, 30))).look(CAMERA, pose)
    points = view.points_m() @ pose.rotation.T + pose.position_m
    assert len(points) == np.count_nonzero(view.hit) > 1000
    assert points[:, 0] == pytest.approx(6.0, abs=1e-4)


@pytest.mark.parametrize(("near_m", "far_m"), [(6.0, 9.0), (0.1, 4.0)])
def test_outside_the_clip_nothing_is_seen(
    plate: Callable[..., Scene], level_pose: FramePose, near_m: float, far_m: float
) -> None:
    camera = Pinhole(20, 10, 1.0, near_m, far_m)
    view = DepthCamera(plate((5, 0, 0), (0, 40, 0), (0, 0, 40))).look(camera, level_pose)
    assert not view.hit.any()
    assert not view.depth_m.any()
    assert not view.normals.any()


def test_an_empty_scene_shows_nothing(level_pose: FramePose) -> None:
    view = DepthCamera(Scene(())).look(CAMERA, level_pose)
    assert not view.hit.any()
    assert view.points_m().shape == (0, 3)


def test_the_sonar_s_camera_covers_its_fan() -> None:
    sonar = SonarSettings()
    camera = pinhole_of(sonar, 640)
    assert camera.horizontal_rad == pytest.approx(2.0 * sonar.half_aperture_rad)
    assert camera.vertical_rad == pytest.approx(2.0 * sonar.vertical_width_rad, abs=0.01)
    assert camera.far_m == sonar.range_m
