"""Clouds as the engine takes them."""

import math

import numpy as np

from sonar_sim.effects.view import CloudInSight, View
from sonar_sim.physics import Cloud
from sonar_sim.scene import Bubbles, Sediment


def clouds_of(view: View, kind: type[Bubbles] | type[Sediment]) -> tuple[Cloud, ...]:
    """The scene's clouds of one kind."""
    return tuple(_cloud(cloud) for cloud in view.clouds_of(kind))


def _cloud(cloud: CloudInSight) -> Cloud:
    return Cloud(
        np.array(cloud.spec.low_m, dtype=np.float64),
        np.array(cloud.spec.high_m, dtype=np.float64),
        cloud.matter.db_per_m,
        10.0 * math.log10(max(cloud.matter.strength, 1e-30)),
    )
