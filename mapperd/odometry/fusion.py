"""Fuses the records of all sources to one pose at any time; each quantity has one owner.

Position, attitude, depth and velocity are tracked separately, so that they may come from different
senders at different rates; a pose is assembled on request. While no position arrives, velocity and
attitude continue the last one (dead reckoning).
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd.config.odometry import (
    FIXED,
    NOBODY,
    OdometryFusionConfig,
    SlamQualityConfig,
    TimeSyncConfig,
    WorldInitConfig,
)
from mapperd.errors import Reject
from mapperd.geometry.frames import Pose, quaternion_to_matrix
from mapperd.odometry.clock import OdometryClock, OdometryClockState
from mapperd.odometry.gate import ConfidenceGate, GateState, bad_record
from mapperd.odometry.intake import Intake, IntakeState
from mapperd.odometry.levelling import Levelling, LevellingState, levelled
from mapperd.odometry.records import Odometry
from mapperd.odometry.series import (
    InterpolationLimits,
    enclosing,
    is_settled,
    value_at,
    velocity_samples,
)
from mapperd.odometry.states import (
    ATTITUDE,
    HEIGHT,
    POSITION,
    Attitude,
    BasePosition,
    turn_between,
)

if TYPE_CHECKING:
    from mapperd.odometry.series import Sample

__all__ = ["FusedPose", "Fusion", "FusionState", "PoseSampler"]

Floats = NDArray[np.float64]

NO_POSITION = (
    "the odometry has neither position nor velocity so far: add a DVL, set odometry.sonar.enabled, "
    "or map from one spot with odometry.owners.position: fixed"
)


@dataclass(frozen=True, slots=True, eq=False)
class FusedPose:
    """Pose and motion of the vehicle at one time.

    Attributes:
        pose: base in map.
        velocity_mps: (3,) of the base, map axes; None if unknown.
        rate_radps: (3,) of the base, about base axes; None if unknown.
        covariance: (6, 6), x y z in map axes then rotations about map axes; m and rad.
        segment: increases at each jump of the odometry; poses of one segment are consistent.
        reckoned_s: age of the last position if velocity continued it; 0 between positions.
    """

    pose: Pose
    velocity_mps: Floats | None
    rate_radps: Floats | None
    covariance: Floats
    segment: int
    reckoned_s: float


@dataclass(frozen=True, slots=True, eq=False)
class _AnchoredPosition:
    """A position and its origin."""

    value: BasePosition
    segment: int
    reckoned_s: float = 0.0


class FusionState(NamedTuple):
    """State of a `Fusion`.

    Attributes:
        clocks: source, sender and clock of each stream of stamps, with its state.
        gate, level, intake: states of the parts.
        received, rejects: as in `Fusion`.
    """

    clocks: list[tuple[tuple[str, str, str], OdometryClockState]]
    gate: GateState
    level: LevellingState
    intake: IntakeState
    received: dict[str, int]
    rejects: dict[str, dict[str, int]]


class Fusion:
    """All odometry of one vehicle.

    Args:
        settings: owners, limits, dead reckoning.
        time_sync: limits of interpolation and extrapolation.
        quality: settings of the confidence gate.
        world_init: settings of levelling.
        latency_sec: minimum latency of records in seconds, by source.

    Attributes:
        received: number of records, by source.
        rejects: number of rejects, by source and reason.
    """

    def __init__(
        self,
        settings: OdometryFusionConfig | None = None,
        time_sync: TimeSyncConfig | None = None,
        quality: SlamQualityConfig | None = None,
        world_init: WorldInitConfig | None = None,
        latency_sec: dict[str, float] | None = None,
    ) -> None:
        self._settings = settings or OdometryFusionConfig()
        time_sync = time_sync or TimeSyncConfig()
        self._is_fixed = self._settings.owners.position == FIXED
        self._depth_is_named = self._settings.owners.depth not in ("", NOBODY)
        self._limits = InterpolationLimits.of(time_sync)
        self._max_age_ns = round(time_sync.max_odom_age_sec * 1e9)
        self._latency_ns = {
            name: round(seconds * 1e9) for name, seconds in (latency_sec or {}).items()
        }
        self._clocks: dict[tuple[str, str, str], OdometryClock] = {}
        self._gate = ConfidenceGate(quality or SlamQualityConfig())
        self._level = Levelling(world_init or WorldInitConfig())
        self._in = Intake(self._settings, self._limits.max_gap_ns)
        self.received: Counter[str] = Counter()
        self.rejects: dict[str, Counter[str]] = {}

    def reconfigure(
        self, settings: OdometryFusionConfig, time_sync: TimeSyncConfig, quality: SlamQualityConfig
    ) -> None:
        """Use other settings from now on.

        Args:
            settings: differ only in what may change while running; owners keep their quantities.
            time_sync: limits of interpolation and extrapolation.
            quality: settings of the confidence gate.
        """
        self._settings = settings
        self._limits = InterpolationLimits.of(time_sync)
        self._max_age_ns = round(time_sync.max_odom_age_sec * 1e9)
        for clock in self._clocks.values():
            clock.max_age_ns = self._max_age_ns
        self._gate.settings = quality
        self._in.reconfigure(settings, self._limits.max_gap_ns)

    def state(self) -> FusionState:
        """Return the state for `restore`."""
        return FusionState(
            [(key, clock.state()) for key, clock in self._clocks.items()],
            self._gate.state(),
            self._level.state(),
            self._in.state(),
            dict(self.received),
            {source: dict(counts) for source, counts in self.rejects.items()},
        )

    def restore(self, state: FusionState) -> None:
        """Restore the state of a fusion with the same settings."""
        for key, clock in state.clocks:
            self._clocks[key] = self._clock(key[0])
            self._clocks[key].restore(clock)
        self._gate.restore(state.gate)
        self._level.restore(state.level)
        self._in.restore(state.intake)
        self.received = Counter(state.received)
        self.rejects = {source: Counter(counts) for source, counts in state.rejects.items()}

    def take(self, source: str, odometry: Odometry, arrival_ns: int | None) -> Reject | None:
        """Process a record; return None if anything of it was used, otherwise the counted reason.

        Args:
            source: configured name of its source.
            odometry: the record.
            arrival_ns: arrival time, host clock; None if the recording has none.
        """
        self.received[source] += 1
        reject = self._taken(source, odometry, arrival_ns)
        if reject is not None:
            self.rejects.setdefault(source, Counter())[reject.reason] += 1
        return reject

    @property
    def origin_deg(self) -> tuple[float, float] | None:
        """Latitude and longitude of the map's origin; None before the first geographic position."""
        return self._in.origin_deg

    def ready(self, t_ns: int) -> bool:
        """Whether later records cannot improve the pose at a time."""
        position = self._in.position.series.newest
        reckoned, depth = self._in.reckoning.displacements.newest, self._in.depth.series.newest
        if not is_settled(self._in.attitude.series, t_ns, self._limits):
            return False
        if self._waits_for_depth(position) and (
            depth is None or 0 < t_ns - depth.t_ns <= self._limits.max_gap_ns
        ):
            return False
        if self._is_fixed:
            return True
        if position is not None and t_ns - position.t_ns <= self._limits.max_gap_ns:
            return is_settled(self._in.position.series, t_ns, self._limits)
        return reckoned is not None and reckoned.t_ns >= t_ns

    def attitude_is_settled(self, t_ns: int) -> bool:
        """Whether later records cannot improve the attitude at a time."""
        return is_settled(self._in.attitude.series, t_ns, self._limits)

    def attitude_at(self, t_ns: int) -> Floats | Reject:
        """Return map_q_base (4,) at a time, before levelling, or why it is unknown."""
        attitude = value_at(self._in.attitude.series, t_ns, self._limits, ATTITUDE)
        return attitude if isinstance(attitude, Reject) else attitude.value.map_q_base

    def at(self, t_ns: int) -> FusedPose | Reject:
        """Return the vehicle's state at a time, or why it is unknown."""
        problem = self._level.pending or self._gate.check(t_ns)
        if problem is not None:
            return problem
        attitude = value_at(self._in.attitude.series, t_ns, self._limits, ATTITUDE)
        if isinstance(attitude, Reject):
            return attitude
        placed = self._placed(t_ns)
        return placed if isinstance(placed, Reject) else self._fused(t_ns, attitude, placed)

    @property
    def fitted(self) -> frozenset[str]:
        """Sources whose Unix stamps are fitted, as their clock was found wrong."""
        return frozenset(key[0] for key, clock in self._clocks.items() if clock.is_distrusted)

    def status(self) -> dict[str, Any]:
        """Status for people: owners, numbers of records and rejects."""
        return {
            "quantities": {
                "position": self._in.position.status(),
                "attitude": self._in.attitude.status(),
                "depth": self._in.depth.status(),
                "velocity": self._in.velocity.status(),
            },
            "sources": {
                name: {
                    "received": count,
                    "rejected": dict(self.rejects.get(name, {})),
                    **self._clock_offset(name),
                }
                for name, count in self.received.items()
            },
            "newest": self._newest(),
            "north_referenced": self._in.north_referenced,
            "confidence": self._gate.confidence,
            "unchecked_pings": self._gate.unchecked,
            "velocities_without_attitude": self._in.reckoning.without_attitude,
            "levelling": self._level.status(),
        }

    def _newest(self) -> dict[str, Any]:
        """Return the newest depth and attitude, which arrive even where no pose can be had."""
        depth, attitude = self._in.depth.series.newest, self._in.attitude.series.newest
        return {
            "depth_m": None if depth is None else -float(depth.value[0]),
            "map_q_base_wxyz": None if attitude is None else attitude.value.map_q_base.tolist(),
        }

    def _clock_offset(self, source: str) -> dict[str, float]:
        """Return `clock_offset_s` of a source whose stamps are fitted, else an empty dictionary."""
        offsets = [
            clock.offset_ns
            for key, clock in self._clocks.items()
            if key[0] == source and clock.offset_ns is not None
        ]
        return {"clock_offset_s": offsets[-1] / 1e9} if offsets else {}

    def _taken(self, source: str, odometry: Odometry, arrival_ns: int | None) -> Reject | None:
        if (problem := bad_record(odometry)) is not None:
            return problem
        who = (source, odometry.source)
        # One sender may use time since boot in some messages and Unix time in others.
        key = (*who, odometry.clock)
        clock = self._clocks.get(key)
        if clock is None:
            clock = self._clocks[key] = self._clock(source)
        t_ns = clock.t_host_ns(odometry, arrival_ns)
        if isinstance(t_ns, Reject):
            return t_ns
        reject = self._in.take(who, odometry, t_ns)
        # Only the source of the position counts: others state the confidence of other quantities.
        placer = self._in.position.owner or self._in.velocity.owner
        self._gate.heard(t_ns, odometry.confidence if who == placer else None)
        force, orientation = odometry.specific_force_mps2, odometry.map_q_base
        mine = reject is None and who == self._in.attitude.owner
        if mine and force is not None and orientation is not None:
            self._level.add(force, odometry.rate_radps, orientation, _speed_mps(odometry))
        return reject

    def _waits_for_depth(self, position: "Sample[BasePosition] | None") -> bool:
        """Whether heights come from a source of depth."""
        if self._depth_is_named:
            return True
        return self._in.depth.owner is not None and (
            position is None or not position.value.has_height
        )

    def _placed(self, t_ns: int) -> _AnchoredPosition | Reject:
        """Return the position: interpolated, by dead reckoning, extrapolated, or fixed."""
        if self._is_fixed:
            covariance = self._settings.position_std**2 * np.eye(3)
            return _AnchoredPosition(
                BasePosition(np.zeros(3), np.zeros(3), covariance, has_height=False), 0
            )
        series = self._in.position.series
        before, after = series.around(t_ns)
        interpolates = self._limits.policy == "interpolate"
        if interpolates and enclosing(before, after, self._limits) is None:
            reckoned = self._reckoned(before, t_ns)
            if reckoned is not None:
                return reckoned
        found = value_at(series, t_ns, self._limits, POSITION)
        if not series and isinstance(found, Reject):
            return Reject("no_position", NO_POSITION)
        return found if isinstance(found, Reject) else _AnchoredPosition(found.value, found.segment)

    def _reckoned(self, last: "Sample[BasePosition] | None", t_ns: int) -> _AnchoredPosition | None:
        """Return the position by dead reckoning from the last one, or from 0 without any source."""
        end = self._in.reckoning.at(t_ns)
        if end is None or (last is not None and last.t_ns == t_ns):
            return None
        if last is None:
            awaited = self._settings.owners.position not in ("", NOBODY)
            if awaited or self._in.position.owner is not None:
                return None
            covariance = end.value.variance_m2 * np.eye(3)
            value = BasePosition(
                end.value.displacement_m, end.value.velocity_mps, covariance, has_height=False
            )
            return _AnchoredPosition(value, end.segment)
        start = self._in.reckoning.at(last.t_ns)
        seconds = (t_ns - last.t_ns) / 1e9
        if (
            start is None
            or start.segment != end.segment
            or seconds > self._settings.dead_reckoning.max_sec
        ):
            return None
        grown = max(end.value.variance_m2 - start.value.variance_m2, 0.0) * np.eye(3)
        value = BasePosition(
            last.value.position_m + end.value.displacement_m - start.value.displacement_m,
            end.value.velocity_mps,
            last.value.covariance_m2 + grown,
            last.value.has_height,
        )
        return _AnchoredPosition(value, last.segment, seconds)

    def _fused(
        self, t_ns: int, attitude: "Sample[Attitude]", placed: _AnchoredPosition
    ) -> FusedPose | Reject:
        position_m, map_q_base = placed.value.position_m, attitude.value.map_q_base
        velocity = self._velocity(t_ns, placed)
        if (level := self._level.level_q_odometry) is not None:
            matrix = quaternion_to_matrix(level)
            position_m, map_q_base = matrix @ position_m, levelled(level, map_q_base)
            velocity = None if velocity is None else matrix @ velocity
        by_depth = self._depth_is_named or (
            self._in.depth.owner is not None and not placed.value.has_height
        )
        if by_depth:
            # After levelling: depth is not affected by tilt; without it the position has no height.
            height = self._height_m(t_ns)
            if isinstance(height, Reject):
                return height
            position_m = np.array([position_m[0], position_m[1], height])
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = placed.value.covariance_m2
        covariance[3:, 3:] = attitude.value.covariance_rad2
        return FusedPose(
            Pose(position_m, map_q_base),
            velocity,
            self._rate(t_ns, attitude.value),
            covariance,
            placed.segment + attitude.segment + by_depth,
            placed.reckoned_s,
        )

    def _clock(self, source: str) -> OdometryClock:
        return OdometryClock(self._max_age_ns, self._latency_ns.get(source, 0))

    def _height_m(self, t_ns: int) -> float | Reject:
        height = value_at(self._in.depth.series, t_ns, self._limits, HEIGHT)
        if isinstance(height, Reject):
            return Reject("no_depth", f"no depth: {height.detail}")
        return float(height.value[0])

    def _velocity(self, t_ns: int, placed: _AnchoredPosition) -> Floats | None:
        """Return the velocity: of its source, of the positions, or from positions around the time.

        None if the positions lie farther apart than the vehicle can move: that is noise.
        """
        reckoned = self._in.reckoning.at(t_ns)
        if reckoned is not None:
            return reckoned.value.velocity_mps
        if placed.value.velocity_mps is not None:
            return placed.value.velocity_mps
        pair = velocity_samples(self._in.position.series, t_ns, self._limits)
        if pair is None:
            return None
        displacement_m = pair[1].value.position_m - pair[0].value.position_m
        velocity = np.asarray(displacement_m / ((pair[1].t_ns - pair[0].t_ns) / 1e9))
        limit_mps = self._settings.limits.max_speed
        return velocity if float(np.linalg.norm(velocity)) <= limit_mps else None

    def _rate(self, t_ns: int, attitude: Attitude) -> Floats | None:
        """Return the rates: of the source, or from attitudes; None if that is noise."""
        if attitude.rate_radps is not None:
            return attitude.rate_radps
        pair = velocity_samples(self._in.attitude.series, t_ns, self._limits)
        if pair is None:
            return None
        turn = turn_between(pair[0].value.map_q_base, pair[1].value.map_q_base)
        rate = np.asarray(turn / ((pair[1].t_ns - pair[0].t_ns) / 1e9))
        limit_radps = math.radians(self._settings.limits.max_turn_rate)
        return rate if float(np.linalg.norm(rate)) <= limit_radps else None


