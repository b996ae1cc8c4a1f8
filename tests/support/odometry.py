"""Checks of what odometry decoders return."""

import dataclasses
from collections.abc import Iterable

import numpy as np
import pytest

from mapperd.errors import Reject
from mapperd.odometry.records import Odometry

NUMBERS = (
    "position_m",
    "map_q_base",
    "velocity_mps",
    "rate_radps",
    "velocity_map_mps",
    "velocity_east_north_mps",
    "depth_m",
    "heading_rad",
    "altitude_m",
    "confidence",
    "specific_force_mps2",
)


def assert_sound(results: Iterable[Odometry | Reject]) -> None:
    """Check that each result is a reject with a reason, or a record of finite numbers."""
    for result in results:
        if isinstance(result, Reject):
            assert result.reason
            continue
        for name in NUMBERS:
            value = getattr(result, name)
            assert value is None or np.isfinite(value).all(), (name, value)
        if result.map_q_base is not None:
            assert np.linalg.norm(result.map_q_base) == pytest.approx(1.0)
        if result.geo is not None:
            assert all(np.isfinite(v) for v in dataclasses.astuple(result.geo) if v is not None)
