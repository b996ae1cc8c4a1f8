"""Poses, obstacles and texts for an autopilot, against other computations of the same."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mapperd.bridges.mavlink_messages import (
    SECTORS,
    UNKNOWN_CM,
    JumpCounter,
    autopilot_pose,
    obstacle_distances,
    text_chunks,
)
from mapperd.bridges.vehicle import VehiclePose
from mapperd.export.cells import FREE, OCCUPIED, GridLayer, GridWindow
from mapperd.geometry.frames import Pose, World, pose_from_rpy

S = 1_000_000_000
NO_POINTS = np.zeros((0, 3))


def located(
    place: tuple[float, float, float] = (0, 0, 0),
    yaw_deg: float = 0.0,
    stamp_ns: int = 0,
    velocity: tuple[float, float, float] | None = None,
) -> VehiclePose:
    speed = None if velocity is None else np.array(velocity)
    return VehiclePose(stamp_ns, pose_from_rpy(place, (0, 0, yaw_deg)), speed)


def test_a_vehicle_that_heads_north_is_level_in_ned() -> None:
    """Map: x east, y north, z up. The vehicle heads north, 5 m deep, and moves ahead and up."""
    pose = autopilot_pose(located((1.0, 2.0, -5.0), 90.0, 7_000, (0.0, 1.0, 0.25)), "ned")
    assert pose.time_us == 7
    assert pose.position_m == pytest.approx([2.0, 1.0, 5.0])
    assert pose.angles_rad == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert abs(pose.quaternion[0]) == pytest.approx(1.0)
    assert pose.velocity_mps == pytest.approx([1.0, 0.0, -0.25])
    assert math.isnan(pose.covariance[0])


def test_heading_is_clockwise_from_north() -> None:
    assert autopilot_pose(located(yaw_deg=0.0), "ned").angles_rad[2] == pytest.approx(math.pi / 2)
    to_port = autopilot_pose(located(yaw_deg=30.0), "local_frd")
    assert to_port.angles_rad[2] == pytest.approx(math.radians(-30))
    place = autopilot_pose(located((1.0, 2.0, 3.0)), "local_frd").position_m
    assert place == pytest.approx([1.0, -2.0, -3.0])


def test_nose_up_and_starboard_down_are_positive() -> None:
    nose_down = VehiclePose(0, pose_from_rpy((0, 0, 0), (0, 20, 0)))  # ours: nose down
    assert autopilot_pose(nose_down, "local_frd").angles_rad[1] == pytest.approx(math.radians(-20))
    rolled = VehiclePose(0, pose_from_rpy((0, 0, 0), (10, 0, 0)))  # port up: starboard down
    assert autopilot_pose(rolled, "ned").angles_rad[0] == pytest.approx(math.radians(10))


def test_an_unknown_velocity_is_nan() -> None:
    assert np.isnan(autopilot_pose(located(), "ned").velocity_mps).all()


NED = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD = Rotation.from_matrix([[1, 0, 0], [0, -1, 0], [0, 0, -1]])


@pytest.mark.parametrize(("world", "turn"), [("ned", NED), ("local_frd", FRD)])
def test_orientation_and_covariance_are_those_of_turned_samples(
    world: World, turn: Rotation
) -> None:
    random = np.random.default_rng(5)
    flu = Rotation.from_euler("ZYX", (0.8, -0.4, 0.3))
    shape = random.normal(size=(6, 6))
    covariance = 1e-8 * shape @ shape.T
    samples = random.multivariate_normal(np.zeros(6), covariance, 200_000, method="cholesky")
    place = np.array([3.0, 4.0, -5.0])
    quaternion = np.roll(flu.as_quat(), 1)
    pose = autopilot_pose(VehiclePose(0, Pose(place, quaternion), None, covariance), world)
    assert Rotation.from_quat(np.roll(pose.quaternion, -1)).as_matrix() == pytest.approx(
        (turn * flu * FRD).as_matrix()
    )
    turned = turn * Rotation.from_rotvec(samples[:, 3:]) * flu * FRD
    angles = turned.as_euler("ZYX")[:, ::-1] - np.array(pose.angles_rad)
    moved = turn.apply(samples[:, :3])
    measured = np.cov(np.hstack([moved, angles]).T)[np.triu_indices(6)]
    scale = float(np.abs(measured).max())
    assert pose.covariance == pytest.approx(measured, abs=0.02 * scale)


def test_a_vehicle_on_its_nose_has_a_finite_covariance() -> None:
    pose = VehiclePose(0, pose_from_rpy((0, 0, 0), (0, 90, 0)), None, np.eye(6))
    assert np.isfinite(autopilot_pose(pose, "ned").covariance).all()


def test_the_reset_counter_counts_jumps_and_only_them() -> None:
    jumps = JumpCounter()
    fast = (4.0, 0.0, 0.0)
    assert jumps.take(located((0, 0, 0), 0, 0, fast)) == 0
    assert jumps.take(located((4, 0, 0), 20, 1 * S, fast)) == 0  # as its velocity has it
    assert jumps.take(located((8, 0, 0), 60, 2 * S, fast)) == 0
    assert jumps.take(located((15.5, 0, 0), 60, 3 * S, fast)) == 1  # 3.5 m too far
    assert jumps.take(located((15.5, 0, 0), 150, 3 * S + S // 10)) == 2  # turned at once
    assert jumps.take(located((15.5, 0, 0), 150, 3 * S + S // 5)) == 2
    assert jumps.take(located((15.5, 0, 0), 150, 6 * S)) == 3  # a gap
    assert jumps.take(located((15.5, 0, 0), 150, 5 * S)) == 4  # the clock was set back
    jumps.lose()
    assert jumps.take(located((15.5, 0, 0), 150, 5 * S + 1)) == 5
    assert jumps.take(located((15.5, 0, 0), 150, 5 * S + 2)) == 5


def test_the_reset_counter_wraps_and_a_first_pose_is_no_jump() -> None:
    jumps = JumpCounter()
    jumps.lose()
    for number in range(300):
        assert jumps.take(located(stamp_ns=10 * S * number)) == number % 256


def layer_of(cells: dict[tuple[int, int], int], size: int = 81) -> GridLayer:
    """A slice around the origin, of 0.5 m cells, free but for these."""
    values = np.full((size, size), FREE, np.uint8)
    for (x, y), value in cells.items():
        values[y + size // 2, x + size // 2] = value
    return GridLayer(values, GridWindow(-(size // 2), -(size // 2), size, size))


def test_obstacles_are_where_the_vehicle_sees_them() -> None:
    """A cell 5 m east and one 8 m north; the vehicle at (0.25, 0.25) heads north."""
    layer = layer_of({(10, 0): OCCUPIED, (0, 16): OCCUPIED})
    found = obstacle_distances(layer, 0.5, NO_POINTS, located((0.25, 0.25, 0), 90), 10.0)
    assert found[0] == pytest.approx(775, abs=1)  # ahead: the near edge of the cell
    assert found[18] == pytest.approx(475, abs=1)  # a quarter turn to starboard
    assert found[36] == found[54] == 1001
    assert (found == 1001).sum() > 60


def test_obstacles_of_a_ping_count_too_and_far_ones_do_not() -> None:
    points = np.array([[0.0, -3.0, 0.0], [0.0, -2.0, 0.5], [30.0, 0.0, 0.0]])
    found = obstacle_distances(None, 0.5, points, located(), 20.0)
    assert found[18] == 200  # to starboard of a vehicle that heads along x
    assert (found == UNKNOWN_CM).sum() == SECTORS - 1


def test_unknown_water_is_not_clear() -> None:
    layer = layer_of({(12, 0): 0, (-6, 0): OCCUPIED})
    found = obstacle_distances(layer, 0.5, NO_POINTS, located((0.25, 0.25, 0)), 10.0)
    assert found[0] == UNKNOWN_CM
    assert found[18] == 1001
    assert found[36] == pytest.approx(275, abs=1)
    beyond = obstacle_distances(layer, 0.5, NO_POINTS, located((0.25, 0.25, 0)), 50.0)
    assert beyond[18] == UNKNOWN_CM  # the slice ends before


def ray_to_box_m(
    start_m: tuple[float, float], bearing: float, corner_m: tuple[float, float]
) -> float:
    """Distance along a ray to a box of 0.5 m, by slabs; infinity where it passes."""
    ways = (math.cos(bearing), math.sin(bearing))
    ends = [
        sorted(((low - at) / way, (low + 0.5 - at) / way))
        for at, way, low in zip(start_m, ways, corner_m, strict=True)
    ]
    enter, leave = max(low for low, _ in ends), min(high for _, high in ends)
    return max(enter, 0.0) if enter <= leave and leave >= 0 else math.inf


@pytest.mark.parametrize("cell_m", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("away_cells", [1, 2, 4])
def test_a_cell_near_the_vehicle_leaves_no_gap(cell_m: float, away_cells: int) -> None:
    place = (cell_m / 2, cell_m / 2, 0.0)
    layer = layer_of({(away_cells, y): OCCUPIED for y in (-1, 0, 1)})
    found = obstacle_distances(layer, cell_m, NO_POINTS, located(place), 9.0)
    wide = math.degrees(math.atan2(1.4, away_cells - 0.5))
    inside = [k for k in range(SECTORS) if abs((5 * k + 180) % 360 - 180) < wide]
    farthest = 100 * math.hypot(away_cells + 0.5, 1.5) * cell_m
    assert len(inside) > 3
    assert (found[inside] <= farthest + 1).all()


def test_obstacles_equal_those_of_a_search_by_sector() -> None:
    random = np.random.default_rng(8)
    cells = {(int(x), int(y)): OCCUPIED for x, y in random.integers(-30, 30, (40, 2))}
    vehicle = located((0.6, -0.3, 0), 37.0)
    found = obstacle_distances(layer_of(cells), 0.5, NO_POINTS, vehicle, 15.0)
    expected = np.full(SECTORS, np.inf)
    for x, y in cells:
        for i in (0.0, 0.25, 0.5):
            for j in (0.0, 0.25, 0.5):
                east, north = x * 0.5 + i - 0.6, y * 0.5 + j + 0.3
                away = math.hypot(east, north)
                bearing = math.degrees(math.atan2(north, east)) - 37.0
                sector = round(-bearing / 5.0) % SECTORS
                if away <= 15.0:
                    expected[sector] = min(expected[sector], away)
        for sector in range(SECTORS):
            away = ray_to_box_m((0.6, -0.3), math.radians(37.0 - 5.0 * sector), (x * 0.5, y * 0.5))
            if away <= 15.0:
                expected[sector] = min(expected[sector], away)
    seen = np.isfinite(expected)
    assert seen.sum() > 20
    # A ray that only touches a corner may pass between two of its samples.
    off = found[seen] - 100 * expected[seen]
    assert off.min() > -0.51
    assert (off < 13).mean() > 0.9
    assert np.median(abs(off)) < 6.5
    assert set(found[~seen].tolist()) <= {1501, UNKNOWN_CM}


def test_an_obstacle_that_touches_is_not_zero() -> None:
    found = obstacle_distances(None, 0.5, np.zeros((1, 3)), located(), 15.0)
    assert found.min() == 1


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 100, 150, 199, 200, 500])
def test_a_text_comes_together_again(length: int) -> None:
    text = ("sonar \N{DEGREE SIGN}" * 100)[:length]
    chunks = list(text_chunks(text))
    assert all(len(chunk) == 50 for chunk in chunks[:-1])
    assert len(chunks[-1]) < 50
    assert len(chunks) <= 4
    joined = b"".join(chunks).decode()
    assert text.startswith(joined)
    assert joined == text or len(b"".join(chunks)) > 196
