"""Localization as a stage of the pipeline: every ping with a pose passes through, in order.

The result depends only on the pings, their poses and the requests between them, so a replay
reproduces it. While a filter runs, every ping gives a scan, not only those that lead to an update:
burst detection needs the two pings before, and viewers show each scan.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, assert_never

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import MapError, Reject
from mapperd.geometry.gaussian import Belief, BeliefState, PlanarGaussian
from mapperd.imaging.ping_image import PingImage
from mapperd.localization.extraction import BurstState, BurstWatch, burst_watch, scan_at
from mapperd.localization.known_map import KnownMap
from mapperd.localization.localizer import Localized, Localizer, LocalizerState
from mapperd.localization.map_filter import FilterState, MapFilter
from mapperd.localization.maps import VolumeMap
from mapperd.localization.odom_correction import placed
from mapperd.localization.particle_filter import Cluster, clusters_of
from mapperd.localization.scan import Scan
from mapperd.localization.status import LocalizationSnapshot, diagnose, model_warning, sample_of
from mapperd.odometry.fusion import FusedPose
from mapperd.session_log import (
    GlobalLocalization,
    InitialPose,
    NewMap,
    NoMotionUpdate,
    Request,
    SetMap,
)

__all__ = ["LocalizationStage", "LocalizationStageState", "gaussian_of"]

Floats = NDArray[np.float64]

NO_ODOMETRY = ("bad_odometry", "odometry_jump")
"""Reasons to skip a scan that also make its pose unusable for mapping."""


@dataclass(frozen=True, slots=True, eq=False)
class _Updated:
    """The last update of the filter."""

    belief: Belief
    scan: Scan
    base_height_m: float


class LocalizationStageState(NamedTuple):
    """State of the stage.

    Attributes:
        filter, localizer, watch: states of the parts.
        updates: number of updates so far.
        updated: belief, scan and height of the base at the last update.
        path, sha256: the map in use; empty without one.
    """

    filter: FilterState
    localizer: LocalizerState
    watch: BurstState
    updates: int
    updated: tuple[BeliefState, Scan, float] | None
    path: str
    sha256: str


class LocalizationStage:
    """Localization of one session; used in the mapping thread only.

    Args:
        config: the settings; `localization.mode` is not off.
        known: the first map; None waits for one.
        saved: estimate to continue from, or None.
        load: returns the map that a request names by path and fingerprint.

    Raises:
        MapError: the map is refused (`no_free_cells`).
        ValueError: the filter refuses the settings.
    """

    def __init__(
        self,
        config: Config,
        known: KnownMap | None = None,
        saved: PlanarGaussian | None = None,
        load: "Callable[[str, str], KnownMap] | None" = None,
    ) -> None:
        self._config = config
        self._filter = MapFilter(config)
        self._localizer = Localizer(self._filter, config, saved)
        self._load = load
        self._known: KnownMap | None = None
        self._watch = burst_watch(config)
        self._updates = 0
        self._updated: _Updated | None = None
        self._odom: FusedPose | None = None
        self._odom_ns: int | None = None
        self._localized = Localized("no_filter")
        self._changes = 0
        self._shown: tuple[int, Floats, tuple[Cluster, ...]] = (-1, np.zeros((0, 4)), ())
        if known is not None:
            refused = self._localizer.take_map(known.map)
            if refused is not None:
                raise MapError(f"{known.path}: {refused.detail}", refused.reason)
            self._known = known

    @property
    def localizer(self) -> Localizer:
        """The localizer, with its counts."""
        return self._localizer

    def reconfigure(self, config: Config) -> None:
        """Use other settings from the next ping on; settings that the filter refuses are counted.

        The caller has checked them with `check_localization`.
        """
        try:
            self._localizer.reconfigure(config)
        except ValueError:
            self._localizer.counts["settings_refused"] += 1
            return
        self._config = config

    def correct(
        self, image: PingImage | Reject, pose: FusedPose, t_ns: int | None
    ) -> FusedPose | Reject:
        """Localize with a ping; return the pose to map it at, or why it has none.

        Args:
            image: the filtered image, or why the ping has none.
            pose: pose of the odometry at the ping's time.
            t_ns: time of the ping.
        """
        self._localized = self._look(image, pose, t_ns or 0)
        self._odom, self._odom_ns = pose, t_ns or 0
        where = self._config.localization.mapping
        if where == "odometry":
            return pose
        if where == "off":
            return Reject("mapping_off", "localization.mapping is off")
        return self._corrected(pose)

    def request(self, request: Request) -> Reject | None:
        """Carry out a request; return the reason if it was refused, else None.

        Raises:
            CheckpointError: the map of a recorded request no longer exists.
        """
        try:
            return self._carry_out(request)
        except (MapError, ValueError) as error:  # a bad request must not end the mapping thread
            self._localizer.counts["bad_request"] += 1
            return Reject("bad_request", str(error))

    def state(self) -> LocalizationStageState:
        """Return all state that corrected poses depend on, without the settings."""
        known, last = self._known, self._updated
        return LocalizationStageState(
            self._filter.state(),
            self._localizer.state(),
            self._watch.state(),
            self._updates,
            None if last is None else (last.belief.state(), last.scan, last.base_height_m),
            "" if known is None else known.path,
            "" if known is None else known.sha256,
        )

    def restore(self, state: LocalizationStageState, known: KnownMap | None) -> None:
        """Continue from a state, with the same settings.

        Args:
            state: what `state` returned.
            known: the map in use at that time.

        Raises:
            ValueError: the state is invalid; the stage cannot be used afterwards.
        """
        self._localizer.restore(state.localizer, None if known is None else known.map)
        self._filter.restore(state.filter)
        self._watch, self._known = BurstWatch.restored(state.watch), known
        self._updates, self._updated = state.updates, None
        if state.updated is not None:
            belief, scan, height_m = state.updated
            self._updated = _Updated(Belief.restored(belief), scan, height_m)
        self._changes += 1

    def snapshot(self) -> LocalizationSnapshot:
        """Return the current state for status and viewers."""
        amcl, last, localizer = self._config.amcl, self._updated, self._localizer
        belief = None if last is None else last.belief
        correction = localizer.correction
        odom = None if self._odom is None else self._odom.pose
        return LocalizationSnapshot(
            state=localizer.life.name,
            counts=dict(localizer.counts),
            updates=self._updates,
            stamp_ns=None if last is None else last.scan.stamp_ns,
            belief=belief,
            clusters=() if belief is None else self._cloud()[1],
            transform=self._localized.transform,
            odom=odom,
            pose=None if correction is None or odom is None else correction.corrected(odom),
            odom_ns=self._odom_ns,
            sure=self._unsure() is None,
            diagnosis=diagnose(None if belief is None else belief.best, amcl),
            warning=model_warning(amcl, in_3d=self._is_in_3d()),
            particle_count=len(self._filter.particles),
            particles=self._cloud()[0],
            scan_points_m=None if last is None else _in_map(last),
            known=self._known,
        )

    def _is_in_3d(self) -> bool:
        return self._known is not None and isinstance(self._known.map, VolumeMap)

    def _look(self, image: PingImage | Reject, pose: FusedPose, t_ns: int) -> Localized:
        if not self._localizer.life.running:
            return self._localizer.passed("no_filter")
        if isinstance(image, Reject):
            return self._localizer.passed(image.reason)
        scan = scan_at(image, pose, t_ns, self._config, self._watch)
        if isinstance(scan, Reject):
            return self._localizer.passed(scan.reason)
        localized = self._localizer.take_scan(scan, pose.pose)
        if localized.belief is not None:
            self._updates += 1
            self._changes += 1
            self._updated = _Updated(localized.belief, scan, float(pose.pose.position_m[2]))
        return localized

    def _corrected(self, pose: FusedPose) -> FusedPose | Reject:
        if self._localized.reason in NO_ODOMETRY:
            return Reject(
                "odometry_jump", "the odometry stepped farther than localization.max_step"
            )
        unsure = self._unsure()
        correction, last = self._localizer.correction, self._updated
        if unsure is not None or correction is None or last is None:
            return unsure or Reject("not_localized", "the vehicle is not localized yet")
        return placed(pose, correction, last.belief.best)

    def _unsure(self) -> Reject | None:
        """Reason why the belief cannot be used for mapping, or None."""
        if self._localizer.correction is None or self._updated is None:
            return Reject("not_localized", "the vehicle is not localized yet")
        belief = self._updated.belief
        if belief.ambiguous:
            return Reject("ambiguous", "the vehicle may as well be somewhere else on the map")
        ours, covariance = self._config.localization, belief.best.covariance
        std_m = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]), 0.0))
        if std_m > ours.mapping_max_std:
            return Reject("unsure", "the place is less sure than localization.mapping_max_std")
        if math.degrees(math.sqrt(max(covariance[2, 2], 0.0))) > ours.mapping_max_std_yaw:
            return Reject("unsure", "the heading is less so than localization.mapping_max_std_yaw")
        return None

    def _carry_out(self, request: Request) -> Reject | None:
        match request:
            case InitialPose():
                return self._begun(
                    lambda: self._localizer.take_pose(gaussian_of(request), request.frame)
                )
            case GlobalLocalization():
                return self._begun(self._localizer.localize_globally)
            case NoMotionUpdate():
                return self._localizer.request_nomotion_update()
            case NewMap() if not self._config.amcl.use_map_topic and self._known is not None:
                return Reject("map_topic_off", "amcl.use_map_topic is off: the map is map_path's")
            case NewMap():
                return self._with_map(request, lambda known: self._localizer.take_map(known.map))
            case SetMap():
                return self._with_map(
                    request,
                    lambda known: self._localizer.set_map(
                        known.map, gaussian_of(request), request.frame
                    ),
                )
            case _:
                assert_never(request)

    def _begun(self, begin: Callable[[], Reject | None]) -> Reject | None:
        refused = begin()
        if refused is None:
            self._updated, self._localized = None, Localized("no_filter")
            self._changes += 1
        return refused

    def _with_map(
        self, request: NewMap | SetMap, take: Callable[[KnownMap], Reject | None]
    ) -> Reject | None:
        if self._load is None:
            return Reject("no_map", "no map can be loaded here")
        known = self._load(request.path, request.sha256)
        refused = self._begun(lambda: take(known))
        if refused is None:
            self._known = known
        return refused

    def _cloud(self) -> tuple[Floats, tuple[Cluster, ...]]:
        """Return a sample of the particles, and their clusters."""
        if self._shown[0] != self._changes:
            particles = self._filter.particles
            self._shown = (self._changes, sample_of(particles), clusters_of(particles))
        return self._shown[1:]


def gaussian_of(request: InitialPose | SetMap) -> PlanarGaussian:
    """Return the pose of a request.

    Raises:
        ValueError: a number is not finite, or the covariance is invalid.
    """
    covariance = np.array(request.covariance, dtype=np.float64).reshape(3, 3)
    return PlanarGaussian(request.x_m, request.y_m, request.yaw_rad, covariance)


def _in_map(last: _Updated) -> Floats:
    """Return the points of the scan at the estimate, map frame."""
    best = last.belief.best
    c, s = math.cos(best.yaw_rad), math.sin(best.yaw_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    place = np.array([best.x_m, best.y_m, last.base_height_m])
    points: Floats = last.scan.points_m @ turn.T + place
    points.setflags(write=False)
    return points
