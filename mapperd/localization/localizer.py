"""Localization: maps, poses, requests and scans on their way to the filter."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.geometry.frames import Pose
from mapperd.geometry.gaussian import Belief, GaussianState, PlanarGaussian
from mapperd.localization.levelling import yaw_of
from mapperd.localization.lifecycle import Lifecycle, Mode, Start
from mapperd.localization.maps import LocalizationMap
from mapperd.localization.odom_correction import MapFromOdom, map_from_odom
from mapperd.localization.scan import Scan, decimated
from mapperd.localization.update_gate import PlanarPose, UpdateGate

__all__ = ["Localized", "Localizer", "LocalizerState", "PoseFilter"]


class PoseFilter(Protocol):
    """Particles on a map."""

    def reconfigure(self, config: Config) -> None:
        """Take other settings; the particles are as they were."""

    def take_map(self, known: LocalizationMap) -> None:
        """Use another map from now on; the particles are as they were."""

    def start_at(self, pose: PlanarGaussian, *, given: bool = True) -> None:
        """Draw new particles around a pose; averages and counters restart.

        Args:
            pose: mean and covariance.
            given: it is certain; else as certain as the last estimate.
        """

    def start_anywhere(self) -> None:
        """Draw new particles on the map's free cells."""

    def update(
        self, before: PlanarPose, now: PlanarPose, scan: Scan, base_height_m: float
    ) -> Belief:
        """Move, weigh and, if it is due, resample the particles.

        Args:
            before: odometry at the last update.
            now: odometry at the scan.
            scan: what to weigh by; an empty one moves the particles only.
            base_height_m: of the base in the map, from the depth.

        Returns:
            Where the vehicle is.
        """


@dataclass(frozen=True, slots=True)
class Localized:
    """What became of a scan.

    Attributes:
        reason: as `UpdateDecision.reason`, or `no_filter`.
        belief: the filter's, if it took the scan.
        transform: to be published; None before a pose is given or asked for, and from a new start
            to the next update.
    """

    reason: str
    belief: Belief | None = None
    transform: MapFromOdom | None = None

    @property
    def estimate(self) -> PlanarGaussian | None:
        """The best mode of the belief."""
        return None if self.belief is None else self.belief.best


class LocalizerState(NamedTuple):
    """What a localizer knows.

    Attributes:
        mode, running, publishing, waiting, last: of the rules' state, as `Lifecycle`.
        gate: of the updates.
        transform: of the last update.
        counts: of scans and refusals.
    """

    mode: Mode
    running: bool
    publishing: bool
    waiting: GaussianState | None
    last: GaussianState | None
    gate: UpdateGate
    transform: MapFromOdom | None
    counts: dict[str, int]