class PoseSampler:
    """Samples poses at a fixed interval, while a recording is decoded.

    Args:
        fusion: that the decoder feeds.
        step_ns: between two poses.

    Attributes:
        t_ns: times of the poses.
        poses: the poses; times without a pose are left out.
    """

    LAG_NS = 500_000_000
    """Age at which a pose is read: both neighbours have come, and are still in memory."""

    MAX_PAUSE_NS = 10**10
    """After a longer pause of the arrivals the times begin again."""

    def __init__(self, fusion: Fusion, step_ns: int) -> None:
        self._fusion = fusion
        self._step_ns = step_ns
        self._next_ns: int | None = None
        self._fitted: frozenset[str] | None = None
        self._newest_ns = 0
        self.t_ns: list[int] = []
        self.poses: list[FusedPose] = []

    def advance(self, now_ns: int | None) -> None:
        """Read all poses that are old enough at a time of the recording."""
        if now_ns is None:
            return
        self._newest_ns = max(self._newest_ns, now_ns)
        if self._next_ns is None or now_ns - self._next_ns > self.MAX_PAUSE_NS:
            self._next_ns = now_ns
        while self._next_ns < now_ns - self.LAG_NS:
            found = self._fusion.at(self._next_ns)
            if not isinstance(found, Reject):
                if self._fitted is None:
                    self._fitted = self._fusion.fitted
                self.t_ns.append(self._next_ns)
                self.poses.append(found)
            self._next_ns += self._step_ns

    def finish(self) -> None:
        """Read the last poses, when the recording has ended."""
        if self._next_ns is not None:
            self.advance(self._newest_ns + 2 * self.LAG_NS)

    def refitted(self) -> tuple[str, ...]:
        """Return the sources whose stamps are fitted now, and were not at the first pose."""
        return tuple(sorted(self._fusion.fitted - (self._fitted or frozenset())))


def _speed_mps(odometry: Odometry) -> float | None:
    """Return the speed in the record, or None."""
    velocity = odometry.velocity_mps
    if velocity is None:
        velocity = odometry.velocity_map_mps
    return None if velocity is None else float(np.linalg.norm(velocity))
