"""The particle filter of the core: its cloud, its estimate, its clusters."""

import math
from dataclasses import dataclass
from typing import NamedTuple

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
from mapperd._core import MclRule as FilterParams
from mapperd._core import MclWeighed as Weighed
from mapperd._core import mcl_estimate
from mapperd.geometry.gaussian import ELSEWHERE_M, Belief, PlanarGaussian

__all__ = [
    "MAX_CLUSTERS",
    "BeamModel",
    "Beams",
    "CloudState",
    "Cluster",
    "Endpoints",
    "Estimate",
    "FilterParams",
    "FreeSpace",
    "Grid",
    "HitModel",
    "LikelihoodField",
    "ParticleFilter",
    "RangeMap",
    "Weighed",
    "belief",
    "cloud_state",
    "clusters_of",
    "gaussian_of",
    "restore_cloud",
]


def belief(
    particles: ParticleFilter,
    *,
    fits: bool = True,
    confirmed: bool = True,
    bucket_xy_m: float = 0.2,
    bucket_yaw_rad: float = 0.524,
) -> Belief:
    """Return the belief of a cloud; clusters are formed from buckets of the given size."""
    found, masses, _ = particles.modes(bucket_xy_m, bucket_yaw_rad)
    best = gaussian_of(found)
    offset = particles.poses[:, :2] - (best.x_m, best.y_m)
    sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(best.covariance[:2, :2])[-1]), 0.0))
    off = np.hypot(offset[:, 0], offset[:, 1]) > max(ELSEWHERE_M, 3.0 * sigma_m)
    return Belief(
        best,
        gaussian_of(particles.estimate()),
        masses,
        float(particles.weights[off].sum()),
        particles.effective_size(),
        fits,
        confirmed,
    )


def gaussian_of(estimate: Estimate) -> PlanarGaussian:
    """Return an estimate of the core as a Gaussian.

    If the headings cancel, their variance is unbounded: the heading is then reported as unknown,
    with a variance of pi^2.
    """
    covariance = estimate.covariance
    if not np.isfinite(covariance).all():
        covariance[2, :] = covariance[:, 2] = 0.0
    covariance[2, 2] = min(covariance[2, 2] if estimate.heading_known else np.inf, math.pi**2)
    x_m, y_m, yaw_rad = estimate.mean
    return PlanarGaussian(x_m, y_m, yaw_rad, covariance)


Floats = NDArray[np.float64]


class CloudState(NamedTuple):
    """State of the core's filter, without its rule.

    Attributes:
        poses: (N, 3) x, y, heading of the particles.
        log_weights: (N,) log-weights.
        numbers, averages: seed, counters and averages of the core's filter.
    """

    poses: Floats
    log_weights: Floats
    numbers: tuple[int, ...]
    averages: tuple[float, float, bool]


def cloud_state(particles: ParticleFilter) -> CloudState:
    """Return the state of a cloud."""
    return CloudState(*particles.state())


def restore_cloud(particles: ParticleFilter, state: CloudState) -> None:
    """Set the state of a cloud that has the same rule.

    Raises:
        ValueError: the state is invalid; the cloud is unchanged.
    """
    particles.restore(state.poses, state.log_weights, state.numbers, state.averages)


MAX_CLUSTERS = 8
"""Number of reported clusters; a cloud spread over a map has hundreds."""


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Particles close to each other.

    Attributes:
        mass: share of the total weight.
        pose: mean and covariance.
    """

    mass: float
    pose: PlanarGaussian


def clusters_of(particles: ParticleFilter, max_clusters: int = MAX_CLUSTERS) -> tuple[Cluster, ...]:
    """Return the heaviest clusters in descending order, without those of no weight."""
    _, masses, labels = particles.modes()
    poses, weights = particles.poses, particles.weights
    found = []
    for label, mass in enumerate(masses[:max_clusters].tolist()):
        inside = labels == label
        if mass > 0 and inside.any():
            found.append(Cluster(mass, gaussian_of(mcl_estimate(poses[inside], weights[inside]))))
    return tuple(found)
