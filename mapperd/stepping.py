"""Pings on their way through the step, each counted once, whatever becomes of it."""

from collections.abc import Callable

from mapperd.counters import ReplayCounters
from mapperd.mapping import SonarMap
from mapperd.motion import BaseMotion
from mapperd.odometry.fusion import FusedPose
from mapperd.pairing import PoseSource
from mapperd.reject import Reject
from mapperd.step import Mapped, process_ping
from oculus_driver.ping import Ping

__all__ = ["Stepping"]


class Stepping:
    """Lets every Nth ping wait for its pose, and puts pings with a pose through the step.

    Args:
        sonar_map: where the pings go.
        poses: where they wait.
        clock: seconds, to time the steps with.

    Attributes:
        counters: what happened.
    """

    def __init__(self, sonar_map: SonarMap, poses: PoseSource, clock: Callable[[], float]) -> None:
        self.counters = ReplayCounters()
        self._map = sonar_map
        self._poses = poses
        self._clock = clock
        self._frame_skip = sonar_map.config.processing.frame_skip
        self._offered = 0

    def offer(self, ping: Ping | Reject, t_ns: int | None = None) -> None:
        """Count what came and let it wait for its pose.

        Args:
            ping: or why there is none.
            t_ns: as `PoseSource.add_ping` takes it.
        """
        self.counters.pings_total += 1
        if isinstance(ping, Reject):
            self.counters.drop(ping.reason, ping.detail)
            return
        self._offered += 1
        if (self._offered - 1) % self._frame_skip:
            self.counters.drop("frame_skip", f"every {self._frame_skip}th ping is mapped")
        else:
            self._poses.add_ping(ping, t_ns)

    def step(self, ping: Ping, pose: FusedPose | Reject) -> None:
        """Map a ping that is settled."""
        if isinstance(pose, Reject):
            self.counters.drop(pose.reason, pose.detail)
            return
        began_s = self._clock()
        moving = BaseMotion(pose.velocity_mps, pose.rate_radps)
        result = process_ping(ping, pose.pose, self._map, moving)
        self.counters.step_s.append(self._clock() - began_s)
        if isinstance(result, Mapped):
            self.counters.pings_mapped += 1
        else:
            self.counters.drop(result.reason, result.detail)
