"""The particle filter's public face: the core's parts under plain names, and what it believes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd._core import MclBeamModel as BeamModel
from mapperd._core import MclBeams as Beams
from mapperd._core import MclEndpoints as Endpoints
from mapperd._core import MclEstimate as Estimate
from mapperd._core import MclField as LikelihoodField
from mapperd._core import MclFilter as ParticleFilter
from mapperd._core import MclFreeSpace as FreeSpace
from mapperd._core import MclGrid as Grid
from mapperd._core import MclHitModel as HitModel
from mapperd._core import MclRangeMap as RangeMap
from mapperd._core import MclRule as FilterRule
from mapperd._core import MclWeighed as Weighed

__all__ = [
    "BeamModel",
    "Beams",
    "Belief",
    "Endpoints",
    "Estimate",
    "FilterRule",
    "FreeSpace",
    "Grid",
    "HitModel",
    "LikelihoodField",
    "ParticleFilter",
    "RangeMap",
    "Weighed",
    "belief",
]


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Where the filter says the vehicle is.

    Attributes:
        best: of the heaviest cluster of at least two particles; of all where there is none.
        overall: of all particles. A mean between two modes is where nobody is: see `masses`.
        masses: (clusters,) weight of each cluster, falling; their sum is 1.
        effective_size: how many equal particles would tell as much.
    """

    best: Estimate
    overall: Estimate
    masses: NDArray[np.float64]
    effective_size: float

    @property
    def clusters(self) -> int:
        """How many clusters there are, single particles among them."""
        return len(self.masses)


def belief(
    particles: ParticleFilter, *, bucket_xy_m: float = 0.2, bucket_yaw_rad: float = 0.524
) -> Belief:
    """What the particles say together; the buckets are those that clusters are made of."""
    best, masses, _ = particles.modes(bucket_xy_m, bucket_yaw_rad)
    return Belief(best, particles.estimate(), masses, particles.effective_size())
