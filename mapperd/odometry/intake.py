"""Passes each quantity of a record to its track, or refuses it with a reason."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd.config.odometry import FIXED, NOBODY, OdometryFusionConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import quaternion_to_matrix, rotation_from_rpy
from mapperd.geometry.geodesy import Origin
from mapperd.odometry.reckoning import DeadReckoning, DeadReckoningState
from mapperd.odometry.records import UNKNOWN_VARIANCE, Odometry
from mapperd.odometry.states import (
    Attitude,
    BasePosition,
    blend_attitude,
    carry_attitude,
    length,
    turn_between,
)
from mapperd.odometry.track import Anchor, Owner, Track, TrackState, yaw_between

__all__ = ["Intake", "IntakeState"]

Floats = NDArray[np.float64]


class IntakeState(NamedTuple):
    """State of an `Intake`.

    Attributes:
        anchor: rotation and shift (3,) from the source's world to the map.
        rejoin: the position's world rotated with the attitude's.
        north_of: whether north is the reference, by sender of headings.
        origin_rad: latitude and longitude of the map's origin.
        position, attitude, depth, velocity, reckoning: states of the parts.
    """

    anchor: tuple[float, Floats]
    rejoin: bool
    north_of: list[tuple[Owner, bool]]
    origin_rad: tuple[float, float] | None
    position: TrackState
    attitude: TrackState
    depth: TrackState
    velocity: TrackState
    reckoning: DeadReckoningState


class Intake:
    """The tracks, and the checks before them.

    Args:
        settings: owners, limits, handling of jumps.
        max_gap_ns: maximum interval between velocities that is integrated.

    Attributes:
        position, attitude, depth, velocity: the tracks.
        reckoning: dead reckoning by velocity.
    """

    def __init__(self, settings: OdometryFusionConfig, max_gap_ns: int) -> None:
        self._settings = settings
        self._anchor = Anchor.none()
        self._rejoin = False
        self._north_of: dict[Owner, bool] = {}
        self._origin: Origin | None = None
        if (geo := settings.origin) is not None:
            self._origin = Origin(math.radians(geo.latitude), math.radians(geo.longitude))
        owners = settings.owners
        fixed = owners.position == FIXED
        self.position: Track[BasePosition] = Track(
            NOBODY if fixed else owners.position, self._too_far
        )
        self.attitude: Track[Attitude] = Track(owners.attitude, self._too_turned)
        self.depth: Track[Floats] = Track(owners.depth, self._too_far)
        self.velocity: Track[Floats] = Track(NOBODY if fixed else owners.velocity)
        self.reckoning = DeadReckoning(max_gap_ns, settings.dead_reckoning.noise)

    def reconfigure(self, settings: OdometryFusionConfig, max_gap_ns: int) -> None:
        """Use other limits, noise and handling of jumps; owners and origin stay."""
        self._settings = settings
        self.reckoning.max_gap_ns = max_gap_ns
        self.reckoning.noise = settings.dead_reckoning.noise

    def state(self) -> IntakeState:
        """Return the state for `restore`."""
        origin = self._origin
        return IntakeState(
            (self._anchor.yaw_rad, self._anchor.shift_m),
            self._rejoin,
            list(self._north_of.items()),
            None if origin is None else (origin.latitude_rad, origin.longitude_rad),
            self.position.state(),
            self.attitude.state(),
            self.depth.state(),
            self.velocity.state(),
            self.reckoning.state(),
        )

    def restore(self, state: IntakeState) -> None:
        """Restore a state taken with the same settings."""
        self._anchor, self._rejoin = Anchor(*state.anchor), state.rejoin
        self._north_of = dict(state.north_of)
        self._origin = None if state.origin_rad is None else Origin(*state.origin_rad)
        self.position.restore(state.position, BasePosition)
        self.attitude.restore(state.attitude, Attitude)
        self.depth.restore(state.depth, np.asarray)
        self.velocity.restore(state.velocity, np.asarray)
        self.reckoning.restore(state.reckoning)

    def take(self, who: Owner, odometry: Odometry, t_ns: int) -> Reject | None:
        """Process a record; return None if any quantity was used, otherwise the reason."""
        if (mixed := self._mixed(who, odometry)) is not None:
            return mixed
        results = []
        orientation = _orientation(odometry)
        if orientation is not None and self.attitude.owned_by(who, t_ns):
            taken = self._take_attitude(odometry, orientation, t_ns)
            results.append(self.attitude.counted(taken))
        if _has_position(odometry) and self.position.owned_by(who, t_ns):
            taken = self._take_position(odometry, self._source_position(odometry), t_ns)
            results.append(self.position.counted(taken))
        if odometry.depth_m is not None and self.depth.owned_by(who, t_ns):
            results.append(self.depth.counted(self._take_depth(odometry.depth_m, t_ns)))
        # A report without a velocity may interrupt its owner's dead reckoning, but owns nothing.
        mine = self.velocity.owner == who or _velocity(odometry)[0] is not None
        if _has_velocity(odometry) and mine and self.velocity.owned_by(who, t_ns):
            results.append(self.velocity.counted(self._take_velocity(who, odometry, t_ns)))
        self.reckoning.advance(self._matrix_at, self._attitude_until_ns())
        if not results:
            if not _has_anything(odometry):
                return Reject("no_pose", "no position, attitude, depth or velocity in it")
            return Reject("other_source", f"{who[0]!r} ({who[1]!r}) owns none of its quantities")
        if None not in results:
            return results[0]
        if _has_heading(odometry):
            self._north_of[who] = odometry.north_referenced
        return None

    def expected(self, t_ns: int) -> tuple[Floats | None, Floats | None]:
        """Return position (3,) and attitude (4,) from all records before."""
        return self._expected_position(t_ns), self._expected_attitude(t_ns)

    def _mixed(self, who: Owner, odometry: Odometry) -> Reject | None:
        """Return why the record's heading reference does not match; None if it does."""
        if not _has_heading(odometry):
            return None
        owners = {track.owner for track in (self.position, self.attitude, self.velocity)}
        others = {
            owner: north
            for owner, north in self._north_of.items()
            if owner != who and owner in owners
        }
        # A world with an arbitrary heading does not match the attitude of another sender.
        astray = not odometry.north_referenced and not self.attitude.open_to(who)
        if astray or any(north != odometry.north_referenced for north in others.values()):
            other = self._settings.owners.attitude if astray else next(iter(others))[0]
            return Reject(
                "mixed_headings",
                f"{who[0]!r} and {other!r} do not have the same north; take position and attitude "
                "from one source, or both from sources with a compass",
            )
        return None

    # One quantity each.

    def _take_attitude(self, odometry: Odometry, source_q_base: Floats, t_ns: int) -> Reject | None:
        rate = odometry.rate_radps
        limit = self._settings.limits.max_turn_rate
        if rate is not None and length(rate) > math.radians(limit):
            turn = math.degrees(length(rate))
            return Reject("turns_too_fast", f"{turn:.0f} deg/s; at most {limit:g}")
        jumped = self.attitude.judge(t_ns, source_q_base, odometry.reset_count)
        if isinstance(jumped, Reject):
            return jumped
        if jumped and self._anchors_attitude() and self.attitude.taken > 1:
            expected = self._expected_attitude(t_ns)
            if expected is not None:
                yaw_rad = yaw_between(source_q_base, expected)
                self._anchor = Anchor(yaw_rad, self._anchor.shift_m)
                self._rejoin = True  # the position's world rotated with it
        value = Attitude(
            self._anchor.attitude(source_q_base), rate, self._attitude_covariance(odometry)
        )
        self.attitude.take(t_ns, value, jumped=jumped)
        return None

    def _take_position(self, odometry: Odometry, source_m: Floats, t_ns: int) -> Reject | None:
        if (problem := self._too_fast(odometry)) is not None:
            return problem
        jumped = self.position.judge(t_ns, source_m, odometry.reset_count)
        if isinstance(jumped, Reject):
            return jumped
        jumped = jumped or self._returns_elsewhere(t_ns, self._anchor.place(source_m))
        if (jumped or self._rejoin) and self._settings.at_jump == "continue":
            expected = self._expected_position(t_ns)
            # One record alone does not set the anchor: it may be an outlier.
            if expected is not None and self.position.taken > 1:
                self._anchor = Anchor.joining(source_m, expected, self._anchor.yaw_rad)
            jumped, self._rejoin = True, False
        reckoned = self.reckoning.displacements.newest
        if not self.position.taken and reckoned is not None and not self._settings.owners.position:
            # Until now dead reckoning had its own origin.
            self.position.segment, jumped = reckoned.segment + 1, True
        value = BasePosition(
            self._anchor.place(source_m),
            self._map_velocity(odometry, t_ns),
            self._position_covariance(odometry),
            odometry.geo is None,
        )
        self.position.take(t_ns, value, jumped=jumped)
        return None

    def _take_depth(self, depth_m: float, t_ns: int) -> Reject | None:
        height = np.array([-depth_m])
        jumped = self.depth.judge(t_ns, height, 0)
        if isinstance(jumped, Reject):
            return jumped
        self.depth.take(t_ns, height, jumped=False)  # depth has no world that could jump
        return None

    def _take_velocity(self, who: Owner, odometry: Odometry, t_ns: int) -> Reject | None:
        if (problem := self._too_fast(odometry)) is not None:
            return problem
        velocity, in_map = _velocity(odometry)
        restarted = self.velocity.judge(t_ns, np.zeros(3), 0)
        if isinstance(restarted, Reject):
            return restarted
        if restarted:
            self.reckoning.restart()
        if velocity is None:
            self.reckoning.add(t_ns, None, in_map=in_map)
            return Reject("no_lock", "the source marks its velocity as invalid")
        if in_map and who in (self.position.owner, self.attitude.owner):
            velocity = self._anchor.direction(velocity)  # only of the world that jumped
        self.velocity.take(t_ns, velocity, jumped=False)
        self.reckoning.add(t_ns, velocity, in_map=in_map, noise=_velocity_noise(odometry))
        return None

    # Expected values and limits.

    def _expected_position(self, t_ns: int) -> Floats | None:
        last = self.position.series.newest
        if last is None:
            return None
        reckoned = self.displacement_m(last.t_ns, t_ns)
        if reckoned is not None:
            return last.value.position_m + reckoned
        velocity = last.value.velocity_mps
        if velocity is None or t_ns - last.t_ns > self.reckoning.max_gap_ns:
            return last.value.position_m
        return np.asarray(last.value.position_m + (t_ns - last.t_ns) / 1e9 * velocity)

    def _returns_elsewhere(self, t_ns: int, map_m: Floats) -> bool:
        """Whether a position after a silence differs from dead reckoning."""
        last = self.position.series.newest
        if last is None or t_ns - last.t_ns <= self.reckoning.max_gap_ns:
            return False
        reckoned = self.displacement_m(last.t_ns, t_ns)
        if reckoned is None:
            return False
        off_m = length(map_m - last.value.position_m - reckoned)
        return off_m > self._settings.limits.max_jump

    def displacement_m(self, from_ns: int, to_ns: int) -> Floats | None:
        """Return the displacement (3,) by velocity between two times, map axes; None if unknown."""
        start, end = self.reckoning.at(from_ns), self.reckoning.at(to_ns)
        if start is None or end is None or start.segment != end.segment:
            return None
        return end.value.displacement_m - start.value.displacement_m

    def _expected_attitude(self, t_ns: int) -> Floats | None:
        last = self.attitude.series.newest
        if last is None:
            return None
        carried = carry_attitude(last.value, (t_ns - last.t_ns) / 1e9)
        near = t_ns - last.t_ns <= self.reckoning.max_gap_ns
        return carried.map_q_base if carried is not None and near else last.value.map_q_base

    def _anchors_attitude(self) -> bool:
        """Whether a jump moves the attitude's world; a compass always refers to north."""
        alone = self.position.owner is None or self.position.owner == self.attitude.owner
        return alone and self._settings.at_jump == "continue"

    def _too_far(self, a: Floats, b: Floats, seconds: float) -> float:
        limits = self._settings.limits
        return (length(b - a) - limits.max_speed * seconds) / limits.max_jump

    def _too_turned(self, a: Floats, b: Floats, seconds: float) -> float:
        limits = self._settings.limits
        turned_deg = math.degrees(length(turn_between(a, b)))
        return (turned_deg - limits.max_turn_rate * seconds) / limits.max_jump_angle

    def _too_fast(self, odometry: Odometry) -> Reject | None:
        limit = self._settings.limits.max_speed
        velocity, _ = _velocity(odometry)
        speed = 0.0 if velocity is None else length(velocity)
        return Reject("too_fast", f"{speed:.1f} m/s; at most {limit:g}") if speed > limit else None

    # Conversions that need the current state.

    @property
    def north_referenced(self) -> bool:
        """Whether yaw of the attitude is from east, so that it gives a compass heading."""
        owner = self.attitude.owner
        return owner is not None and self._north_of.get(owner, False)

    @property
    def origin_deg(self) -> tuple[float, float] | None:
        """Latitude and longitude of the map's origin; None before the first geographic position."""
        if self._origin is None:
            return None
        return math.degrees(self._origin.latitude_rad), math.degrees(self._origin.longitude_rad)

    def _source_position(self, odometry: Odometry) -> Floats:
        """Return the position of a record; the owner's first geographic position is the origin."""
        if (geo := odometry.geo) is None:
            return np.asarray(odometry.position_m)
        if self._origin is None:
            self._origin = Origin(geo.latitude_rad, geo.longitude_rad)
        return self._origin.enu_m(geo.latitude_rad, geo.longitude_rad, geo.altitude_m or 0.0)

    def _map_velocity(self, odometry: Odometry, t_ns: int) -> Floats | None:
        velocity, in_map = _velocity(odometry)
        if velocity is None or in_map:
            return None if velocity is None else self._anchor.direction(velocity)
        orientation = odometry.map_q_base
        if orientation is not None:
            return quaternion_to_matrix(self._anchor.attitude(orientation)) @ velocity
        matrix = self._matrix_at(t_ns)
        return None if matrix is None else matrix @ velocity

    def _matrix_at(self, t_ns: int) -> Floats | None:
        before, after = self.attitude.series.around(t_ns)
        if before is None or t_ns - before.t_ns > self.reckoning.max_gap_ns:
            return None
        if after is not None and after.segment == before.segment:
            fraction = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
            turned: Attitude | None = blend_attitude(before.value, after.value, fraction)
        else:
            turned = carry_attitude(before.value, (t_ns - before.t_ns) / 1e9)
        return quaternion_to_matrix((turned or before.value).map_q_base)

    def _attitude_until_ns(self) -> int | None:
        newest = self.attitude.series.newest
        return None if newest is None else newest.t_ns

    def _position_covariance(self, odometry: Odometry) -> Floats:
        return _known(odometry.pose_covariance, slice(0, 3), self._settings.position_std)

    def _attitude_covariance(self, odometry: Odometry) -> Floats:
        own = math.radians(self._settings.attitude_std)
        return _known(odometry.pose_covariance, slice(3, 6), own)


