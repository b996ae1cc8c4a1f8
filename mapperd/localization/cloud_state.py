"""A cloud of particles as a checkpoint holds it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.localization.particle_filter import ParticleFilter

__all__ = ["CloudState", "cloud_state", "restore_cloud"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CloudState:
    """All that the core's filter holds, but for its rule.

    Attributes:
        poses: (N, 3), of the particles.
        log_weights: (N,).
        numbers, averages: of the core's filter, its seed among them.
    """

    poses: Floats
    log_weights: Floats
    numbers: tuple[int, ...]
    averages: tuple[float, float, bool]


def cloud_state(particles: ParticleFilter) -> CloudState:
    """The state of a cloud."""
    return CloudState(*particles.state())


def restore_cloud(particles: ParticleFilter, state: CloudState) -> None:
    """Make a cloud of the same rule go on as the one that the state is of.

    Raises:
        ValueError: it is no cloud's state; nothing is changed.
    """
    particles.restore(state.poses, state.log_weights, state.numbers, state.averages)
