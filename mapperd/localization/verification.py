"""Verification of a pose: no distant pose explains the recent scans about as well.

Some places look alike: piles repeat, and a round tank looks the same at every heading. Neither the
fit nor the spread of a cloud then shows that its place is wrong. A separate search over the whole
map lists the poses that explain a window of recent scans. Odometry places the scans relative to
each other, so a pose stands for a track.

- A pose is verified if the search finds it again and every distant pose explains the window worse
  by a decisive log-likelihood ratio.
- A pose is refuted if a distant pose explains the window, or its last scans, better by such a
  ratio.

Without landmarks in the window, or on a symmetric part of the map, neither holds.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.gaussian import ELSEWHERE_M, wrapped
from mapperd.localization.hypothesis import SAME_RAD
from mapperd.localization.particle_filter import ParticleFilter
from mapperd.localization.scan import Scan
from mapperd.localization.update_gate import PlanarPose
from mapperd.localization.weighting import MapWeighing

__all__ = ["MIN_RETURNS", "MIN_SCANS", "Keyframe", "ScanWindow", "VerificationResult", "verify"]

Floats = NDArray[np.float64]

MAX_SCANS = 24
"""Maximum number of scans in a window; older ones suffer from odometry drift."""

MIN_SCANS = 5
"""Minimum number of scans in a window that verifies a pose."""

RECENT = 6
"""Number of latest scans that can refute a pose: after a carry-off, older scans mislead."""

MIN_RETURNS = 4
"""Minimum number of returns of a scan in a window."""

MAX_TURN_RAD = 0.2
"""Maximum turn between scans of a window."""

DECISIVE = 6.0
"""Log-likelihood ratio of tempered scans by which distant poses must be worse."""

REFUTING = 4.0
"""Ratio by which a distant pose must be better to refute."""

DOUBTING = 1.5
"""Ratio by which a distant pose must be better if the last scans suddenly fit worse."""

CLOUD_POSES = 250
"""Number of particles of a cloud that are scored along with the searched poses."""


class Keyframe(NamedTuple):
    """A scan of a window.

    Attributes:
        odom: pose of the base in the odometry's frame.
        base_height_m: height of the base in the map.
        scan: the returns.
    """

    odom: PlanarPose
    base_height_m: float
    scan: Scan


class ScanWindow(NamedTuple):
    """Recent scans, spaced along the track.

    Attributes:
        keyframes: the scans, oldest first.
        last: odometry at the last update; None before the first.
    """

    keyframes: tuple[Keyframe, ...] = ()
    last: PlanarPose | None = None

    def after(self, before: PlanarPose, keyframe: Keyframe, spacing_m: float) -> "ScanWindow":
        """Return the window with a scan added, if it is far enough from the last one.

        Args:
            before: odometry where the motion of the update began. Scans from before a jump of the
                odometry are dropped.
            keyframe: the scan.
            spacing_m: minimum distance between scans.
        """
        kept = self.keyframes if self.last in (None, before) else ()
        if len(keyframe.scan) >= MIN_RETURNS and (
            not kept or _is_apart(kept[-1].odom, keyframe.odom, spacing_m)
        ):
            kept = (*kept, _without_misses(keyframe))[-MAX_SCANS:]
        return ScanWindow(kept, keyframe.odom)

    def recent(self) -> "ScanWindow":
        """Return a window of the last scans only."""
        return ScanWindow(self.keyframes[-RECENT:], self.last)

    def including(self, keyframe: Keyframe) -> "ScanWindow":
        """Return the window with the current scan added, at any distance."""
        if self.keyframes and self.keyframes[-1].odom == keyframe.odom:
            return self
        return ScanWindow((*self.keyframes, keyframe), keyframe.odom)


class VerificationResult(NamedTuple):
    """Result of a verification: log-likelihood ratios of tempered scans.

    Attributes:
        margin: of the pose against the best distant one.
        recent_margin: the same, from the last scans.
        cloud_margin: of the particles against the best distant pose, from the last scan.
        found: the search found the pose and nothing better.
        scans: number of scans in the window.
    """

    margin: float
    recent_margin: float
    cloud_margin: float
    found: bool
    scans: int

    @property
    def verified(self) -> bool:
        """Whether the search found the pose and every distant one is decisively worse."""
        return self.found and self.scans >= MIN_SCANS and self.margin > DECISIVE

    @property
    def refuted(self) -> bool:
        """Whether a distant pose is decisively better."""
        return min(self.margin, self.recent_margin, self.cloud_margin) < -REFUTING

    @property
    def doubted(self) -> bool:
        """Whether a distant pose explains the last scan better."""
        return self.cloud_margin < -DOUBTING


class _Round(NamedTuple):
    """A round of the search: candidates are scored, resampled by score, and jittered."""

    scans: int
    beams: int
    elevations: int
    kept: int
    jitter_m: float
    jitter_rad: float
    broad: bool = False


ROUNDS = (
    _Round(8, 20, 3, 3000, 1.5, 0.06, broad=True),
    _Round(MAX_SCANS, 20, 5, 1500, 0.8, 0.03),
    _Round(MAX_SCANS, 20, 9, 800, 0.5, 0.015),
    _Round(MAX_SCANS, 60, 15, 0, 0.0, 0.0),
)
"""Rounds of the search; the last one only scores. Jitter in standard deviations of a hit."""

EFFECTIVE_SHARE = 0.25
"""Minimum effective share of candidates after a round, so that weak modes survive."""

BISECTIONS = 20


@dataclass(frozen=True, slots=True, eq=False)
class _KeyframeWindow:
    """A window on a map, with the odometry of the candidates."""

    weighing: MapWeighing
    keyframes: tuple[Keyframe, ...]
    now: PlanarPose

    def scores(self, poses: Floats, how: _Round) -> Floats:
        """Return (scans, poses) log-likelihoods of scans at the candidates' past poses."""
        step = max(1, math.ceil(len(self.keyframes) / how.scans))
        scores = [
            self.weighing.log_likelihoods(
                _moved(poses, self.now, one.odom),
                one.scan,
                one.base_height_m,
                beams=how.beams,
                elevations=how.elevations,
                broad=how.broad,
            )
            for one in self.keyframes[::-1][::step]
        ]
        return np.array(scores[::-1])

    def refined(self, poses: Floats, how: _Round, random: np.random.Generator) -> Floats:
        """Return candidates resampled by likelihood, tempered so that weak modes survive."""
        logs = self.scores(poses, how).sum(axis=0)
        logs = _tempered(logs - logs.max(), EFFECTIVE_SHARE * len(poses))
        drawn = _drawn(poses, np.exp(logs), how.kept, random)
        jitter_m = how.jitter_m * self.weighing.sigma_m
        noise: Floats = random.normal(size=drawn.shape) * (jitter_m, jitter_m, how.jitter_rad)
        return drawn + noise