def _orientation(odometry: Odometry) -> Floats | None:
    """Return the attitude; for a heading alone, that of a level vehicle."""
    if not odometry.valid:
        return None
    if odometry.map_q_base is None and odometry.heading_rad is not None:
        return rotation_from_rpy(0.0, 0.0, math.degrees(odometry.heading_rad))
    return odometry.map_q_base


def _has_position(odometry: Odometry) -> bool:
    return odometry.valid and not (odometry.geo is None and odometry.position_m is None)


def _has_heading(odometry: Odometry) -> bool:
    """Whether the record has directions, which need the same reference as the others."""
    given = (odometry.position_m, odometry.velocity_map_mps, _orientation(odometry))
    return any(quantity is not None for quantity in given)


def _has_anything(odometry: Odometry) -> bool:
    given = (odometry.position_m, odometry.geo, odometry.depth_m, _orientation(odometry))
    return _has_velocity(odometry) or any(quantity is not None for quantity in given)


def _has_velocity(odometry: Odometry) -> bool:
    """Whether the record reports a velocity or its loss."""
    return not odometry.valid or _velocity(odometry)[0] is not None


def _velocity(odometry: Odometry) -> tuple[Floats | None, bool]:
    """Return the velocity (3,), and whether it is in map axes."""
    if not odometry.valid:
        return None, False
    if odometry.velocity_map_mps is not None:
        return odometry.velocity_map_mps, True
    if odometry.velocity_mps is None and odometry.velocity_east_north_mps is not None:
        return np.array([*odometry.velocity_east_north_mps, 0.0]), True
    return odometry.velocity_mps, False


def _velocity_noise(odometry: Odometry) -> float | None:
    """Return the source's standard deviation of the worst axis, m/s."""
    if odometry.twist_covariance is None:
        return None
    worst = float(np.max(np.diag(odometry.twist_covariance)[:3]))
    return math.sqrt(worst) if 0.0 < worst < UNKNOWN_VARIANCE else None


def _known(covariance: Floats | None, part: slice, own_std: float) -> Floats:
    """Return a block (3, 3) of the source's covariance, or the configured value."""
    if covariance is not None:
        block = covariance[part, part]
        variances = block.diagonal().tolist()
        if min(variances) > 0.0 and max(variances) < UNKNOWN_VARIANCE:
            return block
    return _alike(own_std)


@lru_cache(maxsize=8)
def _alike(std: float) -> Floats:
    """Return the covariance (3, 3) for one standard deviation, read-only."""
    covariance = std**2 * np.eye(3)
    covariance.setflags(write=False)
    return covariance
