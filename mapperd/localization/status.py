"""The state of localization, for people and other programs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import AmclConfig
from mapperd.geometry.frames import Pose
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.known_map import KnownMap
from mapperd.localization.odom_correction import MapFromOdom
from mapperd.localization.particle_filter import Cluster, ParticleFilter

__all__ = [
    "MAX_SAMPLE",
    "Deviation",
    "Diagnosis",
    "LocalizationSnapshot",
    "diagnose",
    "model_warning",
    "sample_of",
]

WEIGHT_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Deviation:
    """A standard deviation and its warning level."""

    name: Literal["std_x", "std_y", "std_yaw"]
    value: float
    warn_level: float

    @property
    def is_too_large(self) -> bool:
        """Whether it exceeds the level; NaN counts as exceeding."""
        return not self.value <= self.warn_level


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """How certain the estimate is.

    Attributes:
        level: OK or WARN; OK before the first estimate.
        deviations: in metres and radians; empty before the first estimate.
        text: one line for people.
    """

    level: Literal["OK", "WARN"]
    deviations: tuple[Deviation, ...]
    text: str


def diagnose(estimate: PlanarGaussian | None, amcl: AmclConfig) -> Diagnosis:
    """Compare an estimate's standard deviations with `amcl.std_warn_level_*`."""
    if estimate is None:
        return Diagnosis("OK", (), "no estimate yet")
    x, y, yaw = (math.sqrt(max(float(estimate.covariance[k, k]), 0.0)) for k in range(3))
    deviations = (
        Deviation("std_x", x, amcl.std_warn_level_x),
        Deviation("std_y", y, amcl.std_warn_level_y),
        Deviation("std_yaw", yaw, amcl.std_warn_level_yaw),
    )
    large = [one for one in deviations if one.is_too_large]
    if not large:
        return Diagnosis("OK", deviations, "the estimate is within its levels")
    text = ", ".join(f"{one.name} {one.value:.3g} above {one.warn_level:g}" for one in large)
    return Diagnosis("WARN", deviations, text)


SLICE_ONLY = (
    "amcl: laser_model_type beam compares the 3D map's slice at the vehicle's height; "
    "likelihood_field_prob compares all of it"
)


def model_warning(amcl: AmclConfig, *, in_3d: bool) -> str | None:
    """Describe limits of the observation model under these settings; None if there are none.

    Weights are used as set, even if they do not sum to 1. Rays are cast on a planar map.

    Args:
        amcl: the settings.
        in_3d: the known map is 3D, not planar.
    """
    found = [_weight_warning(amcl)]
    if in_3d and amcl.laser_model_type == "beam":
        found.append(SLICE_ONLY)
    return "; ".join(text for text in found if text) or None


def _weight_warning(amcl: AmclConfig) -> str | None:
    names = ["laser_z_hit", "laser_z_rand"]
    if amcl.laser_model_type == "beam":
        names.append("laser_z_short")
    total = sum(getattr(amcl, name) for name in names)
    if abs(total - 1) <= WEIGHT_TOLERANCE:
        return None
    return f"amcl: {' + '.join(names)} is {total:g}, not 1"


Floats = NDArray[np.float64]

MAX_SAMPLE = 500
"""Maximum number of particles in a report."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalizationSnapshot:
    """State of localization between two pings; immutable.

    Attributes:
        state: `waiting for a map`, `waiting for a pose` or `localizing`.
        counts: scans by outcome, and refused requests by reason.
        updates: number of updates in this session.
        stamp_ns: time of the scan of the belief; None without a belief.
        belief: result of the last update; None before the first one after a new start.
        clusters: clusters of the particles, the heaviest first.
        transform: the odometry's frame in the map to publish, stamped ahead; None while it is not
            published.
        odom: pose of the base in the odometry's frame at the newest scan.
        pose: pose of the base in the map at the newest scan; None without a transform.
        odom_ns: time of both; None before the first ping.
        sure: the belief is good enough for mapping.
        diagnosis: standard deviations of the estimate against their warning levels.
        warning: about the settings, for people.
        particle_count: number of particles.
        particles: (N, 4), N up to `MAX_SAMPLE`: x, y in metres and yaw in radians, map frame, and
            the weight; the weights of a sample sum to 1.
        scan_points_m: (M, 3), map frame, scan of the last update; None without a belief.
        known: the map in use.
    """

    state: str
    counts: Mapping[str, int]
    updates: int
    stamp_ns: int | None
    belief: Belief | None
    clusters: tuple[Cluster, ...]
    transform: MapFromOdom | None
    odom: Pose | None
    pose: Pose | None
    odom_ns: int | None
    sure: bool
    diagnosis: Diagnosis
    warning: str | None
    particle_count: int
    particles: Floats
    scan_points_m: Floats | None
    known: KnownMap | None


def sample_of(particles: ParticleFilter, max_particles: int = MAX_SAMPLE) -> Floats:
    """Return all particles (N, 4), or a sample of at most `MAX_SAMPLE`.

    A larger cloud is resampled by weight in even steps, without random numbers, so that equal
    clouds give equal samples.
    """
    poses, weights = particles.poses, particles.weights
    if len(poses) > max_particles:
        reached = np.cumsum(weights)
        steps = (np.arange(max_particles) + 0.5) / max_particles * reached[-1]
        chosen = np.minimum(np.searchsorted(reached, steps), len(poses) - 1)
        poses, weights = poses[chosen], np.full(max_particles, 1 / max_particles)
    sample: Floats = np.column_stack([poses, weights])
    sample.setflags(write=False)
    return sample
