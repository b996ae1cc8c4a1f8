"""The recent past of the vehicle, in order of time, and its pose at any moment of it.

A moment gets a pose in one of two ways, or none:

* enclosed by two records at most `max_gap` apart: position linear, orientation along the
  shorter arc;
* else, from the nearest record if it is at most `max_reach` away: the motion of the last
  (or next) two records is carried on, for no longer than those two are apart; where there are
  no two to tell the motion, the nearest pose is held.

Nothing is interpolated across a change of the source's reset counter: the estimate jumped
there, the vehicle did not.
"""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass

from mapperd.frames import Pose, quaternion_between
from mapperd.odometry.records import Odometry
from mapperd.reject import Reject

__all__ = ["MAX_RECORDS", "PoseBuffer", "StampedPose"]

MAX_RECORDS = 4096
"""Bound of the memory: 20 s at 200 Hz; the oldest go first."""


@dataclass(frozen=True, slots=True)
class StampedPose:
    """One accepted record.

    Attributes:
        t_host_ns: when the vehicle was there.
        pose: base in map.
        reset_count: the source's reset counter.
    """

    t_host_ns: int
    pose: Pose
    reset_count: int


class PoseBuffer:
    """Accepted poses of one source, ordered in time.

    Args:
        max_gap_ns: two records further apart than this are not interpolated between.
        max_reach_ns: how far beyond a record its motion may be carried on.
        max_records: bound of the memory.
    """

    def __init__(self, max_gap_ns: int, max_reach_ns: int, max_records: int = MAX_RECORDS) -> None:
        self._max_gap_ns = max_gap_ns
        self._max_reach_ns = max_reach_ns
        self._poses: deque[StampedPose] = deque(maxlen=max_records)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def newest_ns(self) -> int | None:
        """Time of the newest pose; None while there is none."""
        return self._poses[-1].t_host_ns if self._poses else None

    def add(self, odometry: Odometry, t_host_ns: int) -> Reject | None:
        """Take a record that is newer than all before it.

        Returns:
            None when taken, else why not.
        """
        if odometry.position_m is None or odometry.map_q_base is None:
            return Reject("no_pose", "a pose needs both p and q")
        newest = self.newest_ns
        if newest is not None and t_host_ns <= newest:
            late_s = (newest - t_host_ns) / 1e9
            return Reject("back_in_time", f"{late_s:g} s before the newest record, or equal to it")
        pose = Pose(odometry.position_m, odometry.map_q_base)
        self._poses.append(StampedPose(t_host_ns, pose, odometry.reset_count))
        return None

    def at(self, t_host_ns: int) -> Pose | Reject:
        """The pose at a moment; see the module for the rules."""
        poses = self._poses
        if not poses:
            return Reject("no_odometry", "no odometry so far")
        after = bisect_left(poses, t_host_ns, key=lambda stamped: stamped.t_host_ns)
        if after < len(poses) and poses[after].t_host_ns == t_host_ns:
            return poses[after].pose
        if 0 < after < len(poses) and self._linked(after - 1, after):
            return _mixed(poses[after - 1], poses[after], t_host_ns)
        return self._carried_on(after, t_host_ns)

    def _carried_on(self, after: int, t_host_ns: int) -> Pose | Reject:
        """From the nearer neighbour, when near enough; `after` is the index of the later one."""
        sides = [i for i in (after - 1, after) if 0 <= i < len(self._poses)]
        near = min(sides, key=lambda i: abs(self._poses[i].t_host_ns - t_host_ns))
        reach_ns = abs(self._poses[near].t_host_ns - t_host_ns)
        if reach_ns > self._max_reach_ns:
            return self._too_far(after, t_host_ns)
        beyond = near - 1 if near < after else near + 1
        if not (
            0 <= beyond < len(self._poses) and self._linked(min(near, beyond), max(near, beyond))
        ):
            return self._poses[near].pose
        base, guide = self._poses[near], self._poses[beyond]
        if reach_ns > abs(guide.t_host_ns - base.t_host_ns):  # would magnify their noise
            return base.pose
        return _mixed(base, guide, t_host_ns)

    def _linked(self, first: int, second: int) -> bool:
        """Whether motion between two neighbours can be told."""
        a, b = self._poses[first], self._poses[second]
        near = b.t_host_ns - a.t_host_ns <= self._max_gap_ns
        return near and a.reset_count == b.reset_count

    def _too_far(self, after: int, t_host_ns: int) -> Reject:
        if after == 0:
            lead_s = (self._poses[0].t_host_ns - t_host_ns) / 1e9
            return Reject("before_odometry", f"{lead_s:.3f} s before the oldest record")
        if after == len(self._poses):
            lag_s = (t_host_ns - self._poses[-1].t_host_ns) / 1e9
            return Reject("after_odometry", f"{lag_s:.3f} s after the newest record")
        gap_s = (self._poses[after].t_host_ns - self._poses[after - 1].t_host_ns) / 1e9
        return Reject("odometry_gap", f"in a gap of {gap_s:.3f} s, or across a reset")


def _mixed(a: StampedPose, b: StampedPose, t_host_ns: int) -> Pose:
    """The pose on the way from a to b at a moment, also beyond either."""
    fraction = (t_host_ns - a.t_host_ns) / (b.t_host_ns - a.t_host_ns)
    start, end = a.pose.position_m, b.pose.position_m
    quaternion = quaternion_between(a.pose.map_q_base, b.pose.map_q_base, fraction)
    return Pose(start + fraction * (end - start), quaternion)
