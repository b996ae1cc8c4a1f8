"""Rays meet the scene's triangles, in whatever groups they move."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sonar_sim.geometry.trajectory import Drift
from sonar_sim.raycast.meshes import NOTHING, Meshes
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.validation.setups import DULL


def spikes(rng: np.random.Generator, name: str) -> Surface:
    """Two long, thin triangles in opposite directions, somewhere."""
    corners = np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0], [3.0, 0.0, 0.0]])
    vertices = Rotation.random(random_state=rng).apply(np.concatenate([corners, -corners]))
    drift = Drift(tuple(rng.uniform(-8.0, 8.0, 3)), yaw_deg=rng.uniform(-180.0, 180.0))
    return Surface(name, vertices, np.arange(6).reshape(2, 3), DULL, motion=drift)


@pytest.mark.parametrize("seed", range(6))
def test_a_short_reach_meets_what_a_long_one_meets_so_near(seed: int) -> None:
    """Groups out of reach are left out: no ray may miss what it reaches."""
    rng = np.random.default_rng(seed)
    surfaces = tuple(spikes(rng, f"spikes {number}") for number in range(4))
    meshes = Meshes(Scene(surfaces))
    corners = np.concatenate([surface.vertices_at_m(0.0) for surface in surfaces])
    # From beside the tips, towards a point of each triangle near its tip and anywhere else.
    aims = np.einsum("c,ncx->nx", [0.015, 0.005, 0.98], corners.reshape(-1, 3, 3))
    for tip, root in zip(corners[2::3], corners[0::3], strict=True):
        aside = np.cross(tip - root, rng.normal(size=3))
        origin = tip + 0.2 * (tip - root) / 3.0 + 0.1 * aside / np.linalg.norm(aside)
        rays = np.concatenate([aims - origin, rng.normal(size=(200, 3))])
        rays = (rays / np.linalg.norm(rays, axis=1)[:, None]).astype(np.float32)
        assert np.any(meshes.cast(origin, rays, 0.0, 1e4).range_m < 0.35)
        for origins in (origin, origin + rng.uniform(-0.005, 0.005, rays.shape)):
            everything = meshes.cast(origins, rays, 0.0, 1e4)
            for reach in (0.35, 2.0, 8.0):
                near = meshes.cast(origins, rays, 0.0, reach)
                expected = np.where(everything.range_m < reach, everything.face, NOTHING)
                assert np.array_equal(near.face, expected)
