"""Images of known content: floors, ropes, stripes, and what a simulated sonar makes of them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim import MATERIALS, FramePose, Scene, Simulator, SonarSettings, Surface, load_scenario
from sonar_sim.geometry.pose import rotation_of

ROWS, BEAMS = 600, 512

Image = NDArray[np.float32]


def fan(field_of_view_deg: float, beams: int = BEAMS) -> NDArray[np.float64]:
    """Bearings uniform in sine."""
    edge = math.sin(math.radians(field_of_view_deg / 2))
    return np.asarray(np.arcsin(np.linspace(-edge, edge, beams)))


def flat_floor(bearings_rad: NDArray[np.float64], row: float, level: float = 160) -> Image:
    """A plane that faces the sonar, seen over an aperture of 20 degrees, on faint noise."""
    middle = np.arange(ROWS)[:, None] + 0.5
    near = row / np.cos(bearings_rad)
    lit = (middle >= near) & (middle <= near / math.cos(math.radians(10)) + 3)
    return np.where(lit, level, 4).astype(np.float32)


def speckled(mean: Image, seed: int = 1) -> Image:
    """Amplitudes of fully developed speckle of that mean, as an 8 bit sonar clips them."""
    generator = np.random.default_rng(seed)
    unit = generator.rayleigh(math.sqrt(2 / math.pi), mean.shape)
    return np.minimum(mean * unit, 255).astype(np.float32)


def striped(image: Image, row: int, thickness: int, level: float, seed: int = 2) -> Image:
    """The same with a stripe of that mean amplitude, of random phase to what is there."""
    generator = np.random.default_rng(seed)
    stripe = level * generator.rayleigh(math.sqrt(2 / math.pi), (thickness, image.shape[1]))
    out = image.copy()
    out[row : row + thickness] = np.minimum(np.hypot(out[row : row + thickness], stripe), 255)
    return out


@pytest.fixture(scope="session")
def simulated() -> Callable[[str, float], Image]:
    """A simulated M750d above sand or in the harbour, at a pitch in degrees."""
    half = 60.0
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    sand = np.column_stack([corners, np.full(4, -6.0)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    scenes: dict[str, Any] = {
        "floor": Scene((Surface("floor", sand, faces, MATERIALS["sand"]),)),
        "harbour": load_scenario("harbour").scene,
    }
    # A noisy receiver: what is dark is not silent.
    sonar = SonarSettings(noise_excess_db=40.0)
    simulators = {name: Simulator(scene, sonar, 1) for name, scene in scenes.items()}

    def image(scene: str, pitch_deg: float) -> Image:
        rotation = rotation_of(0.0, math.radians(pitch_deg), 0.0)
        pose = FramePose(np.array([0.0, 0.0, -1.5]), rotation)
        return simulators[scene].ping(pose, 1).image.astype(np.float32)

    return image
