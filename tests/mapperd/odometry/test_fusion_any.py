"""Any records of three sources in any order give a valid pose or a reason."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd.config.odometry import DeadReckoningConfig, OdometryFusionConfig, TimeSyncConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import rotation_from_rpy
from mapperd.odometry.fusion import FusedPose, Fusion
from mapperd.odometry.records import GeoPoint, Odometry
from tests.mapperd.odometry.conftest import T0

MS = 1_000_000
numbers = st.floats(-50, 50)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
fields: st.SearchStrategy[dict[str, Any]] = st.fixed_dictionaries(
    {},
    optional={
        "position_m": vectors,
        "map_q_base": st.tuples(numbers, numbers, numbers).map(lambda rpy: rotation_from_rpy(*rpy)),
        "velocity_mps": vectors.map(lambda v: v / 20),
        "velocity_map_mps": vectors.map(lambda v: v / 20),
        "rate_radps": vectors.map(lambda v: v / 40),
        "depth_m": st.floats(-1, 100),
        "heading_rad": st.floats(-3, 3),
        "geo": st.builds(GeoPoint, st.floats(1.0, 1.00001), st.just(0.1), st.none()),
        "confidence": st.floats(0, 1),
        "reset_count": st.integers(0, 2),
        "north_referenced": st.booleans(),
        "valid": st.booleans(),
    },
)
stated = st.tuples(
    st.sampled_from(["a", "b", "c"]),
    fields,
    st.sampled_from([0, 1, 20, 20, 20, 100, 100, 700, 5000, -10, -3000]),
)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["interpolate", "nearest", "latest"])
@pytest.mark.parametrize("at_jump", ["continue", "follow"])
@settings(max_examples=60, deadline=None, derandomize=True)
@given(story=st.lists(stated, max_size=40))
def test_any_story(policy: Any, at_jump: Any, story: list[tuple[str, dict[str, Any], int]]) -> None:
    fusion = Fusion(
        OdometryFusionConfig(at_jump=at_jump, dead_reckoning=DeadReckoningConfig(max_sec=2.0)),
        TimeSyncConfig(policy=policy),
    )
    t_ns = T0
    for source, reported, step_ms in story:
        t_ns += step_ms * MS
        record = Odometry(stamp_ns=0, clock="arrival", **reported)
        taken = fusion.take(source, record, t_ns)
        assert taken is None or isinstance(taken, Reject)
        for asked_ns in (t_ns, t_ns - 30 * MS, t_ns + 50 * MS):
            fusion.ready(asked_ns)
            pose = fusion.at(asked_ns)
            if isinstance(pose, FusedPose):
                whole(pose)
    received = sum(fusion.received.values())
    rejected = sum(reasons.total() for reasons in fusion.rejects.values())
    assert received == len(story) >= rejected
    fusion.status()


def whole(pose: FusedPose) -> None:
    for numbers_of in (pose.pose.position_m, pose.pose.map_q_base, pose.covariance):
        assert np.isfinite(numbers_of).all()
    assert np.linalg.norm(pose.pose.map_q_base) == pytest.approx(1.0)
    assert np.linalg.eigvalsh(pose.covariance).min() >= 0
    for motion in (pose.velocity_mps, pose.rate_radps):
        assert motion is None or np.isfinite(motion).all()
    assert pose.segment >= 0
