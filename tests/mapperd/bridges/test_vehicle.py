"""The pose that is sure, the tree of frames, the slice of the map, rates."""

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapperd.bridges.vehicle import (
    REPORT_VALID_S,
    HeldLocalization,
    LinkReporter,
    MapFrames,
    RateLimit,
    VehiclePose,
    map_slice,
    sure_pose,
)
from mapperd.client.changes import ConnectionStatus
from mapperd.client.mirror import MapMirror
from mapperd.errors import ExportError
from mapperd.export.cells import FREE, OCCUPIED, UNKNOWN
from mapperd.geometry.frames import Pose, angles_of
from mapperd.wire.blocks import CELLS, BlockSet
from mapperd.wire.blocks import UNKNOWN as UNKNOWN_CELL
from mapperd.wire.messages import Interest, LocalizationMessage, MapInfo, PoseMessage

S = 1_000_000_000
TURN = Rotation.from_euler("ZYX", (0.7, 0.2, -0.3))
MOUNTING = Rotation.from_euler("ZYX", (0.1, 0.5, 0.0))
CORRECTION = Rotation.from_euler("Z", 0.4)
SHIFT_M = np.array([3.0, -2.0, 0.0])
COVARIANCE = np.arange(36.0).reshape(6, 6) + np.arange(36.0).reshape(6, 6).T + 40 * np.eye(6)


def xyzw(turn: Rotation) -> tuple[float, float, float, float]:
    x, y, z, w = turn.as_quat().tolist()
    return x, y, z, w


def vehicle(source: str = "odometry", **changes: object) -> PoseMessage:
    place = np.array([10.0, 20.0, -5.0])
    x, y, z = (place + TURN.apply([0.5, 0.0, -0.25])).tolist()
    message = PoseMessage(
        stamp_ns=7 * S,
        position_m=(10.0, 20.0, -5.0),
        orientation_xyzw=xyzw(TURN),
        sonar_position_m=(x, y, z),
        sonar_orientation_xyzw=xyzw(TURN * MOUNTING),
        velocity_mps=(1.0, 2.0, 3.0),
        covariance=tuple(COVARIANCE.ravel().tolist()),
        source=source,
    )
    return msgspec.structs.replace(message, **changes)


def localization(**changes: object) -> LocalizationMessage:
    x, y, z, w = xyzw(CORRECTION)
    report = {
        "state": "localized",
        "sure": True,
        "pose": {
            "x_m": 1.0,
            "y_m": 2.0,
            "yaw_rad": 0.5,
            "covariance": [[0.1, 0.01, 0.02], [0.01, 0.2, 0.03], [0.02, 0.03, 0.3]],
        },
        "map_odom": {"position_m": SHIFT_M.tolist(), "orientation_wxyz": [w, x, y, z]},
    }
    return LocalizationMessage(report=report | changes)


def same(one: Pose, position_m: NDArray[np.float64], turn: Rotation) -> None:
    np.testing.assert_allclose(one.position_m, position_m, atol=1e-12)
    np.testing.assert_allclose(
        Rotation.from_quat(np.roll(one.map_q_base, -1)).as_matrix(), turn.as_matrix(), atol=1e-12
    )


def test_angles_are_those_of_another_library() -> None:
    for turn in Rotation.random(50, rng=np.random.default_rng(1)):
        yaw, pitch, roll = turn.as_euler("ZYX")
        assert angles_of(np.roll(turn.as_quat(), 1)) == pytest.approx((roll, pitch, yaw), abs=1e-9)


def test_a_pose_by_localization_is_taken_as_it_is() -> None:
    found = sure_pose(vehicle("localization"), localization(), odometry=False)
    assert isinstance(found, VehiclePose)
    same(found.pose, np.array([10.0, 20.0, -5.0]), TURN)
    assert found.covariance is not None
    np.testing.assert_array_equal(found.covariance, COVARIANCE)


def test_a_pose_by_odometry_is_moved_into_the_known_map() -> None:
    found = sure_pose(vehicle(), localization(), odometry=False)
    assert isinstance(found, VehiclePose)
    same(found.pose, CORRECTION.apply([10.0, 20.0, -5.0]) + SHIFT_M, CORRECTION * TURN)
    assert found.velocity_mps is not None
    np.testing.assert_allclose(found.velocity_mps, CORRECTION.apply([1.0, 2.0, 3.0]))
    assert found.covariance is not None
    planar = [0, 1, 5]
    estimate = localization().report["pose"]["covariance"]
    np.testing.assert_allclose(found.covariance[np.ix_(planar, planar)], estimate)
    assert found.covariance[2, 2] == pytest.approx(COVARIANCE[2, 2])
    assert not found.covariance[np.ix_(planar, [2, 3, 4])].any()


