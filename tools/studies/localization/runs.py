"""Dives localized: following a known start, finding oneself, and being carried off."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import AmclConfig, Config, LocalizationConfig
from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.localizer import Localizer
from mapperd.localization.map_filter import MapFilter
from mapperd.localization.maps import VolumeMap
from mapperd.localization.scan import Scan
from studies.localization.scans import cast_scan
from studies.localization.world import (
    DiveArea,
    DiveTrack,
    DiveWorld,
    OdometryDrift,
    drifted,
    track_of,
)

__all__ = ["FilterUpdate", "LocalizationDive", "dive", "settings"]

Floats = NDArray[np.float64]
ScanMaker = Callable[[int, Floats, int], Scan]


PARTICLES = 10_000
"""At a start, for a start anywhere in 1800 square metres; a cloud that has converged has 500."""


@dataclass(frozen=True, slots=True, eq=False)
class FilterUpdate:
    """One update.

    Attributes:
        time_s, way_m: since the beginning.
        true: (3,) x, y, yaw.
        belief: of the filter.
        reckoned_m: how far odometry alone, begun at the truth, is off by then.
        particles: (N, 3), at some updates; None at the others.
    """

    time_s: float
    way_m: float
    true: Floats
    belief: Belief
    reckoned_m: float
    particles: Floats | None = None

    @property
    def error_m(self) -> float:
        """Of the best mode's place."""
        return math.hypot(self.belief.best.x_m - self.true[0], self.belief.best.y_m - self.true[1])

    @property
    def turn_error_rad(self) -> float:
        """Of its heading, without a sign."""
        return abs(math.remainder(self.belief.best.yaw_rad - self.true[2], math.tau))


@dataclass(frozen=True, slots=True)
class LocalizationDive:
    """What is dived.

    Attributes:
        start: `known` within half a metre and 6 degrees, or `anywhere`.
        duration_s: of the dive.
        seed: of path, odometry, scans and particles.
        carried_off_s: when the vehicle is put elsewhere, unknown to its odometry; None never.
        drift: of the odometry.
        interval_s: between scans.
    """

    start: str = "known"
    duration_s: float = 1800.0
    seed: int = 1
    carried_off_s: float | None = None
    drift: OdometryDrift = field(default_factory=OdometryDrift)
    interval_s: float = 0.4


def settings(place: DiveArea, seed: int) -> Config:
    """A sonar's; docs/guides/localization.md gives the reason."""
    amcl = AmclConfig(
        robot_model_type="omnidirectional_drive",
        odom_alpha1=0.002,
        odom_alpha2=0.0001,
        odom_alpha3=0.002,
        odom_alpha4=0.001,
        odom_alpha5=0.002,
        laser_model_type="likelihood_field_prob",
        laser_max_range=place.range_m,
        laser_min_range=0.5,
        laser_z_hit=0.7,
        laser_z_rand=0.3,
        laser_sigma_hit=2 * place.voxel_m,
        laser_likelihood_max_dist=20 * place.voxel_m,
        max_particles=PARTICLES,
        recovery_alpha_slow=0.0,
        recovery_alpha_fast=0.0,
        resample_interval=1,
        selective_resampling=True,
        min_particles=500,
        pf_z=2.326,
        update_min_d=place.step_m,
        update_min_a=math.radians(10.0),
    )
    ours = LocalizationConfig(
        mode="global",
        random_seed=seed,
        tempering=0.1,
        update_max_interval=1.0,
        sigma_floor_xy=0.03 * place.speed_mps / 0.5,
        sigma_floor_yaw=0.002,
        elevations=15,
        search_poses=300_000,
        search_sigma=5 * place.voxel_m,
        tempering_spread=0.2,
        least_effective_share=0.3,
        draw_exponent=0.5,
        alternative_interval=66 * place.step_m,
    )
    return Config(amcl=amcl, localization=ours)


def dive(
    world: DiveWorld,
    known: VolumeMap,
    what: LocalizationDive,
    config: Config,
    *,
    scans: ScanMaker | None = None,
    keep_particles_s: tuple[float, ...] = (),
) -> Iterator[FilterUpdate]:
    """Dive, and yield the estimate of the filter after each update.

    Args:
        world: where.
        known: the map.
        what: how.
        config: the settings.
        scans: makes the scan of a number, place (6,) and stamp; None casts it.
        keep_particles_s: times after which the next moment has its particles.
    """
    track = _track(world.place, what)
    odometry = drifted(track, world.place, what.drift, what.seed)
    reckoned_m = _reckoned_m(track, odometry)
    random = np.random.default_rng((what.seed, 3))
    particles = MapFilter(config)
    localizer = Localizer(particles, config)
    localizer.take_map(known)
    if what.start == "known":
        localizer.take_pose(_near(track.place[0], random), config.amcl.global_frame_id)
    waiting = list(keep_particles_s)
    for k, place in enumerate(track.place):
        stamp_ns = round(track.time_s[k] * 1e9)
        scan = scans(k, place, stamp_ns) if scans else cast_scan(world, place, stamp_ns, random)
        odom = pose_from_rpy(
            (*odometry[k, :2], place[2]),
            (math.degrees(place[3]), math.degrees(place[4]), math.degrees(odometry[k, 2])),
        )
        found = localizer.take_scan(scan, odom)
        if found.belief is None:
            continue
        cloud = None
        if waiting and track.time_s[k] >= waiting[0]:
            waiting.pop(0)
            cloud = particles.particles.poses
        yield FilterUpdate(
            float(track.time_s[k]),
            float(track.way_m[k]),
            place[[0, 1, 5]],
            found.belief,
            float(reckoned_m[k]),
            cloud,
        )


def _track(place: DiveArea, what: LocalizationDive) -> DiveTrack:
    first = track_of(place, what.duration_s, what.interval_s, what.seed)
    if what.carried_off_s is None:
        return first
    other = track_of(place, what.duration_s, what.interval_s, what.seed + 100_000)
    after = first.time_s >= what.carried_off_s
    rows = min(len(first.place), len(other.place))
    places = np.where(after[:rows, None], other.place[:rows], first.place[:rows])
    return DiveTrack(first.time_s[:rows], places, int(np.argmax(after)))


def _near(place: Floats, random: np.random.Generator) -> PlanarGaussian:
    sigma = np.array([0.5, 0.5, math.radians(6.0)])
    mean = place[[0, 1, 5]] + sigma * random.normal(size=3)
    return PlanarGaussian(float(mean[0]), float(mean[1]), float(mean[2]), np.diag(sigma**2))


def _reckoned_m(track: DiveTrack, odometry: Floats) -> Floats:
    """(N,) how far odometry is off that was put on the true beginning."""
    turn = track.place[0, 5] - odometry[0, 2]
    c, s = math.cos(turn), math.sin(turn)
    moved = (odometry[:, :2] - odometry[0, :2]) @ np.array([[c, s], [-s, c]])
    error: Floats = np.hypot(*(moved + track.place[0, :2] - track.place[:, :2]).T)
    return error
