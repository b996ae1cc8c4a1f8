"""The particle filter's public face: the core's parts under plain names, and its belief."""

import math

import numpy as np

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
from mapperd.geometry.gaussian import ELSEWHERE_M, Belief, PlanarGaussian

__all__ = [
    "BeamModel",
    "Beams",
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
    "gaussian_of",
]


def belief(
    particles: ParticleFilter,
    *,
    fits: bool = True,
    bucket_xy_m: float = 0.2,
    bucket_yaw_rad: float = 0.524,
) -> Belief:
    """What the particles say together; the buckets are those that clusters are made of."""
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
    )


def gaussian_of(estimate: Estimate) -> PlanarGaussian:
    """An estimate of the core, as a Gaussian.

    Headings that cancel have no variance that a number holds: then any heading will do.
    """
    covariance = estimate.covariance
    if not np.isfinite(covariance).all():
        covariance[2, :] = covariance[:, 2] = 0.0
    covariance[2, 2] = min(covariance[2, 2] if estimate.heading_known else np.inf, math.pi**2)
    x_m, y_m, yaw_rad = estimate.mean
    return PlanarGaussian(x_m, y_m, yaw_rad, covariance)
