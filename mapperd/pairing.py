"""Pings meet poses: a ping waits until odometry that encloses its time has come."""

from collections import deque
from collections.abc import Iterator
from typing import Protocol

from mapperd.config import TimeSync
from mapperd.frames import Pose
from mapperd.odometry.source import OdometrySource
from mapperd.reject import Reject
from oculus_driver.ping import Ping

__all__ = ["FixedPose", "OdometryPoses", "PoseSource", "ping_time_ns"]

MAX_WAITING_BYTES = 128 * 1024 * 1024
"""Images that may wait; beyond, the oldest ping is settled with what is known."""


class PoseSource(Protocol):
    """Gives pings their poses, in the order in which the pings came."""

    def add_ping(self, ping: Ping) -> None:
        """Take a ping that wants a pose."""

    def add_odometry(self, data: bytes, arrival_ns: int | None) -> None:
        """Take one native odometry record."""

    def settled(
        self, now_ns: int | None, *, final: bool = False
    ) -> Iterator[tuple[Ping, Pose | Reject]]:
        """Pings whose pose is known, or known to be unknown.

        Args:
            now_ns: the recording's clock: stamp of the newest chunk.
            final: nothing more will come.
        """


class FixedPose:
    """Every ping has the same pose; odometry is only counted.

    Attributes:
        ignored: odometry records that came all the same.
    """

    def __init__(self, pose: Pose) -> None:
        self._pose = pose
        self._pings: deque[Ping] = deque()
        self.ignored = 0

    def add_ping(self, ping: Ping) -> None:
        """Take a ping that wants a pose."""
        self._pings.append(ping)

    def add_odometry(self, data: bytes, arrival_ns: int | None) -> None:  # noqa: ARG002 a fixed pose needs neither
        """Count a record."""
        self.ignored += 1

    def settled(
        self,
        now_ns: int | None,  # noqa: ARG002 nothing to wait for
        *,
        final: bool = False,  # noqa: ARG002
    ) -> Iterator[tuple[Ping, Pose | Reject]]:
        """Pings so far, each with the fixed pose."""
        while self._pings:
            yield self._pings.popleft(), self._pose


class OdometryPoses:
    """Poses from the recording's odometry.

    Attributes:
        odometry: the source, with its counters.
    """

    def __init__(self, settings: TimeSync) -> None:
        self.odometry = OdometrySource(settings)
        # A record may be one gap away and late; after that it will not come.
        self._patience_ns = round((settings.max_gap_sec + settings.max_odom_age_sec) * 1e9)
        self._pings: deque[Ping] = deque()
        self._waiting_bytes = 0

    def add_ping(self, ping: Ping) -> None:
        """Take a ping that wants a pose."""
        self._pings.append(ping)
        self._waiting_bytes += ping.image.nbytes

    def add_odometry(self, data: bytes, arrival_ns: int | None) -> None:
        """Take one native odometry record."""
        self.odometry.feed(data, arrival_ns)

    def settled(
        self, now_ns: int | None, *, final: bool = False
    ) -> Iterator[tuple[Ping, Pose | Reject]]:
        """Pings whose time lies behind the newest record, or that have waited long enough."""
        while self._pings and (final or self._is_ripe(self._pings[0], now_ns)):
            ping = self._pings.popleft()
            self._waiting_bytes -= ping.image.nbytes
            yield ping, self._pose_of(ping)

    def _is_ripe(self, ping: Ping, now_ns: int | None) -> bool:
        t_ns, newest_ns = ping_time_ns(ping), self.odometry.newest_ns
        if t_ns is None or self._waiting_bytes > MAX_WAITING_BYTES:
            return True
        if newest_ns is not None and newest_ns >= t_ns:
            return True
        # Far ahead of the clock is a stamp gone astray: nobody else must wait for it.
        return now_ns is not None and abs(now_ns - t_ns) > self._patience_ns

    def _pose_of(self, ping: Ping) -> Pose | Reject:
        t_ns = ping_time_ns(ping)
        if t_ns is None:
            return Reject("no_arrival_time", "the recording does not say when the ping came")
        return self.odometry.at(t_ns)


def ping_time_ns(ping: Ping) -> int | None:
    """When the sound met the middle of the image, on the recording's clock; None if unknown."""
    return ping.echo_time_ns(ping.max_range_m / 2)
