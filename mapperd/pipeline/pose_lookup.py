"""Finds the pose of each ping: a ping waits until odometry encloses its time."""

from collections import deque
from collections.abc import Iterator
from dataclasses import fields
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config, TimeSyncConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import Pose
from mapperd.odometry.bridge import BridgeState, OdometryBridge
from mapperd.odometry.fusion import FusedPose
from oculus_driver.clock import SonarClock
from oculus_driver.ping import Ping

__all__ = [
    "ODOMETRY_FOLLOWS",
    "FixedPose",
    "OdometryPoses",
    "PoseLookup",
    "PoseLookupState",
    "fixed_pose",
    "origin_of",
    "ping_time_ns",
]

Floats = NDArray[np.float64]

ODOMETRY_FOLLOWS = (
    "time_sync",
    "slam_quality",
    "odometry.limits",
    "odometry.dead_reckoning",
    "odometry.at_jump",
    "odometry.position_std",
    "odometry.attitude_std",
)
"""Settings that `PoseLookup.reconfigure` follows."""

MAX_WAITING_BYTES = 128 * 1024 * 1024
"""Maximum size of the waiting images; above this the oldest ping gets the best known pose."""


class PoseLookupState(NamedTuple):
    """State of a `PoseLookup`.

    Attributes:
        pings: values of the fields of each ping that waits, and its time.
        odometry: of the bridge; None where the vehicle stands still.
        fixed: position (3,) and orientation (4,) of a vehicle that stands still.
        ignored: pieces of odometry that it ignored.
        unregistered: newest pings that sonar odometry has not used yet, and whether it may.
    """

    pings: list[tuple[list[Any], int | None]]
    odometry: BridgeState | None = None
    fixed: tuple[Floats, Floats] | None = None
    ignored: int = 0
    unregistered: list[bool] | None = None


class PoseLookup(Protocol):
    """Finds the poses of pings, in the order of the pings."""

    @property
    def waiting_bytes(self) -> int:
        """Size of the images of the waiting pings."""

    @property
    def origin_deg(self) -> tuple[float, float] | None:
        """Latitude and longitude of the map's origin; None without a position on Earth."""

    def reconfigure(self, config: Config) -> None:
        """Use other settings from now on, for waiting pings too.

        Args:
            config: differs from the present one in settings of `ODOMETRY_FOLLOWS`; sonar odometry
                also follows the mounting.
        """

    def add_ping(self, ping: Ping, t_ns: int | None = None, *, damaged: bool = False) -> None:
        """Add a ping.

        Args:
            ping: of the sonar.
            t_ns: when the sound reached the middle of the image; None derives it from the arrival.
            damaged: its image may be wrong.
        """

    def add_odometry(
        self,
        link: str,
        data: bytes,
        arrival_ns: int | None,
        *,
        encoding: str | None = None,
        gap_before: bool = False,
    ) -> None:
        """Feed bytes of odometry, as for `OdometryBridge.feed`."""

    def decoded(self, link: str) -> tuple[int, int]:
        """Return a link's decoded bytes, and those outside of valid frames; any thread."""

    def resolved(
        self, now_ns: int | None, *, final: bool = False
    ) -> Iterator[tuple[Ping, FusedPose | Reject]]:
        """Yield the pings that need not wait any longer, with their poses or why they have none.

        Args:
            now_ns: time on the clock of the arrivals, or the stamp of a recording's newest chunk.
            final: no more odometry arrives.
        """

    def state(self) -> PoseLookupState:
        """Return the state for `restore`."""

    def restore(self, state: PoseLookupState) -> None:
        """Restore a state taken with the same settings.

        Raises:
            ValueError: it is the state of another kind, or cannot be read here.
        """


def _fields_of(ping: Ping) -> list[Any]:
    return [getattr(ping, field.name) for field in fields(Ping)]


def _ping_of(values: list[Any]) -> Ping:
    named = {field.name: value for field, value in zip(fields(Ping), values, strict=True)}
    return Ping(**named | {"warnings": frozenset(named["warnings"])})


def origin_of(config: Config, poses: PoseLookup) -> tuple[float, float] | None:
    """Return latitude and longitude of the map's origin: the setting, else the first position."""
    setting = config.odometry.origin
    return poses.origin_deg if setting is None else (setting.latitude, setting.longitude)


