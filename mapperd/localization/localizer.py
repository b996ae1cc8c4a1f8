"""Localization: passes maps, poses, requests and scans to the filter.

`Lifecycle` decides what maps, initial poses and requests do to the filter. It is a pure state
machine: an event gives a new state and an action, or a refusal that leaves the state unchanged. The
rules are those of Beluga AMCL (`beluga_amcl`):

- On a new map the filter starts at a pending initial pose, if any; otherwise at the last estimate,
  or, with `always_reset_initial_pose` and `set_initial_pose`, at the configured pose. Without any
  estimate it starts at the configured pose if `set_initial_pose` is true.
- `first_map_only` ignores maps once the filter runs.
- A pose in another frame is refused. Without a map the newest pose waits for one.
- The transform is published from the first pose or request for global localization on. A start
  anywhere that only a new map caused does not publish it.

One rule differs. If nothing is known, Beluga AMCL starts anywhere on the map. Here mode `global`
does so, as if it were requested, and mode `track` waits for a pose. If the filter would have to
start anywhere on a map without a free cell, the map is refused and the old one stays.
"""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, Protocol

import numpy as np

from mapperd.config.tree import AmclConfig, Config
from mapperd.errors import Reject
from mapperd.geometry.frames import Pose
from mapperd.geometry.gaussian import Belief, GaussianState, PlanarGaussian
from mapperd.localization.maps import LocalizationMap
from mapperd.localization.odom_correction import MapFromOdom, map_from_odom
from mapperd.localization.scan import Scan, decimated, yaw_of
from mapperd.localization.update_gate import PlanarPose, UpdateGate

__all__ = [
    "Lifecycle",
    "Localized",
    "Localizer",
    "LocalizerState",
    "Mode",
    "PoseFilter",
    "Start",
    "parameter_pose",
]

Mode = Literal["off", "track", "global"]


@dataclass(frozen=True, slots=True)
class Start:
    """What the filter has to do.

    Attributes:
        new_map: use the state's map first.
        at: start with particles around this pose; None with `anywhere` False keeps them.
        anywhere: start with particles anywhere on the map.
        given: the pose was given; otherwise it is the last estimate, as certain as before.
    """

    new_map: bool = False
    at: PlanarGaussian | None = None
    anywhere: bool = False
    given: bool = True

    @property
    def is_start(self) -> bool:
        """Whether to draw new particles."""
        return self.anywhere or self.at is not None


@dataclass(frozen=True, slots=True)
class Lifecycle:
    """The state.

    Attributes:
        mode: `localization.mode`.
        map: the map in use.
        running: the filter has particles.
        publishing: the transform is published if `tf_broadcast` is true.
        waiting: an initial pose that waits for a map.
        last: the last estimate, possibly from before a restart.
    """

    mode: Mode = "track"
    map: LocalizationMap | None = None
    running: bool = False
    publishing: bool = False
    waiting: PlanarGaussian | None = None
    last: PlanarGaussian | None = None

    @property
    def name(self) -> str:
        """The state in words, for people."""
        if self.mode == "off":
            return "off"
        if self.map is None:
            return "waiting for a map"
        return "localizing" if self.running else "waiting for a pose"

    def take_map(
        self, new: LocalizationMap, amcl: AmclConfig
    ) -> "tuple[Lifecycle, Start] | Reject":
        """Handle a new map."""
        if amcl.first_map_only and self.running:
            return Reject("first_map_only", "a map is in use and amcl.first_map_only holds it")
        at = self.waiting or self._pose_for_map(amcl)
        if at is not None:
            return self._at(at, new, new_map=True, given=at is not self.last)
        if self.mode == "global" or self.running:
            publishing = self.publishing or self.mode == "global"
            return self._anywhere(new, new_map=True, publishing=publishing)
        return replace(self, map=new), Start(new_map=True)

    def take_pose(
        self, pose: PlanarGaussian, frame: str, amcl: AmclConfig
    ) -> "tuple[Lifecycle, Start] | Reject":
        """Handle an initial pose.

        Args:
            pose: mean and covariance.
            frame: its frame.
            amcl: the settings.
        """
        wrong = _wrong_frame(frame, amcl)
        if wrong is not None:
            return wrong
        if self.map is None:
            return replace(self, waiting=pose), Start()
        return self._at(pose, self.map, new_map=False)

    def localize_globally(self) -> "tuple[Lifecycle, Start] | Reject":
        """Handle a request for a start anywhere on the map."""
        if self.map is None:
            return Reject("no_map", "there is no map to be found on")
        return self._anywhere(self.map, new_map=False, publishing=True)

    def set_map(
        self, new: LocalizationMap, pose: PlanarGaussian, frame: str, amcl: AmclConfig
    ) -> "tuple[Lifecycle, Start] | Reject":
        """Handle a map together with a pose: both or neither; the filter must run."""
        if not self.running:
            return Reject("no_filter", "no filter is there yet; a map or a pose comes first")
        wrong = _wrong_frame(frame, amcl)
        if wrong is not None:
            return wrong
        return self._at(pose, new, new_map=True)

    def check_nomotion_update(self) -> Reject | None:
        """Return why an update without motion is refused; None if it is accepted."""
        return None if self.running else Reject("no_filter", "no filter is there yet")

    def estimated(self, estimate: PlanarGaussian) -> "Lifecycle":
        """Whether there is an estimate, of the filter or from before a restart."""
        return replace(self, last=estimate)

    def _pose_for_map(self, amcl: AmclConfig) -> PlanarGaussian | None:
        again = amcl.always_reset_initial_pose and amcl.set_initial_pose
        if self.last is not None and not again:
            return self.last
        return parameter_pose(amcl) if amcl.set_initial_pose else None

    def _at(
        self, pose: PlanarGaussian, known: LocalizationMap, *, new_map: bool, given: bool = True
    ) -> "tuple[Lifecycle, Start]":
        started = Lifecycle(self.mode, known, running=True, publishing=True, last=pose)
        return started, Start(new_map=new_map, at=pose, given=given)

    def _anywhere(
        self, known: LocalizationMap, *, new_map: bool, publishing: bool
    ) -> "tuple[Lifecycle, Start] | Reject":
        if not known.has_free_cells:
            return Reject("no_free_cells", "the map has no free cell that a vehicle can be in")
        started = Lifecycle(self.mode, known, running=True, publishing=publishing)
        return started, Start(new_map=new_map, anywhere=True)


