"""From the bytes of recorded odometry to the pose buffer, every refusal counted."""

from collections import Counter

from mapperd.config import TimeSync
from mapperd.frames import Pose
from mapperd.odometry.buffer import PoseBuffer
from mapperd.odometry.native import decode_native
from mapperd.odometry.stamps import OdometryClock
from mapperd.reject import Reject

__all__ = ["OdometrySource"]


class OdometrySource:
    """One vehicle's odometry: bytes in, pose at a moment out.

    Attributes:
        received: records that came in.
        accepted: records in the pose buffer.
        rejects: reason to count; received == accepted + their sum.
        resets: changes of the source's reset counter.
    """

    def __init__(self, settings: TimeSync) -> None:
        self._clock = OdometryClock(_ns(settings.max_odom_age_sec))
        self._buffer = PoseBuffer(_ns(settings.max_gap_sec), _ns(settings.max_stamp_diff_sec))
        self._owner: str | None = None
        self._reset_count: int | None = None
        self.received = 0
        self.accepted = 0
        self.resets = 0
        self.rejects: Counter[str] = Counter()

    @property
    def newest_ns(self) -> int | None:
        """Host time of the newest pose."""
        return self._buffer.newest_ns

    def feed(self, data: bytes, arrival_ns: int | None) -> Reject | None:
        """Take one native record; None when it became a pose, else why not (and it is counted)."""
        self.received += 1
        reject = self._take(data, arrival_ns)
        if reject is None:
            self.accepted += 1
        else:
            self.rejects[reject.reason] += 1
        return reject

    def at(self, t_host_ns: int) -> Pose | Reject:
        """The pose at a moment."""
        return self._buffer.at(t_host_ns)

    def _take(self, data: bytes, arrival_ns: int | None) -> Reject | None:
        odometry = decode_native(data)
        if isinstance(odometry, Reject):
            return odometry
        # Two estimators do not agree about where the map is: the first one heard owns the pose.
        if self._owner is not None and odometry.source != self._owner:
            return Reject("other_source", f"{odometry.source!r}; poses come from {self._owner!r}")
        t_host_ns = self._clock.t_host_ns(odometry, arrival_ns)
        if isinstance(t_host_ns, Reject):
            return t_host_ns
        reject = self._buffer.add(odometry, t_host_ns)
        if reject is None:
            self._owner = odometry.source
            self.resets += self._reset_count not in (None, odometry.reset_count)
            self._reset_count = odometry.reset_count
        return reject


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
