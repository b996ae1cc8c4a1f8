"""Pings on their way through the step, each counted once, whatever becomes of it."""

from collections.abc import Callable

from mapperd.config.tree import Config
from mapperd.geometry.motion import BaseMotion
from mapperd.imaging.filter_chain import check_filters
from mapperd.imaging.sightings import Sighting, Sightings
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.counters import ReplayCounters
from mapperd.pipeline.pose_lookup import ODOMETRY_FOLLOWS
from mapperd.pipeline.step import Mapped, process_ping
from mapperd.reject import Reject
from oculus_driver.ping import Ping

__all__ = ["Stepping"]


class Stepping:
    """Puts pings with a pose through the step.

    Args:
        sonar_map: where the pings go.
        clock: seconds, to time the steps with.
        counters: to go on with; new ones where there are none.

    Raises:
        ConfigError: a filter that is on cannot run.

    Attributes:
        counters: what happened.
        sightings: robots that were seen lately.
    """

    FOLLOWS = (
        "filtering",
        "mounting.orientation",
        "octree",
        "mapping",
        "processing",
        "crosstalk",
        "terrain_detection",
        "robot_detection",
        "amcl",
        "localization",
        *ODOMETRY_FOLLOWS,
    )
    """Settings that the way of a ping follows: through `take`, its `PoseSource`, and `Onboard`."""

    def __init__(
        self,
        sonar_map: SonarMap,
        clock: Callable[[], float],
        counters: ReplayCounters | None = None,
    ) -> None:
        self.counters = counters or ReplayCounters()
        self._map = sonar_map
        self._clock = clock
        check_filters(sonar_map.config)
        self.sightings = Sightings()
        self._next = sonar_map.config

    def take(self, config: Config) -> None:
        """Step with other settings from the next ping on.

        Args:
            config: differs from the one in force in settings that `FOLLOWS` names, and has passed
                `check_filters`.
        """
        self._next = config

    def step(self, ping: Ping, pose: FusedPose | Reject) -> Mapped | Reject:
        """Map a ping that is settled; returns what became of it."""
        if isinstance(pose, Reject):
            self.counters.drop(pose.reason, pose.detail)
            return pose
        if self._map.config is not self._next:
            self._map.reconfigure(self._next)
        began_s = self._clock()
        moving = BaseMotion(pose.velocity_mps, pose.rate_radps)
        result = process_ping(ping, pose.pose, self._map, moving)
        self.counters.took(self._clock() - began_s)
        if isinstance(result, Mapped):
            self.counters.pings_mapped += 1
            self._remember(ping.arrival_ns, result)
        else:
            self.counters.drop(result.reason, result.detail)
        return result

    def _remember(self, arrival_ns: int | None, mapped: Mapped) -> None:
        if arrival_ns is not None:
            self.sightings.add(
                Sighting(arrival_ns, place_m, robot) for robot, place_m in mapped.robots
            )