def test_axes_without_a_variance_are_uncertain_and_not_exact() -> None:
    """Neither the odometry nor localization knows them."""
    planar, others = [0, 1, 5], [2, 3, 4]
    estimate = np.array(localization().report["pose"]["covariance"])
    zeros = np.zeros((6, 6))
    zeros[np.ix_(planar, planar)] = estimate
    for pose in (
        vehicle(covariance=None),
        vehicle("localization", covariance=tuple(zeros.ravel().tolist())),
    ):
        found = sure_pose(pose, localization(), odometry=False)
        assert isinstance(found, VehiclePose)
        assert found.covariance is not None
        np.testing.assert_allclose(found.covariance[np.ix_(planar, planar)], estimate)
        assert (np.sqrt(np.diag(found.covariance)[others]) > 0.2).all()
        assert (np.linalg.eigvalsh(found.covariance) > 0).all()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"state": "ambiguous"}, "ambiguous"),
        ({"state": "lost"}, "lost"),
        ({"sure": False}, "not sure"),
        ({"sure": None}, "not sure"),
        ({"map_odom": None}, "no transform"),
        ({"map_odom": {"position_m": [1, 2], "orientation_wxyz": [1, 0, 0, 0]}}, "no transform"),
        ({"pose": None}, "no transform"),
        ({"state": "waiting for a map"}, "waiting for a map"),
    ],
)
def test_a_pose_that_is_not_sure_is_none(changes: dict[str, object], reason: str) -> None:
    for odometry in (False, True):
        found = sure_pose(vehicle(), localization(**changes), odometry=odometry)
        assert isinstance(found, str)
        assert reason in found


def test_odometry_is_a_pose_only_where_it_is_wanted_and_nothing_localizes() -> None:
    assert isinstance(sure_pose(vehicle(), None, odometry=True), VehiclePose)
    off = LocalizationMessage(report={"mode": "off", "state": "off"})
    assert isinstance(sure_pose(vehicle(), off, odometry=True), VehiclePose)
    for source, localized, odometry in (
        ("odometry", None, False),
        ("fixed", None, True),
        ("localization", None, True),  # its sureness is not known yet
    ):
        assert isinstance(sure_pose(vehicle(source), localized, odometry=odometry), str)


@pytest.mark.parametrize("source", ["odometry", "localization"])
def test_the_tree_of_frames_leads_to_the_vehicle(source: str) -> None:
    frames = MapFrames.of(vehicle(source), localization())
    same(frames.map_of_odom, SHIFT_M, CORRECTION)
    same(frames.base_of_sonar, np.array([0.5, 0.0, -0.25]), MOUNTING)
    assert frames.served_in_odom == (source == "odometry")
    place, turn = np.array([10.0, 20.0, -5.0]), TURN
    if source == "localization":
        place, turn = CORRECTION.inv().apply(place - SHIFT_M), CORRECTION.inv() * TURN
    same(frames.odom_of_base, place, turn)


@pytest.mark.parametrize("report", [None, localization(), localization(map_odom=None)])
def test_the_odometry_of_a_pose_gives_the_tree_without_a_report(
    report: LocalizationMessage | None,
) -> None:
    place, turn = np.array([4.0, -3.0, -5.0]), Rotation.from_euler("ZYX", (-0.4, 0.2, -0.3))
    x, y, z = place.tolist()
    pose = vehicle("localization", odom_position_m=(x, y, z), odom_orientation_xyzw=xyzw(turn))
    frames = MapFrames.of(pose, report)
    same(frames.odom_of_base, place, turn)
    same(frames.base_of_sonar, np.array([0.5, 0.0, -0.25]), MOUNTING)
    correction = TURN * turn.inv()
    same(frames.map_of_odom, np.array([10.0, 20.0, -5.0]) - correction.apply(place), correction)
    assert not frames.served_in_odom


def test_without_localization_odometry_is_the_map() -> None:
    frames = MapFrames.of(vehicle(), None)
    same(frames.map_of_odom, np.zeros(3), Rotation.identity())
    same(frames.odom_of_base, np.array([10.0, 20.0, -5.0]), TURN)
    assert not frames.served_in_odom


def test_a_transform_is_held_while_states_come() -> None:
    newest = localization(map_odom=None)
    state, first = HeldLocalization(), localization()
    assert not state.is_stale(0.0)
    for now_s, new in ((1.0, first), (2.0, newest)):
        state.take(new, now_s)
    assert state.message is first
    assert not state.is_stale(2.0 + REPORT_VALID_S)
    late_s = 2.1 + REPORT_VALID_S
    assert state.is_stale(late_s)
    state.take(newest, late_s)
    assert state.message is newest
    assert not state.is_stale(late_s)