def parameter_pose(amcl: AmclConfig) -> PlanarGaussian:
    """Return the initial pose of the settings."""
    xx, yy, aa = amcl.initial_cov_xx, amcl.initial_cov_yy, amcl.initial_cov_aa
    xy, xa, ya = amcl.initial_cov_xy, amcl.initial_cov_xa, amcl.initial_cov_ya
    covariance = np.array([[xx, xy, xa], [xy, yy, ya], [xa, ya, aa]])
    return PlanarGaussian(amcl.initial_pose_x, amcl.initial_pose_y, amcl.initial_pose_a, covariance)


def _wrong_frame(frame: str, amcl: AmclConfig) -> Reject | None:
    if frame == amcl.global_frame_id:
        return None
    return Reject("wrong_frame", f"a pose in {frame!r}, not in {amcl.global_frame_id!r}")


class PoseFilter(Protocol):
    """A particle filter on a map."""

    def reconfigure(self, config: Config) -> None:
        """Use other settings; the particles stay."""

    def take_map(self, known: LocalizationMap) -> None:
        """Use another map; the particles stay."""

    def start_at(self, pose: PlanarGaussian, *, given: bool = True) -> None:
        """Draw new particles around a pose; reset averages and counters.

        Args:
            pose: mean and covariance.
            given: it is certain; else as certain as the last estimate.
        """

    def start_anywhere(self) -> None:
        """Draw new particles on the map's free cells."""

    def update(
        self, before: PlanarPose, now: PlanarPose, scan: Scan, base_height_m: float
    ) -> Belief:
        """Move, weigh and, if due, resample the particles.

        Args:
            before: odometry at the last update.
            now: odometry at the scan.
            scan: the scan; an empty one only moves the particles.
            base_height_m: height of the base in the map, from the depth.

        Returns:
            The belief.
        """


@dataclass(frozen=True, slots=True)
class Localized:
    """Outcome of a scan.

    Attributes:
        reason: as `UpdateDecision.reason`, or `no_filter`.
        belief: the filter's belief, if the scan led to an update.
        transform: to publish; None before a pose is given or requested, and between a new start
            and the next update.
    """

    reason: str
    belief: Belief | None = None
    transform: MapFromOdom | None = None

    @property
    def estimate(self) -> PlanarGaussian | None:
        """The best mode of the last belief."""
        return None if self.belief is None else self.belief.best


class LocalizerState(NamedTuple):
    """State of a localizer.

    Attributes:
        mode, running, publishing, waiting, last: as in `Lifecycle`.
        gate: state of the update gate.
        transform: transform of the last update.
        counts: numbers of scans and refusals.
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
        saved: the estimate from before a restart.

    Attributes:
        life: state of the rules.
        counts: numbers of scans by `Localized.reason`, and of refusals by reason.
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
        """The transform of the last update if it is valid, published or not."""
        return self._transform if self.life.publishing else None

    def passed(self, reason: str) -> Localized:
        """Count a ping without a scan."""
        return self._counted(Localized(reason, transform=None))

    def reconfigure(self, config: Config) -> None:
        """Use other settings from the next event on; the particles stay.

        Raises:
            ValueError: the filter refuses them; the old ones stay.
        """
        self._filter.reconfigure(config)
        self._config = config

    def state(self) -> LocalizerState:
        """Return the state, without filter, map and settings."""
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
        """Continue from a state; the filter gets the map.

        Args:
            state: what `state` returned.
            known: the map at that time.
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
        """Handle a map as `Lifecycle.take_map`; return why it was refused, or None."""
        return self._begin(self.life.take_map(known, self._config.amcl))

    def take_pose(self, pose: PlanarGaussian, frame: str) -> Reject | None:
        """Handle a pose as `Lifecycle.take_pose`; return why it was refused, or None."""
        return self._begin(self.life.take_pose(pose, frame, self._config.amcl))

    def localize_globally(self) -> Reject | None:
        """Handle a request as `Lifecycle.localize_globally`; return why it was refused, or None."""
        return self._begin(self.life.localize_globally())

    def set_map(self, known: LocalizationMap, pose: PlanarGaussian, frame: str) -> Reject | None:
        """Handle a request as `Lifecycle.set_map`; return why it was refused, or None."""
        return self._begin(self.life.set_map(known, pose, frame, self._config.amcl))

    def request_nomotion_update(self) -> Reject | None:
        """Make the next scan lead to an update; return why that was refused, or None."""
        refused = self.life.check_nomotion_update()
        if refused is None:
            self._gate = self._gate.force()
        return refused

    def take_scan(self, scan: Scan, odom: Pose) -> Localized:
        """Update with a scan if an update is due.

        Args:
            scan: the scan, possibly without returns.
            odom: pose of the base in the odometry's frame at the scan's time.
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
        """Return the last transform, stamped ahead of this scan."""
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