def verify(
    weighing: MapWeighing,
    window: ScanWindow,
    place: Floats,
    clouds: list[ParticleFilter],
    seed: tuple[int, int],
) -> VerificationResult | None:
    """Search the map for poses that explain a window, and compare them with one.

    Args:
        weighing: the map, prepared for searches with a product model.
        window: recent scans, the last one current.
        place: (3,) x, y, yaw in the map, metres and radians: the pose to be verified.
        clouds: the cloud of the pose first; the others are candidates.
        seed: seed of the random numbers.

    Returns:
        The result; None without a scan to search with.
    """
    full = max(reversed(window.keyframes), key=lambda one: len(one.scan), default=None)
    if full is None or window.last is None or not weighing.can_search(full.scan):
        return None
    random = np.random.default_rng(seed)
    evidence = _KeyframeWindow(weighing, window.keyframes, window.last)
    poses = weighing.drawn(full.scan, full.base_height_m, int(random.integers(2**62)))
    poses = _moved(poses, full.odom, window.last)
    for one in ROUNDS[:-1]:
        poses = evidence.refined(poses, one, random)
    searched = len(poses)
    samples = [_drawn(cloud.poses, cloud.weights, CLOUD_POSES, random) for cloud in clouds]
    poses = np.concatenate([poses, *samples])
    scores = evidence.scores(poses, ROUNDS[-1])
    total, last = scores.sum(axis=0), scores[-1]
    near = about = _are_near(poses, place)
    if near.any():  # the estimate may lie as far from the best pose as distant poses do
        near = _are_near(poses, poses[np.argmax(np.where(about, total, -math.inf))])
    return VerificationResult(
        _margin(total[near], total[~near]),
        _margin(scores[-RECENT:, near].sum(axis=0), scores[-RECENT:, ~near].sum(axis=0)),
        _margin(last[searched : searched + CLOUD_POSES], last[~near]),
        bool(about[:searched][np.argmax(total[:searched])]),
        len(window.keyframes),
    )


def _are_near(poses: Floats, place: Floats) -> NDArray[np.bool_]:
    """Return (N,) whether poses are near a place."""
    off = poses - place
    near: NDArray[np.bool_] = np.hypot(off[:, 0], off[:, 1]) < ELSEWHERE_M
    return near & (np.abs(np.remainder(off[:, 2] + math.pi, math.tau) - math.pi) < SAME_RAD)


def _margin(inside: Floats, outside: Floats) -> float:
    """Return the best score near the place minus the best elsewhere; 0 without either."""
    best, other = (float(one.max(initial=-math.inf)) for one in (inside, outside))
    return best - other if math.isfinite(best) or math.isfinite(other) else 0.0


def _tempered(logs: Floats, size: float) -> Floats:
    """Return log-weights tempered to at least this effective sample size."""
    low, high, power = 0.0, 1.0, 1.0
    for _ in range(BISECTIONS):
        weights = np.exp(power * logs)
        if weights.sum() ** 2 / (weights**2).sum() < size:
            high = power
        else:
            low = power
        power = (low + high) / 2
    tempered: Floats = low * logs
    return tempered


def _drawn(poses: Floats, weights: Floats, count: int, random: np.random.Generator) -> Floats:
    """Return poses resampled evenly by weight."""
    edges = np.cumsum(weights)
    comb = (random.uniform() + np.arange(count)) / count * edges[-1]
    drawn: Floats = poses[np.minimum(np.searchsorted(edges, comb), len(edges) - 1)]
    return drawn


def _moved(poses: Floats, before: PlanarPose, after: PlanarPose) -> Floats:
    """Return poses (N, 3) after the odometry's motion between two poses."""
    x, y = after.x_m - before.x_m, after.y_m - before.y_m
    c, s = math.cos(before.yaw_rad), math.sin(before.yaw_rad)
    ahead, aside = c * x + s * y, c * y - s * x
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.column_stack(
        [
            poses[:, 0] + cos * ahead - sin * aside,
            poses[:, 1] + sin * ahead + cos * aside,
            poses[:, 2] + wrapped(after.yaw_rad - before.yaw_rad),
        ]
    )


def _without_misses(keyframe: Keyframe) -> Keyframe:
    """Return the scan without the beams that have no return."""
    return keyframe._replace(scan=replace(keyframe.scan, misses_bearing_rad=np.empty(0)))


def _is_apart(one: PlanarPose, other: PlanarPose, spacing_m: float) -> bool:
    turned = abs(wrapped(other.yaw_rad - one.yaw_rad))
    return other.step_m(one) >= spacing_m or turned >= MAX_TURN_RAD
