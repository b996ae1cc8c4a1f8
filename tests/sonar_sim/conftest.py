"""Simple shapes to look at."""

from collections.abc import Callable

import numpy as np
import pytest
from sonar_sim.geometry.pose import FramePose
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Scene, Surface

Plate = Callable[..., Scene]


@pytest.fixture
def plate() -> Plate:
    """A rectangle about a centre, spanned by two edge vectors, in `cuts` x `cuts` pieces."""

    def build(
        centre: tuple[float, float, float],
        edge_u: tuple[float, float, float],
        edge_v: tuple[float, float, float],
        cuts: int = 1,
    ) -> Scene:
        steps = np.linspace(-0.5, 0.5, cuts + 1)
        grid_u, grid_v = np.meshgrid(steps, steps, indexing="ij")
        points = (
            np.array(centre)
            + grid_u.reshape(-1, 1) * np.array(edge_u)
            + grid_v.reshape(-1, 1) * np.array(edge_v)
        )
        index = np.arange((cuts + 1) ** 2).reshape(cuts + 1, cuts + 1)
        a, b, c, d = (
            part.ravel()
            for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
        )
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        return Scene((Surface("plate", points, faces.astype(np.int64), MATERIALS["sand"]),))

    return build


@pytest.fixture
def level_pose() -> FramePose:
    """At the origin, looking along +x."""
    return FramePose(np.zeros(3), np.eye(3))