class Localizer:
    """Applies the update rules to the filter. Not thread-safe.

    Args:
        particles: the filter.
        config: the settings.
        saved: the estimate of before a restart.

    Attributes:
        life: the rules' state.
        counts: of scans by `Localized.reason`, and of refusals by theirs.
    """

    def __init__(
        self, particles: PoseFilter, config: Config, saved: PlanarGaussian | None = None
    ) -> None:
        self.life = Lifecycle(config.localization.mode, last=saved)
        self.counts: Counter[str] = Counter()
        self._filter = particles
        self._config = config
        self._gate = UpdateGate()
        self._transform: MapFromOdom | None = None

    @property
    def correction(self) -> MapFromOdom | None:
        """The transform of the last update, if it may be used, published or not."""
        return self._transform if self.life.publishing else None

    def passed(self, reason: str) -> Localized:
        """Count a ping that gave no scan."""
        return self._counted(Localized(reason, transform=None))

    def reconfigure(self, config: Config) -> None:
        """Take other settings from the next event on; the particles stay.

        Raises:
            ValueError: the filter refuses them; the settings are as before.
        """
        self._filter.reconfigure(config)
        self._config = config

    def state(self) -> LocalizerState:
        """All that changes, but for filter, map and settings."""
        life = self.life
        return LocalizerState(
            life.mode,
            life.running,
            life.publishing,
            None if life.waiting is None else life.waiting.state(),
            None if life.last is None else life.last.state(),
            self._gate,
            self._transform,
            dict(self.counts),
        )

    def restore(self, state: LocalizerState, known: LocalizationMap | None) -> None:
        """Go on as the localizer that `state` was called of; the filter takes the map.

        Args:
            state: of it.
            known: the map that it had.
        """
        if known is not None:
            self._filter.take_map(known)
        waiting, last = (
            None if one is None else PlanarGaussian.restored(one)
            for one in (state.waiting, state.last)
        )
        self.life = Lifecycle(state.mode, known, state.running, state.publishing, waiting, last)
        self._gate, self._transform = state.gate, state.transform
        self.counts = Counter(state.counts)

    def take_map(self, known: LocalizationMap) -> Reject | None:
        """As `Lifecycle.take_map`; returns why not."""
        return self._begin(self.life.take_map(known, self._config.amcl))

    def take_pose(self, pose: PlanarGaussian, frame: str) -> Reject | None:
        """As `Lifecycle.take_pose`; returns why not."""
        return self._begin(self.life.take_pose(pose, frame, self._config.amcl))

    def localize_globally(self) -> Reject | None:
        """As `Lifecycle.localize_globally`; returns why not."""
        return self._begin(self.life.localize_globally())

    def set_map(self, known: LocalizationMap, pose: PlanarGaussian, frame: str) -> Reject | None:
        """As `Lifecycle.set_map`; returns why not."""
        return self._begin(self.life.set_map(known, pose, frame, self._config.amcl))

    def request_nomotion_update(self) -> Reject | None:
        """Have the next scan lead to an update; returns why not."""
        refused = self.life.check_nomotion_update()
        if refused is None:
            self._gate = self._gate.force()
        return refused

    def take_scan(self, scan: Scan, odom: Pose) -> Localized:
        """Update by a scan, if one is due.

        Args:
            scan: any, also one without returns.
            odom: the base in the odometry's frame at the scan's time.
        """
        if not self.life.running:
            return self._counted(Localized("no_filter"))
        amcl, ours = self._config.amcl, self._config.localization
        now = PlanarPose(
            float(odom.position_m[0]), float(odom.position_m[1]), yaw_of(odom.map_q_base)
        )
        self._gate, decision = self._gate.decide(
            now,
            scan.stamp_ns,
            amcl,
            max_interval_s=ours.update_max_interval,
            max_step_m=ours.max_step,
        )
        belief = None
        if decision.before is not None:
            belief = self._updated(decision.before, now, scan, odom)
        return self._counted(Localized(decision.reason, belief, self._published(scan.stamp_ns)))

    def _updated(self, before: PlanarPose, now: PlanarPose, scan: Scan, odom: Pose) -> Belief:
        amcl = self._config.amcl
        height_m = float(odom.position_m[2])
        belief = self._filter.update(before, now, decimated(scan, amcl.max_beams), height_m)
        self.life = self.life.estimated(belief.best)
        self._transform = map_from_odom(belief.best, odom, scan.stamp_ns, amcl.transform_tolerance)
        return belief

    def _published(self, stamp_ns: int) -> MapFromOdom | None:
        """The last transform, stamped ahead of this scan."""
        amcl = self._config.amcl
        if self._transform is None or not (self.life.publishing and amcl.tf_broadcast):
            return None
        ahead_ns = round(amcl.transform_tolerance * 1e9)
        return replace(self._transform, stamp_ns=stamp_ns + ahead_ns)

    def _begin(self, asked: tuple[Lifecycle, Start] | Reject) -> Reject | None:
        if isinstance(asked, Reject):
            self.counts[asked.reason] += 1
            return asked
        life, start = asked
        if start.new_map and life.map is not None:
            self._filter.take_map(life.map)
        if start.at is not None:
            self._filter.start_at(start.at, given=start.given)
        elif start.anywhere:
            self._filter.start_anywhere()
        self.life = life
        if start.is_start:
            self._gate, self._transform = self._gate.restarted(), None
        return None

    def _counted(self, localized: Localized) -> Localized:
        self.counts[localized.reason] += 1
        return localized
