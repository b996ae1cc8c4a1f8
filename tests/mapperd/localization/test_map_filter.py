"""The policy's filter on the core's: maps, settings, models, and what it believes."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.localizer import Localizer
from mapperd.localization.map_filter import MapFilter
from mapperd.localization.maps import GridMap, VolumeMap, volume_map
from mapperd.localization.scan import Scan
from mapperd.localization.update_gate import PlanarPose
from mapperd.mapping.queries import MapQueries
from mapperd.mapping.sonar_map import SonarMap

CELL_M = 0.1
SIGMA = np.diag([0.3**2, 0.3**2, 0.1**2])
AT_REST = PlanarPose(0, 0, 0)


def room() -> GridMap:
    """8 m x 6 m of water, a wall around it, and a block in a corner."""
    cells = np.full((62, 82), 100, dtype=np.int8)
    cells[1:-1, 1:-1] = 0
    cells[1:12, 1:20] = 100
    return GridMap(cells, CELL_M, -0.1, -0.1)


def config(text: str = "") -> Config:
    return config_from_text(
        f"amcl: {{laser_max_range: 10, recovery_alpha_fast: 0, recovery_alpha_slow: 0, {text}}}"
    )


def scan_from(pose: tuple[float, float, float], stamp_ns: int = 0) -> Scan:
    """What a sonar at a pose sees of the room, ray by ray in small steps."""
    x, y, yaw = pose
    bearing = np.linspace(-1.0, 1.0, 41)
    steps = np.arange(0.0, 10.0, 0.02)
    azimuth = yaw - bearing
    points = np.stack(
        [
            x + steps[:, None] * np.cos(azimuth),
            y + steps[:, None] * np.sin(azimuth),
        ],
        axis=-1,
    )
    grid = room()
    hit = np.array([grid.cells_at(column) == 100 for column in points.transpose(1, 0, 2)])
    range_m = steps[hit.argmax(axis=1)] + 0.05
    ends = np.stack([range_m * np.cos(bearing), -range_m * np.sin(bearing), np.zeros(41)], axis=1)
    return Scan(
        stamp_ns, bearing, range_m, ends, np.ones(41), np.arange(41), np.empty(0), 10.0, np.eye(4)
    )


def solid(voxel_m: float = 0.1) -> VolumeMap:
    """The room 2 m high, as a 3D map."""
    made = SonarMap(config_from_text(f"octree: {{voxel_resolution: {voxel_m}}}"))
    grid = room()
    rows, columns = np.nonzero(grid.occupancy == 100)
    walls = grid.centres_m(rows, columns)
    for z in np.arange(-2.95, -1.0, voxel_m):
        made.core.set_log_odds(
            np.column_stack([walls, np.full(len(walls), z)]), np.full(len(walls), 3.0)
        )
    rows, columns = np.nonzero(grid.occupancy == 0)
    water = grid.centres_m(rows, columns)
    made.core.set_log_odds(
        np.column_stack([water, np.full(len(water), -1.95)]), np.full(len(water), -3.0)
    )
    queries = MapQueries(made.core, occupied_threshold=0.7, free_threshold=0.3)
    return volume_map(queries, np.array([-1, -1, -3.0]), np.array([9, 7, -1.0]), (-2.0, -1.9), 2.0)


def set_layer(known: SonarMap, places_m: NDArray[np.float64], z_m: float, log_odds: float) -> None:
    points = np.column_stack([places_m, np.full(len(places_m), z_m)])
    known.core.set_log_odds(points, np.full(len(points), log_odds))


def silent(stamp_ns: int) -> Scan:
    """No returns."""
    none = np.empty(0)
    return Scan(
        stamp_ns, none, none, np.empty((0, 3)), none, np.empty(0, int), none, 9.0, np.eye(4)
    )


def follow(particles: MapFilter, path: list[tuple[float, float, float]]) -> Belief:
    """Odometry is exact; the start is 0.3 m and 5 degrees off."""
    x, y, yaw = path[0]
    particles.start_at(PlanarGaussian(x + 0.2, y - 0.2, yaw + 0.09, SIGMA))
    before, found = PlanarPose(*path[0]), None
    for k, pose in enumerate(path):
        now = PlanarPose(*pose)
        found = particles.update(before, now, scan_from(pose, k * 10**9), -2.0)
        before = now
    assert found is not None
    return found


PATH = [(3.0 + 0.3 * k, 3.0 + 0.05 * k, 0.2 + 0.05 * k) for k in range(8)]


@pytest.mark.parametrize("model", ["likelihood_field", "likelihood_field_prob", "beam"])
@pytest.mark.parametrize("known", [room(), solid()], ids=["2d", "3d"])
def test_vehicle_is_found_near_its_start(model: str, known: GridMap | VolumeMap) -> None:
    noise = ", ".join(f"odom_alpha{k}: 0.01" for k in range(1, 6))
    particles = MapFilter(config(f"laser_model_type: {model}, laser_sigma_hit: 0.1, {noise}"))
    particles.take_map(known)
    best = follow(particles, PATH).best
    assert math.hypot(best.x_m - PATH[-1][0], best.y_m - PATH[-1][1]) < 0.15
    assert abs(best.yaw_rad - PATH[-1][2]) < 0.05


@pytest.mark.parametrize("ahead_m", [0.0, 1.5])
def test_beams_are_cast_from_the_sonar(ahead_m: float) -> None:
    """A sonar ahead of the base: the base stands so far behind where the rays begin."""
    particles = MapFilter(config("laser_model_type: beam, laser_sigma_hit: 0.05"))
    particles.take_map(room())
    mounted = np.eye(4)
    mounted[0, 3] = ahead_m
    seen = scan_from((4.0, 3.0, 0.3))
    scan = replace(seen, points_m=seen.points_m + mounted[:3, 3], level_T_sonar=mounted)
    x = 4.0 - ahead_m * math.cos(0.3)
    y = 3.0 - ahead_m * math.sin(0.3)
    fits = []
    for off_m in (0.0, 0.3, -0.3):
        particles.start_at(PlanarGaussian(x + off_m, y, 0.3, np.zeros((3, 3))))
        particles.update(AT_REST, AT_REST, scan, -2.0)
        assert particles.weighed is not None
        fits.append(particles.weighed.log_evidence)
    assert fits[0] > max(fits[1:]) + 0.5


def test_slice_is_free_where_the_vehicle_is_and_distances_are_truncated() -> None:
    known = solid()
    assert known.grid.cells_at(np.array([[4.0, 3.0], [0.5, 0.5], [8.8, 6.8]])).tolist() == [
        0,
        100,
        -1,
    ]
    assert known.has_free_cells
    assert known.distances_m.max() == 2.0
    with pytest.raises(ValueError, match="read-only"):
        known.distances_m[0, 0, 0] = 1.0


def test_two_places_alike_are_ambiguous_and_one_is_not() -> None:
    particles = MapFilter(config())
    particles.take_map(GridMap(np.zeros((60, 80), np.int8), CELL_M))
    poses = np.zeros((1000, 3))
    poses[:300, 0] = 5.0
    particles.particles.start_with(poses)
    found = particles.update(AT_REST, AT_REST, silent(0), 0.0)
    assert found.best.x_m == pytest.approx(0.0)
    assert found.elsewhere == pytest.approx(0.3)
    assert found.ambiguous
    assert found.overall.x_m == pytest.approx(1.5)
    poses[:300, 0] = 0.1
    particles.particles.start_with(poses)
    found = particles.update(AT_REST, AT_REST, silent(0), 0.0)
    assert (found.elsewhere, found.ambiguous) == (0.0, False)


def test_noise_floors_grow_with_the_root_of_time() -> None:
    text = "localization: {sigma_floor_xy: 0.1, sigma_floor_yaw: 0.01}"
    particles = MapFilter(config_from_text(text))
    particles.take_map(GridMap(np.zeros((60, 80), np.int8), CELL_M))
    particles.start_at(PlanarGaussian(1, 1, 0, np.zeros((3, 3))))
    first = particles.update(AT_REST, AT_REST, silent(0), 0.0)
    assert first.overall.covariance[0, 0] < 1e-9
    found = particles.update(AT_REST, AT_REST, silent(4 * 10**9), 0.0)
    assert math.sqrt(found.overall.covariance[0, 0]) == pytest.approx(0.2, rel=0.05)
    assert math.sqrt(found.overall.covariance[2, 2]) == pytest.approx(0.02, rel=0.05)
    found = particles.update(AT_REST, AT_REST, silent(5 * 10**9), 0.0)
    assert math.sqrt(found.overall.covariance[0, 0]) == pytest.approx(0.1 * 5**0.5, rel=0.05)
    back = particles.update(AT_REST, AT_REST, silent(10**9), 0.0)  # a clock that was set
    assert back.overall.covariance[0, 0] == pytest.approx(found.overall.covariance[0, 0], rel=0.1)


def test_log_product_is_tempered() -> None:
    reported = []
    for tempering in (1.0, 0.2):
        model = "amcl: {laser_model_type: likelihood_field_prob}"
        text = f"{{{model}, localization: {{tempering: {tempering}}}}}"
        particles = MapFilter(config_from_text(text))
        particles.take_map(room())
        particles.start_at(PlanarGaussian(4, 3, 0.3, np.zeros((3, 3))))
        particles.update(AT_REST, AT_REST, scan_from((4.0, 3.0, 0.3)), -2.0)
        assert particles.weighed is not None
        reported.append(particles.weighed.log_evidence)
    assert reported[1] == pytest.approx(0.2 * reported[0], rel=1e-9)


def test_settings_are_taken_whole_and_keep_the_particles() -> None:
    particles = MapFilter(config())
    particles.take_map(room())
    particles.start_at(PlanarGaussian(3, 3, 0, SIGMA))
    before = particles.particles.poses
    particles.reconfigure(config("laser_model_type: beam, max_particles: 200, min_particles: 200"))
    assert np.array_equal(particles.particles.poses, before)
    found = particles.update(AT_REST, AT_REST, scan_from((3, 3, 0)), 0.0)
    particles.update(AT_REST, AT_REST, scan_from((3, 3, 0), 1), 0.0)
    assert len(particles.particles) == 200
    assert found.best.x_m == pytest.approx(3.0, abs=0.2)


def test_both_policies_give_equal_bits() -> None:
    found: list[Any] = []
    for policy in ("seq", "par"):
        particles = MapFilter(config(f"execution_policy: {policy}"))
        particles.take_map(solid())
        follow(particles, PATH[:3])
        found.append(particles.particles.poses)
    assert np.array_equal(*found)


def test_start_anywhere_needs_a_free_cell() -> None:
    particles = MapFilter(config())
    with pytest.raises(ValueError, match="no free cell"):
        particles.start_anywhere()
    particles.take_map(GridMap(np.full((5, 5), -1, np.int8), 1.0))
    with pytest.raises(ValueError, match="no free cell"):
        particles.start_anywhere()


def test_localizer_runs_on_it() -> None:
    settings = config_from_text("localization: {mode: global}")
    particles = MapFilter(settings)
    localizer = Localizer(particles, settings)
    assert localizer.take_map(solid()) is None
    spread = particles.particles.poses
    assert len(spread) == settings.amcl.max_particles
    assert np.ptp(spread[:, 0]) > 7
    assert localizer.take_pose(PlanarGaussian(3, 3, 0, SIGMA), "map") is None
    assert abs(particles.particles.poses[:, 0].mean() - 3) < 0.05
