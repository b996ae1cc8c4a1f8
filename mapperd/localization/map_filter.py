"""The core's particle filter on a map, by the settings."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.geometry.gaussian import Belief, PlanarGaussian, wrapped
from mapperd.localization.hypothesis import (
    AlternativeHypothesis,
    FitWatch,
    has_one_place,
    same_place,
    spread_m,
)
from mapperd.localization.maps import LocalizationMap
from mapperd.localization.models import filter_params
from mapperd.localization.particle_filter import (
    CloudState,
    ParticleFilter,
    Weighed,
    belief,
    cloud_state,
    restore_cloud,
)
from mapperd.localization.scan import Scan
from mapperd.localization.update_gate import PlanarPose
from mapperd.localization.verification import (
    MIN_RETURNS,
    MIN_SCANS,
    Keyframe,
    ScanWindow,
    VerificationResult,
    verify,
)
from mapperd.localization.weighting import MapWeighing, threads_of

__all__ = ["FilterState", "MapFilter"]

Floats = NDArray[np.float64]

SPREAD_M = 0.5
"""Standard deviation above which a cloud counts as spread out."""

HURRY_M = 1.0
"""Maximum distance between alternatives while scans do not fit the map."""

LOST_SHARE = 0.3
"""Part of `alternative_interval` after which the next one starts while the pose is unconfirmed."""

SPACING_SHARE, VERIFY_SHARE, WATCH_SHARE, DROP_SHARE = 0.06, 0.15, 0.5, 0.05
"""Parts of `alternative_interval`: between scans of a window; between verifications of an
unconfirmed pose, of a confirmed one, and after a drop of the fit."""

TURN_SHARE = 0.1
"""Part of `alternative_interval` that a turn of one radian counts as."""

DROP = 0.15
"""Drop of the share of hits that triggers a verification."""


class FilterState(NamedTuple):
    """State of a filter, without its map and settings.

    Attributes:
        cloud: the particles.
        stamp_ns: time of the last scan; None before the first.
        hit_share: share of returns on the map, mean of recent scans; None before the first.
        alternative: cloud, log-odds and distance travelled of the alternative hypothesis, if any.
        alternatives: number of alternatives tried so far.
        blind: the particles are spread over the map and no scan was searched yet.
        alone_m: distance travelled since the last alternative ended.
        recent_share, unsupported, scans: as in `FitWatch`.
        confirmed: as in `MapFilter`.
        independent: unused; states of earlier versions have it.
        window: recent scans.
        unverified_m: distance travelled since the last verification.
    """

    cloud: CloudState
    stamp_ns: int | None
    hit_share: float | None
    alternative: tuple[CloudState, float, float] | None
    alternatives: int
    blind: bool
    alone_m: float
    recent_share: float | None = None
    unsupported: int = 0
    scans: int = 0
    confirmed: bool = True
    independent: bool = True
    window: ScanWindow = ScanWindow()
    unverified_m: float = 0.0


class MapFilter:
    """A particle filter on a map; not thread-safe.

    Args:
        config: the settings.

    Attributes:
        weighed: result of weighing the last scan; None before the first.
        watch: how well scans fit the map.
        alternative: the cloud that is tried against `particles`; None most of the time.
        alternatives: number of alternatives tried so far.
        confirmed: the pose was given or verified, and not refuted since.
        verdict: result of the last verification; None before the first.
    """

    def __init__(self, config: Config) -> None:
        self.weighed: Weighed | None = None
        self.watch = FitWatch()
        self.alternative: AlternativeHypothesis | None = None
        self.alternatives = 0
        self.confirmed = True
        self.verdict: VerificationResult | None = None
        self._config = config
        self._particles = self._cloud()
        self._map: MapWeighing | None = None
        self._stamp_ns: int | None = None
        self._blind = False  # spread over the map, and no scan was searched yet
        self._alone_m = 0.0  # distance since the last alternative ended
        self._window = ScanWindow()
        self._unverified_m = 0.0  # distance since the last verification

    @property
    def particles(self) -> ParticleFilter:
        """The leading cloud, read-only; an alternative that wins replaces it."""
        return self._particles

    def reconfigure(self, config: Config) -> None:
        """As `PoseFilter.reconfigure`; an error leaves the filter unchanged."""
        rule = filter_params(config)
        weighing = None if self._map is None else self._map.with_settings(config)
        for particles in self._clouds():
            particles.set_rule(rule)
            particles.set_threads(threads_of(config))
        self._config, self._map = config, weighing
        if weighing is not None and not weighing.is_product:
            # This model counts no hits: drop what earlier ones showed.
            self.watch, self.alternative = FitWatch(), None

    def take_map(self, known: LocalizationMap) -> None:
        """As `PoseFilter.take_map`; an error leaves the filter unchanged."""
        self._map = MapWeighing(known, self._config)
        self.alternative, self._window = None, ScanWindow()

    def start_at(self, pose: PlanarGaussian, *, given: bool = True) -> None:
        """As `PoseFilter.start_at`."""
        self._particles.start_about(np.array([pose.x_m, pose.y_m, pose.yaw_rad]), pose.covariance)
        self._begin(blind=False)
        if given:
            self.confirmed = True

    def start_anywhere(self) -> None:
        """As `PoseFilter.start_anywhere`.

        Raises:
            ValueError: there is no map, or the map has no free cell.
        """
        if self._map is None or self._map.free is None:
            raise ValueError("there is no free cell to start from")
        self._particles.start_anywhere(self._map.free)
        self._begin(blind=True)

    def state(self) -> FilterState:
        """Return the state, without map and settings."""
        alternative = None
        if self.alternative is not None:
            tried = self.alternative
            alternative = cloud_state(tried.particles), tried.log_odds, tried.way_m
        return FilterState(
            cloud_state(self._particles),
            self._stamp_ns,
            self.watch.share,
            alternative,
            self.alternatives,
            self._blind,
            self._alone_m,
            self.watch.recent,
            self.watch.unsupported,
            self.watch.scans,
            self.confirmed,
            window=self._window,
            unverified_m=self._unverified_m,
        )

    def restore(self, state: FilterState) -> None:
        """Continue from the state of a filter with the same map and settings.

        Raises:
            ValueError: the state is invalid; the filter cannot be used afterwards.
        """
        restore_cloud(self._particles, state.cloud)
        self._stamp_ns, self.alternatives = state.stamp_ns, state.alternatives
        self.watch = FitWatch(state.hit_share, state.recent_share, state.unsupported, state.scans)
        self.confirmed = state.confirmed
        self._blind, self._alone_m, self.alternative = state.blind, state.alone_m, None
        if state.alternative is not None:
            cloud, log_odds, way_m = state.alternative
            self.alternative = AlternativeHypothesis(self._cloud(), log_odds, way_m)
            restore_cloud(self.alternative.particles, cloud)
        self._window, self._unverified_m = state.window, state.unverified_m

    def update(
        self, before: PlanarPose, now: PlanarPose, scan: Scan, base_height_m: float
    ) -> Belief:
        """As `PoseFilter.update`."""
        if self._map is None:
            raise ValueError("there is no map to weigh by")
        way_m = self._move(before, now, scan.stamp_ns)
        if self._blind and self._map.can_search(scan):
            if self._is_spread(self._particles):
                self._map.draw(self._particles, scan, base_height_m)
            self._blind = False
        self.weighed = self._weigh(self._map, self._particles, scan, base_height_m)
        if self._map.is_product:
            self.watch = self.watch.after(self._map.hit_share(self.weighed), len(scan))
        if self.alternative is not None:
            self._try(self._map, self.alternative.driven(way_m), scan, base_height_m)
        else:
            self._challenge(self._map, way_m, scan, base_height_m)
        if self._tries_alternatives():
            turned_rad = abs(wrapped(now.yaw_rad - before.yaw_rad))
            way_m += turned_rad * TURN_SHARE * self._config.localization.alternative_interval
            self._verify(self._map, before, Keyframe(now, base_height_m, scan), way_m)
        found = self._belief()
        for particles in self._clouds():
            particles.resample_if_due(self._map.free)
        self._decide()
        return found

    def _begin(self, *, blind: bool) -> None:
        self._stamp_ns, self._blind = None, blind
        self.watch, self.alternative, self._alone_m = FitWatch(), None, 0.0
        self._window, self._unverified_m, self.verdict = ScanWindow(), 0.0, None
        if blind:
            self.confirmed = False

    def _tries_alternatives(self) -> bool:
        """Whether alternatives are tried; without them no searched pose is ever confirmed."""
        return (
            self._config.localization.alternative_interval > 0.0
            and self._map is not None
            and self._map.is_product
            and self._map.searches
        )

    def _fits(self) -> bool:
        return self.watch.fits(self._config.localization.min_hit_share)

    def _cloud(self) -> ParticleFilter:
        """Return a new cloud; each alternative has its own random numbers."""
        seed = (self._config.localization.random_seed + self.alternatives) % 2**63
        return ParticleFilter(filter_params(self._config), seed, threads_of(self._config))

    def _clouds(self) -> list[ParticleFilter]:
        return [self._particles] + (
            [] if self.alternative is None else [self.alternative.particles]
        )

    def _move(self, before: PlanarPose, now: PlanarPose, stamp_ns: int) -> float:
        """Move all clouds; return the distance, 0 if a cloud refused the step."""
        amcl, ours = self._config.amcl, self._config.localization
        passed_s = 0.0 if self._stamp_ns is None else max(stamp_ns - self._stamp_ns, 0) / 1e9
        alphas = [getattr(amcl, f"odom_alpha{k}") for k in range(1, 6)]
        moved = True
        for particles in self._clouds():
            moved &= particles.predict(
                _array(before),
                _array(now),
                amcl.robot_model_type,
                np.array(alphas, dtype=np.float64),
                ours.sigma_floor_xy * math.sqrt(passed_s),
                ours.sigma_floor_yaw * math.sqrt(passed_s),
            )
        self._stamp_ns = stamp_ns
        return math.hypot(now.x_m - before.x_m, now.y_m - before.y_m) if moved else 0.0

    def _weigh(
        self, weighing: MapWeighing, particles: ParticleFilter, scan: Scan, height_m: float
    ) -> Weighed:
        ours = self._config.localization
        tempering = ours.tempering
        if ours.tempering_spread < 1.0 and self._is_spread(particles):
            tempering *= ours.tempering_spread
        return weighing.weigh(particles, scan, height_m, tempering)

    @staticmethod
    def _is_spread(particles: ParticleFilter) -> bool:
        """Whether the cloud is still spread out."""
        return spread_m(particles.estimate()) > SPREAD_M

    def _try(
        self, weighing: MapWeighing, alternative: AlternativeHypothesis, scan: Scan, height_m: float
    ) -> None:
        """Weigh the alternative and update its odds against the leading cloud."""
        ours = self._config.localization
        weighed, first = self._weigh(weighing, alternative.particles, scan, height_m), self.weighed
        votes = ours.tempering * ours.alternative_tempering * len(scan)
        self.alternative = alternative.weighed(weighed.fit, first.fit if first else 0.0, votes)

    def _challenge(self, weighing: MapWeighing, way_m: float, scan: Scan, height_m: float) -> None:
        """Start an alternative if one is due."""
        ours = self._config.localization
        self._alone_m += way_m
        due_m = ours.alternative_interval
        if not self._fits():
            due_m = min(HURRY_M, due_m)
        elif not self.confirmed:
            due_m *= LOST_SHARE
        wanted = self._tries_alternatives() and self._alone_m >= due_m
        if wanted and not self._blind and weighing.can_search(scan):
            self.alternatives += 1
            self.alternative = AlternativeHypothesis(self._cloud())
            weighing.draw(self.alternative.particles, scan, height_m)

    def _verify(
        self, weighing: MapWeighing, before: PlanarPose, keyframe: Keyframe, way_m: float
    ) -> None:
        """Compare the pose with distant ones if a verification is due."""
        ours, interval_m = self._config.localization, self._config.localization.alternative_interval
        self._window = self._window.after(before, keyframe, SPACING_SHARE * interval_m)
        self._unverified_m += way_m if len(keyframe.scan) >= MIN_RETURNS else 0.0
        if self.watch.denies(ours.min_hit_share):
            self._refute(self._window.recent())
        dropped = self.confirmed and self.watch.dropped(DROP)
        due = DROP_SHARE if dropped else WATCH_SHARE if self.confirmed else VERIFY_SHARE
        first = self._particles.estimate()
        enough = self.confirmed or (
            len(self._window.keyframes) >= MIN_SCANS and self.watch.supports(ours.min_hit_share)
        )
        is_due = self._unverified_m >= due * interval_m and enough
        if not (is_due and has_one_place(first)):
            return
        window = (ScanWindow() if dropped else self._window).including(keyframe)
        clouds, seed = self._clouds(), (ours.random_seed, keyframe.scan.stamp_ns % 2**63)
        verdict = verify(weighing, window, first.mean, clouds, seed)
        if verdict is None:
            return
        self.verdict, self._unverified_m = verdict, 0.0
        if verdict.refuted or (dropped and verdict.doubted):
            self._refute(window.recent())
        elif not dropped:
            self.confirmed |= verdict.verified

    def _refute(self, window: ScanWindow) -> None:
        """Withdraw the confirmation and start an alternative at once."""
        if self.confirmed:
            self.confirmed, self._window = False, window
        self._alone_m = self._config.localization.alternative_interval

    def _belief(self) -> Belief:
        fits = self.watch.supports(self._config.localization.min_hit_share)
        if self.alternative is None:
            return belief(self._particles, fits=fits, confirmed=self.confirmed)
        both = ParticleFilter(filter_params(self._config), 0)
        poses = [particles.poses for particles in self._clouds()]
        shares = (1.0 - self.alternative.share, self.alternative.share)
        weights = [s * p.weights for s, p in zip(shares, self._clouds(), strict=True)]
        both.start_with(np.concatenate(poses), np.concatenate(weights))
        return belief(both, fits=fits, confirmed=self.confirmed)

    def _decide(self) -> None:
        """Drop the alternative, let it lead, or keep it on trial."""
        if self.alternative is None:
            return
        alternative = self.alternative
        same = same_place(self._particles.estimate(), alternative.particles.estimate())
        if same or alternative.hopeless:
            self.alternative, self._alone_m = None, 0.0
        elif alternative.leads:
            self.alternative = alternative.changed(self._particles)
            self._particles = alternative.particles
            self.watch = FitWatch()
            self.confirmed = False


def _array(pose: PlanarPose) -> Floats:
    return np.array([pose.x_m, pose.y_m, pose.yaw_rad], dtype=np.float64)