def fixed_pose(pose: Pose) -> FusedPose:
    """Return the exactly known pose of a vehicle at rest."""
    return FusedPose(pose, None, None, np.zeros((6, 6)), 0, 0.0)


class FixedPose:
    """The same pose for every ping; odometry is only counted.

    Attributes:
        pose: of every ping.
        ignored: number of ignored pieces of odometry.
    """

    def __init__(self, pose: Pose) -> None:
        self.pose = pose
        self._pose = fixed_pose(pose)
        self._pings: deque[Ping] = deque()
        self.ignored = 0

    @property
    def waiting_bytes(self) -> int:
        """Size of the images of the waiting pings."""
        return sum(ping.image.nbytes for ping in self._pings)

    @property
    def origin_deg(self) -> tuple[float, float] | None:
        """None: a fixed pose has no position on Earth."""
        return None

    def reconfigure(self, config: Config) -> None:
        """Do nothing: no setting changes a fixed pose."""

    def add_ping(
        self,
        ping: Ping,
        t_ns: int | None = None,  # noqa: ARG002 any time
        *,
        damaged: bool = False,  # noqa: ARG002 the image is not read
    ) -> None:
        """Add a ping."""
        self._pings.append(ping)

    def add_odometry(
        self,
        link: str,  # noqa: ARG002 a fixed pose needs none
        data: bytes,  # noqa: ARG002
        arrival_ns: int | None,  # noqa: ARG002
        *,
        encoding: str | None = None,  # noqa: ARG002
        gap_before: bool = False,  # noqa: ARG002
    ) -> None:
        """Count a piece of odometry and ignore it."""
        self.ignored += 1

    def decoded(self, link: str) -> tuple[int, int]:  # noqa: ARG002 nothing is decoded
        """As `PoseLookup.decoded`."""
        return 0, 0

    def resolved(
        self,
        now_ns: int | None,  # noqa: ARG002 nothing to wait for
        *,
        final: bool = False,  # noqa: ARG002
    ) -> Iterator[tuple[Ping, FusedPose | Reject]]:
        """Yield all pings with the fixed pose."""
        while self._pings:
            yield self._pings.popleft(), self._pose

    def state(self) -> PoseLookupState:
        """As `PoseLookup.state`."""
        pings: list[tuple[list[Any], int | None]] = [
            (_fields_of(ping), None) for ping in self._pings
        ]
        fixed = (self.pose.position_m, self.pose.map_q_base)
        return PoseLookupState(pings, fixed=fixed, ignored=self.ignored)

    def restore(self, state: PoseLookupState) -> None:
        """As `PoseLookup.restore`."""
        if state.fixed is None or state.odometry is not None:
            raise ValueError("a fixed pose was expected")
        self.pose = Pose(*state.fixed)
        self._pose = fixed_pose(self.pose)
        self._pings = deque(_ping_of(values) for values, _ in state.pings)
        self.ignored = state.ignored


