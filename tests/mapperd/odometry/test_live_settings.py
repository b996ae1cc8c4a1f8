"""Settings of the odometry that change while it comes."""

import functools
import math
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.catalog import parameters
from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.odometry.fusion import Fusion
from mapperd.odometry.records import Odometry
from mapperd.pipeline.pose_lookup import ODOMETRY_FOLLOWS, OdometryPoses
from tests.mapperd.odometry.conftest import T0, Circle, S, record

BASE = {
    "slam_quality": {"fail_mode": "closed"},
    "odometry": {
        "sources": [{"name": "ekf"}, {"name": "dvl", "link": "udp://127.0.0.1:52201"}],
        "owners": {"velocity": "dvl"},
    },
}

OTHER = {
    "time_sync.policy": "nearest",
    "time_sync.max_gap_sec": 0.3,
    "time_sync.max_stamp_diff_sec": 0.02,
    "time_sync.max_odom_age_sec": 0.2,
    "slam_quality.threshold": 0.8,
    "slam_quality.fail_mode": "open",
    "slam_quality.grace_period_sec": 0.2,
    "slam_quality.stale_timeout_sec": 0.5,
    "odometry.limits.max_speed": 0.9,
    "odometry.limits.max_turn_rate": 10.0,
    "odometry.limits.max_jump": 3.0,
    "odometry.limits.max_jump_angle": 100.0,
    "odometry.dead_reckoning.max_sec": 0.3,
    "odometry.dead_reckoning.noise": 1.0,
    "odometry.at_jump": "follow",
    "odometry.position_std": 0.3,
    "odometry.attitude_std": 3.0,
}


def with_value(name: str, value: Any) -> Config:
    tree = msgspec.to_builtins(config_of(BASE, ""))
    *sections, leaf = name.split(".")
    functools.reduce(dict.__getitem__, sections, tree)[leaf] = value
    return config_of(tree, "")


def rough_drive(circle: Circle) -> Iterator[tuple[str, Odometry, int]]:
    """Six seconds with a gap, a late record, a jump, and an end of the positions."""
    for k in range(60):
        t_s = k / 10
        arrival_ns = T0 + round(t_s * S)
        yield "dvl", record(velocity_mps=np.array([circle.speed_mps, 0.0, 0.0])), arrival_ns
        if 10 < k < 15:
            continue
        jumped = k >= 25
        turn = np.array([math.cos(0.9), 0.0, 0.0, math.sin(0.9)]) if k >= 30 else None
        stated: dict[str, Any] = {
            "map_q_base": circle.quaternion(t_s) if turn is None else turn,
            "rate_radps": np.array([0.0, 0.0, circle.rate_radps if turn is None else 0.0]),
            "confidence": 0.5 if 15 < k < 20 or k > 40 else None,
        }
        if k < 40 or k > 50:
            stated["position_m"] = circle.position_m(t_s) + np.array([2.0 * jumped, 0.0, 0.0])
        late_ns = round(0.3 * S) if k == 8 else 0
        yield "ekf", Odometry(stamp_ns=arrival_ns - late_ns, clock="unix", **stated), arrival_ns


def outcomes(fusion: Fusion, records: list[tuple[str, Odometry, int]]) -> list[Any]:
    """What is known of moments just before each record, and what became of the record."""
    found: list[Any] = []
    for source, odometry, arrival_ns in records:
        taken = fusion.take(source, odometry, arrival_ns)
        found.append(None if taken is None else taken.reason)
        for back_s in (0.03, 0.25):
            fused = fusion.at(arrival_ns - round(back_s * S))
            if isinstance(fused, Reject):
                found.append(fused.reason)
            else:
                pose, covariance = fused.pose, fused.covariance
                numbers = [*pose.position_m, *pose.map_q_base, *covariance.ravel()]
                found.append((fused.segment, fused.reckoned_s, [float(one) for one in numbers]))
    return found


def fusion_of(config: Config) -> Fusion:
    return OdometryPoses(config).odometry.fusion


def test_every_live_setting_of_the_odometry_is_tried() -> None:
    live = [
        name
        for name, one in parameters().items()
        if one.dynamic and name.startswith(("odometry.", "time_sync.", "slam_quality."))
    ]
    assert sorted(OTHER) == sorted(live)
    assert all(name.startswith(ODOMETRY_FOLLOWS) for name in live)


@pytest.mark.parametrize("name", OTHER)
def test_setting_taken_later_is_as_good_as_one_from_the_start(name: str, circle: Circle) -> None:
    drive = list(rough_drive(circle))
    before, after = config_of(BASE, ""), with_value(name, OTHER[name])
    poses = OdometryPoses(before)
    poses.reconfigure(after)
    taken = outcomes(poses.odometry.fusion, drive)
    assert taken == outcomes(fusion_of(after), drive)
    assert taken != outcomes(fusion_of(before), drive)


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHER)
def test_setting_changes_on_the_way_and_back(name: str, circle: Circle) -> None:
    """Between two changes that undo each other before any record, nothing is other."""
    drive = list(rough_drive(circle))
    before, after = config_of(BASE, ""), with_value(name, OTHER[name])
    poses = OdometryPoses(before)
    half = len(drive) // 2
    first = outcomes(poses.odometry.fusion, drive[:half])
    poses.reconfigure(after)
    poses.reconfigure(before)
    rest = outcomes(poses.odometry.fusion, drive[half:])
    assert first + rest == outcomes(fusion_of(before), drive)


def test_timeout_follows() -> None:
    poses = OdometryPoses(config_of(BASE, ""))
    poses.reconfigure(with_value("time_sync.max_gap_sec", 5.0))
    assert poses._timeout_ns == 5_500_000_000


def test_a_sender_that_is_known_already_is_judged_again(circle: Circle) -> None:
    name, late_ns = "time_sync.max_odom_age_sec", round(0.3 * S)
    poses = OdometryPoses(config_of(BASE, ""))

    def taken(at_ns: int, late_ns: int) -> Reject | None:
        record = Odometry(stamp_ns=at_ns - late_ns, clock="unix", **circle.pose(0.0))
        return poses.odometry.fusion.take("ekf", record, at_ns)

    assert taken(T0, 0) is None
    assert taken(T0 + S, late_ns) is None
    poses.reconfigure(with_value(name, OTHER[name]))
    reject = taken(T0 + 2 * S, late_ns)
    assert reject is not None
    assert reject.reason == "clock_off"
