"""A vehicle that drives a known circle, and its sensors' messages."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mapperd.odometry.fusion import FusedPose, Fusion
from mapperd.odometry.records import Odometry

S = 1_000_000_000
T0 = 1_700_000_000 * S


class Circle:
    """1 m/s around a circle of 5 m, turning to port; all of it in closed form."""

    radius_m = 5.0
    speed_mps = 1.0
    depth_m = 3.0

    @property
    def rate_radps(self) -> float:
        return self.speed_mps / self.radius_m

    def position_m(self, t_s: float) -> np.ndarray:
        angle = self.rate_radps * t_s
        return np.array(
            [
                self.radius_m * math.sin(angle),
                self.radius_m * (1 - math.cos(angle)),
                -self.depth_m,
            ]
        )

    def yaw_rad(self, t_s: float) -> float:
        return self.rate_radps * t_s

    def quaternion(self, t_s: float) -> np.ndarray:
        half = self.yaw_rad(t_s) / 2
        return np.array([math.cos(half), 0.0, 0.0, math.sin(half)])

    def pose(self, t_s: float) -> dict[str, Any]:
        return {"position_m": self.position_m(t_s), "map_q_base": self.quaternion(t_s)}

    def velocity_map_mps(self, t_s: float) -> np.ndarray:
        angle = self.yaw_rad(t_s)
        return np.array([math.cos(angle), math.sin(angle), 0.0])


MakeRecord = Callable[..., Odometry]


@pytest.fixture
def circle() -> Circle:
    return Circle()


def record(**fields: Any) -> Odometry:
    return Odometry(stamp_ns=0, clock="arrival", **fields)


def feed(
    fusion: Fusion,
    source: str,
    rate_hz: float,
    until_s: float,
    fields: Callable[[float], dict[str, Any]],
    *,
    start_s: float = 0.0,
) -> None:
    """Let a source send at a rate; each record arrives the moment it is valid."""
    for k in range(int((until_s - start_s) * rate_hz) + 1):
        t_s = start_s + k / rate_hz
        fusion.take(source, record(**fields(t_s)), T0 + round(t_s * S))


def fused_at(fusion: Fusion, t_s: float) -> FusedPose:
    fused = fusion.at(T0 + round(t_s * S))
    assert isinstance(fused, FusedPose), fused
    return fused


def yaw_of(fused: FusedPose) -> float:
    w, _, _, z = fused.pose.map_q_base
    return 2 * math.atan2(z, w)
