from collections.abc import Callable

import pytest

from mapperd.config.tree import Config, TimeSyncConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses, ping_time_ns
from oculus_driver.ping import Ping

MS = 1_000_000
T0 = 1_700_000_000_000_000_000

MakePing = Callable[..., Ping]
OdometryBytes = Callable[..., bytes]
Settled = list[tuple[Ping, Pose | Reject]]


def at_ms(ping: MakePing, t_ms: float, ping_id: int = 1) -> Ping:
    """A ping whose sound met the middle of the image at t_ms: 5 m of range, 1500 m/s."""
    return ping(ping_id, T0 + round((t_ms + 5.0) * MS))


def test_ping_time_is_when_sound_met_the_middle_of_the_image(ping: MakePing) -> None:
    assert ping_time_ns(at_ms(ping, 100)) == T0 + 100 * MS
    assert ping_time_ns(ping(arrival_ns=None)) is None


def test_ping_waits_for_the_record_that_encloses_it(
    ping: MakePing, odometry_bytes: OdometryBytes
) -> None:
    poses = OdometryPoses(Config())
    poses.add_odometry("odometry", odometry_bytes(p=(0.0, 0.0, 0.0)), T0)
    poses.add_ping(at_ms(ping, 25))
    assert list(poses.resolved(T0 + 30 * MS)) == []
    poses.add_odometry("odometry", odometry_bytes(p=(1.0, 0.0, 0.0)), T0 + 100 * MS)
    ((_, pose),) = poses.resolved(T0 + 100 * MS)
    assert isinstance(pose, FusedPose)
    assert pose.pose.position_m[0] == 0.25


def test_pings_keep_their_order(ping: MakePing, odometry_bytes: OdometryBytes) -> None:
    poses = OdometryPoses(Config())
    for k in range(3):
        poses.add_ping(at_ms(ping, 10 * k, k + 1))
    for t_ms in (0, 50):
        poses.add_odometry("odometry", odometry_bytes(), T0 + t_ms * MS)
    assert [each.ping_id for each, _ in poses.resolved(T0)] == [1, 2, 3]


def test_patience_ends_when_no_record_can_come_any_more(
    ping: MakePing, odometry_bytes: OdometryBytes
) -> None:
    poses = OdometryPoses(Config(time_sync=TimeSyncConfig(max_gap_sec=0.2)))
    poses.add_odometry("odometry", odometry_bytes(), T0 - 1000 * MS)
    poses.add_ping(at_ms(ping, 0))
    assert list(poses.resolved(T0 + 700 * MS)) == []
    ((_, reject),) = poses.resolved(T0 + 701 * MS)
    assert isinstance(reject, Reject)
    assert reject.reason == "after_odometry"


def test_end_of_the_recording_settles_everything(
    ping: MakePing, odometry_bytes: OdometryBytes
) -> None:
    poses = OdometryPoses(Config())
    poses.add_odometry("odometry", odometry_bytes(), T0)
    poses.add_ping(at_ms(ping, 50, 1))
    poses.add_ping(at_ms(ping, 500, 2))
    (_, near), (_, far) = poses.resolved(None, final=True)
    assert isinstance(near, FusedPose)
    assert isinstance(far, Reject)


def test_ping_without_a_stamp_has_no_pose(ping: MakePing, odometry_bytes: OdometryBytes) -> None:
    poses = OdometryPoses(Config())
    poses.add_odometry("odometry", odometry_bytes(), T0)
    poses.add_ping(ping(arrival_ns=None))
    ((_, reject),) = poses.resolved(None)
    assert isinstance(reject, Reject)
    assert reject.reason == "no_arrival_time"


def test_waiting_is_bounded_in_bytes(
    ping: MakePing, odometry_bytes: OdometryBytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.pipeline.pose_lookup.MAX_WAITING_BYTES", 3 * 50 * 65)
    poses = OdometryPoses(Config())
    poses.add_odometry("odometry", odometry_bytes(), T0)
    settled = []
    for k in range(10):
        poses.add_ping(at_ms(ping, 10 + k, k))
        settled += [each.ping_id for each, _ in poses.resolved(T0)]
    assert settled == [0, 1, 2, 3, 4, 5, 6]


def test_nobody_waits_behind_a_ping_with_a_stray_stamp(
    ping: MakePing, odometry_bytes: OdometryBytes
) -> None:
    poses = OdometryPoses(Config())
    poses.add_odometry("odometry", odometry_bytes(), T0)
    poses.add_ping(at_ms(ping, 1e12, 1))
    assert list(poses.resolved(T0 + round(1e12 + 5) * MS)) == []
    poses.add_ping(at_ms(ping, 50, 2))
    poses.add_odometry("odometry", odometry_bytes(), T0 + 100 * MS)
    (_, stray), (_, pose) = poses.resolved(T0 + 100 * MS)
    assert isinstance(stray, Reject)
    assert isinstance(pose, FusedPose)


def test_fixed_pose_is_everywhere_the_same_and_counts_odometry(ping: MakePing) -> None:
    fixed = pose_from_rpy((1, 2, 3), (0, 0, 0))
    poses = FixedPose(fixed)
    poses.add_odometry("any", b"anything", None)
    poses.add_ping(ping(1, None))
    poses.add_ping(ping(2, 5))
    for _, pose in poses.resolved(None):
        assert isinstance(pose, FusedPose)
        assert pose.pose is fixed
    assert list(poses.resolved(None, final=True)) == []
    assert poses.ignored == 1