class OdometryPoses:
    """Poses from the vehicle's odometry.

    Args:
        config: the sources and how they are fused.

    Attributes:
        odometry: fuses the records and counts them.
    """

    def __init__(self, config: Config) -> None:
        self.odometry = OdometryBridge(config)
        self._timeout_ns = _timeout_ns(config.time_sync)
        self._pings: deque[tuple[Ping, int | None]] = deque()
        self._waiting_bytes = 0
        self._unregistered: deque[bool] = deque()

    @property
    def waiting_bytes(self) -> int:
        """Size of the images of the waiting pings."""
        return self._waiting_bytes

    @property
    def origin_deg(self) -> tuple[float, float] | None:
        """Latitude and longitude of the map's origin; None before the first position on Earth."""
        return self.odometry.fusion.origin_deg

    def reconfigure(self, config: Config) -> None:
        """Use other settings from now on, for waiting pings too."""
        self._timeout_ns = _timeout_ns(config.time_sync)
        self.odometry.reconfigure(config)

    def add_ping(self, ping: Ping, t_ns: int | None = None, *, damaged: bool = False) -> None:
        """Add a ping."""
        self._pings.append((ping, ping_time_ns(ping) if t_ns is None else t_ns))
        self._waiting_bytes += ping.image.nbytes
        if self.odometry.sonar is not None:
            self._unregistered.append(not damaged)

    def add_odometry(
        self,
        link: str,
        data: bytes,
        arrival_ns: int | None,
        *,
        encoding: str | None = None,
        gap_before: bool = False,
    ) -> None:
        """Feed bytes of odometry, as for `OdometryBridge.feed`."""
        self.odometry.feed(link, data, arrival_ns, encoding=encoding, gap_before=gap_before)

    def decoded(self, link: str) -> tuple[int, int]:
        """As `PoseLookup.decoded`."""
        decoder = self.odometry.decoder_of(link)
        return (
            (0, 0)
            if decoder is None
            else (decoder.counters.bytes_total, decoder.counters.bytes_skipped)
        )

    def resolved(
        self, now_ns: int | None, *, final: bool = False
    ) -> Iterator[tuple[Ping, FusedPose | Reject]]:
        """Yield the pings that odometry encloses, and those that have waited long enough."""
        self._register(now_ns, final=final)
        while self._pings and (final or self._is_ripe(self._pings[0][1], now_ns)):
            ping, t_ns = self._pings.popleft()
            self._waiting_bytes -= ping.image.nbytes
            yield ping, self._pose_at(t_ns)

    def state(self) -> PoseLookupState:
        """As `PoseLookup.state`."""
        pings = [(_fields_of(ping), t_ns) for ping, t_ns in self._pings]
        return PoseLookupState(
            pings,
            odometry=self.odometry.state(),
            unregistered=list(self._unregistered) or None,
        )

    def restore(self, state: PoseLookupState) -> None:
        """As `PoseLookup.restore`."""
        if state.odometry is None or state.fixed is not None or state.ignored:
            raise ValueError("odometry was expected")
        self.odometry.restore(state.odometry)
        self._pings = deque((_ping_of(values), t_ns) for values, t_ns in state.pings)
        self._waiting_bytes = sum(ping.image.nbytes for ping, _ in self._pings)
        self._unregistered = deque(state.unregistered or ())

    def _register(self, now_ns: int | None, *, final: bool) -> None:
        """Feed sonar odometry with the pings whose attitude is known, in their order.

        Its velocities up to a ping lie before the ping: the ping then waits for the next one.
        """
        while self._unregistered:
            ping, t_ns = self._pings[len(self._pings) - len(self._unregistered)]
            waits = not (final or self._overdue(t_ns, now_ns))
            if waits and t_ns is not None and self.odometry.awaits_attitude(t_ns):
                return
            if self._unregistered.popleft() and t_ns is not None:
                self.odometry.register(ping, t_ns)

    def _is_ripe(self, t_ns: int | None, now_ns: int | None) -> bool:
        if t_ns is None or self._overdue(t_ns, now_ns):
            return True
        return self.odometry.fusion.ready(t_ns)

    def _overdue(self, t_ns: int | None, now_ns: int | None) -> bool:
        """Whether a ping must not wait any longer."""
        if t_ns is None or self._waiting_bytes > MAX_WAITING_BYTES:
            return True
        # A stamp far ahead of the clock is wrong: later pings must not wait for it.
        return now_ns is not None and abs(now_ns - t_ns) > self._timeout_ns

    def _pose_at(self, t_ns: int | None) -> FusedPose | Reject:
        if t_ns is None:
            return Reject("no_arrival_time", "the recording has no arrival time of the ping")
        return self.odometry.fusion.at(t_ns)


def _timeout_ns(settings: TimeSyncConfig) -> int:
    """Return how long to wait for a record that is late after a gap."""
    return round((settings.max_gap_sec + settings.max_odom_age_sec) * 1e9)


def ping_time_ns(ping: Ping, clock: SonarClock | None = None) -> int | None:
    """Return when the sound reached the middle of the image, clock of the arrivals, or None.

    Args:
        ping: of one sonar, in order of arrival.
        clock: of that sonar; more exact than the arrival of this ping alone.
    """
    if clock is None:
        return ping.echo_time_ns(ping.max_range_m / 2)
    placed = clock.place(ping)
    one_way_ns = ping.flight_ns(ping.max_range_m / 2)
    return None if placed is None else placed.transmit_ns + one_way_ns
