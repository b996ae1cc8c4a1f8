import numpy as np
import pytest

from mapperd.frames import Pose, rotation_from_rpy
from mapperd.odometry.buffer import PoseBuffer
from mapperd.odometry.records import Odometry
from mapperd.reject import Reject

MS = 1_000_000
GAP, REACH = 500 * MS, 100 * MS


def record(
    x_m: float, yaw_deg: float = 0.0, reset: int = 0, missing: str | None = None
) -> Odometry:
    fields: dict[str, object] = {
        "stamp_ns": 0,
        "clock": "arrival",
        "position_m": np.array([x_m, 0.0, 0.0]),
        "map_q_base": rotation_from_rpy(0, 0, yaw_deg),
        "velocity_mps": None,
        "rate_radps": None,
        "pose_covariance": None,
        "twist_covariance": None,
        "reset_count": reset,
        "source": "",
    }
    if missing is not None:
        fields[missing] = None
    return Odometry(**fields)  # type: ignore[arg-type]


def filled(*records: tuple[int, Odometry], bound: int = 100) -> PoseBuffer:
    buffer = PoseBuffer(GAP, REACH, bound)
    for t_ms, odometry in records:
        assert buffer.add(odometry, t_ms * MS) is None
    return buffer


def x_at(buffer: PoseBuffer, t_ms: float) -> float:
    pose = buffer.at(round(t_ms * MS))
    assert isinstance(pose, Pose), pose
    return float(pose.position_m[0])


def reason_at(buffer: PoseBuffer, t_ms: float) -> str:
    reject = buffer.at(round(t_ms * MS))
    assert isinstance(reject, Reject), reject
    return reject.reason


def test_position_is_linear_and_orientation_turns_the_shorter_way() -> None:
    buffer = filled((0, record(0, 170)), (200, record(2, -170)))
    pose = buffer.at(50 * MS)
    assert isinstance(pose, Pose)
    assert pose.position_m == pytest.approx([0.5, 0, 0])
    assert abs(float(pose.map_q_base @ rotation_from_rpy(0, 0, 175))) == pytest.approx(1)


def test_pose_at_a_record_is_that_record() -> None:
    buffer = filled((0, record(0)), (100, record(1)), (200, record(5)))
    assert [x_at(buffer, t) for t in (0, 100, 200)] == [0, 1, 5]


def test_the_right_pair_is_taken() -> None:
    buffer = filled(*[(100 * k, record(k * k)) for k in range(10)])
    assert x_at(buffer, 450) == pytest.approx((16 + 25) / 2)


def test_gap_up_to_the_limit_is_bridged_and_no_longer_one() -> None:
    assert x_at(filled((0, record(0)), (500, record(5))), 250) == pytest.approx(2.5)
    assert reason_at(filled((0, record(0)), (501, record(5))), 250) == "odometry_gap"


def test_motion_is_carried_on_within_reach_only() -> None:
    buffer = filled((0, record(0)), (100, record(1)))
    assert x_at(buffer, 150) == pytest.approx(1.5)
    assert x_at(buffer, 200) == pytest.approx(2.0)
    assert reason_at(buffer, 201) == "after_odometry"
    assert x_at(buffer, -50) == pytest.approx(-0.5)
    assert reason_at(buffer, -101) == "before_odometry"


def test_motion_is_not_carried_on_longer_than_it_was_seen() -> None:
    buffer = filled((0, record(0)), (10, record(1)))
    assert x_at(buffer, 20) == pytest.approx(2)
    assert x_at(buffer, 21) == 1  # held: two records close together say little about speed


def test_single_record_is_held_within_reach() -> None:
    buffer = filled((0, record(7)))
    assert x_at(buffer, 100) == 7
    assert reason_at(buffer, 101) == "after_odometry"


def test_edge_of_a_long_gap_uses_its_own_side() -> None:
    buffer = filled((0, record(0)), (100, record(1)), (5000, record(9)), (5100, record(8)))
    assert x_at(buffer, 150) == pytest.approx(1.5)
    assert x_at(buffer, 4950) == pytest.approx(9.5)
    assert reason_at(buffer, 2500) == "odometry_gap"


def test_reset_is_never_interpolated_across() -> None:
    buffer = filled((0, record(0)), (100, record(1)), (300, record(50, reset=1)))
    assert x_at(buffer, 150) == pytest.approx(1.5)
    assert x_at(buffer, 250) == 50
    assert reason_at(filled((0, record(0)), (400, record(9, reset=1))), 200) == "odometry_gap"


def test_records_that_go_back_or_stand_still_in_time_are_rejected() -> None:
    buffer = filled((100, record(1)))
    for t_ms in (100, 99, -5):
        reject = buffer.add(record(5), t_ms * MS)
        assert reject is not None
        assert reject.reason == "back_in_time"
    assert x_at(buffer, 100) == 1
    assert len(buffer) == 1


def test_record_without_position_or_orientation_is_no_pose() -> None:
    buffer = PoseBuffer(GAP, REACH)
    for missing in ("position_m", "map_q_base"):
        reject = buffer.add(record(0, missing=missing), 0)
        assert reject is not None
        assert reject.reason == "no_pose"


def test_empty_buffer_has_no_pose() -> None:
    buffer = PoseBuffer(GAP, REACH)
    assert reason_at(buffer, 0) == "no_odometry"
    assert buffer.newest_ns is None


def test_memory_is_bounded_and_the_oldest_go_first() -> None:
    buffer = filled(*[(100 * k, record(k)) for k in range(10)], bound=4)
    assert len(buffer) == 4
    assert reason_at(buffer, 450) == "before_odometry"
    assert x_at(buffer, 850) == pytest.approx(8.5)
