from collections.abc import Callable

import msgspec
import pytest

from mapperd.config import TimeSync
from mapperd.frames import Pose
from mapperd.odometry.source import OdometrySource
from mapperd.reject import Reject

S = 1_000_000_000
MS = 1_000_000
OdometryBytes = Callable[..., bytes]


@pytest.fixture
def source() -> OdometrySource:
    return OdometrySource(TimeSync())


def x_at(source: OdometrySource, t_ns: int) -> float:
    pose = source.at(t_ns)
    assert isinstance(pose, Pose), pose
    return float(pose.position_m[0])


def test_everything_that_comes_in_is_counted(
    source: OdometrySource, odometry_bytes: OdometryBytes
) -> None:
    good = odometry_bytes()
    zero = odometry_bytes(q=(0.0, 0.0, 0.0, 0.0))
    nan = odometry_bytes(p=(float("nan"), 0.0, 0.0))
    for data, arrival in ((good, 1), (good, 2), (good, 1), (zero, 3), (nan, 4), (b"?", 5)):
        source.feed(data, arrival * S)
    assert source.received == 6
    assert source.accepted == 2
    assert source.rejects == {
        "back_in_time": 1,
        "zero_quaternion": 1,
        "not_finite": 1,
        "wrong_shape": 1,
    }
    assert source.received == source.accepted + source.rejects.total()


def test_unix_stamps_are_taken_as_they_are(
    source: OdometrySource, odometry_bytes: OdometryBytes
) -> None:
    for k in range(3):
        stamp = k * 100 * MS + S
        data = odometry_bytes(clk="unix", t=stamp, p=(float(k), 0.0, 0.0))
        assert source.feed(data, stamp + 30 * MS) is None
    assert x_at(source, S + 50 * MS) == pytest.approx(0.5)


def test_boot_stamps_are_carried_over_to_the_host(
    source: OdometrySource, odometry_bytes: OdometryBytes
) -> None:
    for k, delay_ms in enumerate((2, 40, 2, 80, 2)):
        data = odometry_bytes(clk="boot", t=k * 100 * MS, p=(float(k), 0.0, 0.0))
        assert source.feed(data, 7 * S + (k * 100 + delay_ms) * MS) is None
    assert x_at(source, 7 * S + 152 * MS) == pytest.approx(1.5)


def test_one_wrong_clock_does_not_hide_all_that_follows(
    source: OdometrySource, odometry_bytes: OdometryBytes
) -> None:
    assert source.feed(odometry_bytes(clk="unix", t=S), S) is None
    reject = source.feed(odometry_bytes(clk="unix", t=10**18), S + 1)
    assert reject is not None
    assert reject.reason == "clock_off"
    assert source.feed(odometry_bytes(clk="unix", t=S + 2), S + 2) is None


def test_stale_record_is_rejected(source: OdometrySource, odometry_bytes: OdometryBytes) -> None:
    reject = source.feed(odometry_bytes(clk="unix", t=S), 2 * S)
    assert reject is not None
    assert reject.reason == "clock_off"


@pytest.mark.parametrize(("clock", "taken"), [("unix", True), ("boot", False), ("arrival", False)])
def test_without_arrival_only_absolute_time_helps(
    source: OdometrySource, odometry_bytes: OdometryBytes, clock: str, *, taken: bool
) -> None:
    reject = source.feed(odometry_bytes(clk=clock, t=S), None)
    assert (reject is None) == taken
    if reject is not None:
        assert reject.reason == "no_arrival_time"


def test_first_source_heard_owns_the_pose(
    source: OdometrySource, odometry_bytes: OdometryBytes
) -> None:
    assert source.feed(odometry_bytes(src="dvl"), S) is None
    reject = source.feed(odometry_bytes(src="ekf"), S + 1)
    assert isinstance(reject, Reject)
    assert reject.reason == "other_source"
    assert source.feed(odometry_bytes(src="dvl"), S + 2) is None


def test_resets_are_counted(source: OdometrySource, odometry_bytes: OdometryBytes) -> None:
    for k, reset in enumerate((4, 4, 5, 5, 7)):
        source.feed(odometry_bytes(rst=reset), k * S)
    assert source.resets == 2


def test_limits_come_from_the_settings(odometry_bytes: OdometryBytes) -> None:
    settings = msgspec.structs.replace(TimeSync(), max_stamp_diff_sec=0.0, max_gap_sec=0.15)
    source = OdometrySource(settings)
    for t_ms in (0, 100, 300):
        source.feed(odometry_bytes(), t_ms * MS + S)
    assert isinstance(source.at(S + 50 * MS), Pose)
    for t_ms in (200, 301):
        assert isinstance(source.at(S + t_ms * MS), Reject)
