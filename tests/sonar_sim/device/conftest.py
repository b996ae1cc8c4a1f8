"""A small scene with a sonar that looks down on a floor."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sonar_sim.geometry.pose import Mounting
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import sonar_preset
from sonar_sim.scene.vehicle import OdometryErrors, Vehicle

FLOOR_M = -4.0

MakeScenario = Callable[..., Scenario]


@pytest.fixture
def floor_scenario() -> MakeScenario:
    """A vehicle that drives 2 m ahead and 2 m above a floor; keywords change the sonar."""

    def make(model: str = "M750d", mode: int = 1, **changes: Any) -> Scenario:
        x, y = np.meshgrid(np.linspace(-8.0, 8.0, 17), np.linspace(-8.0, 8.0, 17), indexing="ij")
        points = np.stack([x, y, np.full_like(x, FLOOR_M)], axis=-1).reshape(-1, 3)
        index = np.arange(17 * 17).reshape(17, 17)
        a, b, c, d = (
            part.ravel()
            for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
        )
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        floor = Surface("floor", points, faces.astype(np.int64), MATERIALS["sand"])
        sonar = sonar_preset(model, mode, **({"demanded_range_m": 3.0, "beams": 256} | changes))
        path = [Waypoint(-1.0, 0.0, -1.5, 0.0), Waypoint(1.0, 0.0, -1.5, 0.0)]
        return Scenario(
            name="floor",
            scene=Scene((floor,)),
            sonar=sonar,
            mounting=Mounting(),
            trajectory=Trajectory(path, Motion(speed_mps=0.2)),
            vehicle=Vehicle(errors=OdometryErrors(), odometry_rate_hz=50.0),
            ping_rate_hz=10.0,
        )

    return make


@pytest.fixture
def with_errors() -> Callable[..., Scenario]:
    """The scenario whose vehicle's odometry has other errors."""

    def make(scenario: Scenario, **errors: Any) -> Scenario:
        vehicle = replace(scenario.vehicle, errors=OdometryErrors(**errors))
        return replace(scenario, vehicle=vehicle)

    return make
