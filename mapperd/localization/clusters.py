"""The cloud's clusters, each with its own mean: what an ambiguous vehicle may be told."""

from dataclasses import dataclass

from mapperd._core import mcl_estimate
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.particle_filter import ParticleFilter, gaussian_of

__all__ = ["MOST_CLUSTERS", "Cluster", "clusters_of"]

MOST_CLUSTERS = 8
"""The heaviest; a cloud that is spread over a map falls into hundreds."""


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Particles that stand together.

    Attributes:
        mass: share of the weight.
        pose: their mean and covariance.
    """

    mass: float
    pose: PlanarGaussian


def clusters_of(particles: ParticleFilter, most: int = MOST_CLUSTERS) -> tuple[Cluster, ...]:
    """The heaviest clusters, falling; those without weight are left out."""
    _, masses, labels = particles.modes()
    poses, weights = particles.poses, particles.weights
    found = []
    for label, mass in enumerate(masses[:most].tolist()):
        inside = labels == label
        if mass > 0 and inside.any():
            found.append(Cluster(mass, gaussian_of(mcl_estimate(poses[inside], weights[inside]))))
    return tuple(found)
