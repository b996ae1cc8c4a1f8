"""What localization says about itself, for whoever tells people and other programs."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.frames import Pose
from mapperd.geometry.gaussian import Belief
from mapperd.localization.clusters import Cluster
from mapperd.localization.diagnostics import Diagnosis
from mapperd.localization.known_map import KnownMap
from mapperd.localization.odom_correction import MapFromOdom
from mapperd.localization.particle_filter import ParticleFilter

__all__ = ["MAX_SAMPLE", "LocalizationFacts", "sample_of"]

Floats = NDArray[np.float64]

MAX_SAMPLE = 500
"""Particles that are told."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalizationFacts:
    """How it stands between two pings; nobody changes it afterwards.

    Attributes:
        state: `waiting for a map`, `waiting for a pose` or `localizing`.
        counts: scans by what became of them, and refused requests by their reasons.
        updates: of the filter by scans, in this session.
        stamp_ns: of the scan of the belief; None with it.
        belief: of the last update; None before the first after a new start.
        clusters: of its particles, the heaviest first.
        transform: the odometry's frame in the map as it is to be published, stamped ahead; None
            while it is not.
        odom: the base in the odometry's frame at the newest scan.
        pose: the base in the map at the newest scan; None without a transform.
        sure: the belief is good enough to map by.
        diagnosis: the estimate's standard deviations against their levels.
        warning: of the settings, for a person.
        particle_count: that there are.
        particles: (N, 4), N up to `MAX_SAMPLE`: x, y in metres and yaw in radians, map frame, and
            the weight; the weights of a sample sum to 1.
        scan_points_m: (M, 3), map frame, of the scan of the last update; None with the belief.
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
    sure: bool
    diagnosis: Diagnosis
    warning: str | None
    particle_count: int
    particles: Floats
    scan_points_m: Floats | None
    known: KnownMap | None


def sample_of(particles: ParticleFilter, most: int = MAX_SAMPLE) -> Floats:
    """Particles (N, 4) that stand for all: all, or as many by weight; no draw of the filter's.

    Of many, every particle stands in it as often as its weight says, in even steps through the sum
    of the weights, so that equal clouds give equal samples.
    """
    poses, weights = particles.poses, particles.weights
    if len(poses) > most:
        reached = np.cumsum(weights)
        steps = (np.arange(most) + 0.5) / most * reached[-1]
        chosen = np.minimum(np.searchsorted(reached, steps), len(poses) - 1)
        poses, weights = poses[chosen], np.full(most, 1 / most)
    sample: Floats = np.column_stack([poses, weights])
    sample.setflags(write=False)
    return sample