INFO = MapInfo("one", 0.25, 0.25, 0.6, -0.6)


def random_mirror(seed: int, detail: str = "log_odds") -> MapMirror:
    random = np.random.default_rng(seed)
    mirror = MapMirror(INFO, Interest(detail=detail))  # type: ignore[arg-type]
    keys = np.unique(random.integers(-3, 3, (25, 3)), axis=0).astype(np.int32)
    limit = 2 if detail == "classes" else 12
    cells = random.integers(1 - limit, limit, (len(keys), CELLS)).astype(np.int8)
    cells[random.random(cells.shape) < 0.9] = UNKNOWN_CELL
    mirror.put(BlockSet(keys, np.zeros(len(keys), np.uint32), cells), 5)
    return mirror


@pytest.mark.parametrize("detail", ["log_odds", "classes"])
@pytest.mark.parametrize("heights", [(-1.0, 0.3), (0.125, 0.125), (-9.0, 9.0)])
def test_a_slice_is_that_of_all_cells_one_by_one(detail: str, heights: tuple[float, float]) -> None:
    mirror = random_mirror(3, detail)
    expected: dict[tuple[int, int], int] = {}
    by_class = ((mirror.cells("free"), FREE), (mirror.cells("occupied"), OCCUPIED))
    for cells, value in by_class:
        for x, y, z in cells.centres_m.tolist():
            if heights[0] <= z <= heights[1]:
                expected[(int(np.floor(x / 0.25)), int(np.floor(y / 0.25)))] = value
    layer = map_slice(mirror, *heights)
    assert layer is not None
    y, x = np.nonzero(layer.values != UNKNOWN)
    found = {
        (int(i) + layer.window.x, int(j) + layer.window.y): int(layer.values[j, i])
        for i, j in zip(x, y, strict=True)
    }
    assert found == expected
    assert len(found) > 3


def test_a_slice_around_a_place_has_all_cells_within_the_radius() -> None:
    mirror, centre = random_mirror(4), np.array([1.3, -2.2])
    whole, near = map_slice(mirror, -9, 9), map_slice(mirror, -9, 9, centre, 2.5)
    assert whole is not None
    assert near is not None
    y, x = np.nonzero(whole.values == OCCUPIED)
    for i, j in zip(x + whole.window.x, y + whole.window.y, strict=True):
        if np.hypot(*((np.array([i, j]) + 0.5) * 0.25 - centre)) < 2.5:
            assert near.values[j - near.window.y, i - near.window.x] == OCCUPIED
    assert near.values.size < whole.values.size


def test_a_slice_of_nothing_is_none() -> None:
    assert map_slice(MapMirror(INFO, Interest()), -1, 1) is None
    assert map_slice(random_mirror(1), 500, 501) is None


def test_a_slice_that_is_too_large_is_refused() -> None:
    mirror = MapMirror(INFO, Interest())
    cells = np.full((2, CELLS), 9, np.int8)
    keys = np.array([[0, 0, 0], [100_000, 100_000, 0]], np.int32)
    mirror.put(BlockSet(keys, np.zeros(2, np.uint32), cells), 5)
    with pytest.raises(ExportError, match="too large"):
        map_slice(mirror, 0, 1)


@pytest.mark.parametrize("rate_hz", [0.5, 3.0, 7.0, 50.0])
def test_a_rate_is_kept_and_reached(rate_hz: float) -> None:
    limit = RateLimit(rate_hz)
    offered = np.arange(0, 100, 0.1)
    passed = [now_s for now_s in offered.tolist() if limit.due(now_s)]
    assert len(passed) == pytest.approx(100 * min(rate_hz, 10.0), abs=1)


def test_a_rate_is_not_exceeded_after_a_pause() -> None:
    limit = RateLimit(2.0)
    assert limit.due(0.0)
    passed = [now_s for now_s in np.arange(50, 60, 0.01).tolist() if limit.due(now_s)]
    assert min(np.diff(passed)) >= 0.49
    assert not RateLimit(0.0).due(1.0)


def test_each_state_of_the_daemon_is_one_line() -> None:
    lines: list[str] = []
    reporter = LinkReporter(lines.append)
    for _ in range(5):
        for state in ("connecting", "waiting"):
            status = ConnectionStatus(state, "/run/a", "no such file", 0.0)
            assert not reporter.take(status)
    assert reporter.take(ConnectionStatus("connected", "/run/a", "", 0.0))
    assert reporter.take(ConnectionStatus("connected", "/run/a", "", 0.0))
    assert not reporter.take(ConnectionStatus("waiting", "/run/a", "gone", 0.0))
    assert len(lines) == 3
    assert [line.split()[2] for line in lines] == ["waiting", "connected", "waiting"]
