"""THE STEP: what happens to a ping. Live, replayed and simulated pings all come here."""

from collections.abc import Callable
from dataclasses import dataclass, field

from mapperd.config.tree import Config
from mapperd.errors import MapError, Reject
from mapperd.geometry.frames import Pose
from mapperd.geometry.motion import BaseMotion
from mapperd.imaging.filter_chain import check_filters, filter_ping_image
from mapperd.imaging.ping_image import PingImage, ping_image_of
from mapperd.imaging.robots import Point, Robot, Sighting, Sightings
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.pose_lookup import ODOMETRY_FOLLOWS
from oculus_driver.ping import Ping

__all__ = ["Mapped", "StepRunner", "process_ping"]

AT_REST = BaseMotion()


@dataclass(frozen=True, slots=True)
class Mapped:
    """A ping that is in the map.

    Attributes:
        ping_id: the sonar's number of it.
        voxels_occupied: voxels that it gave occupied evidence.
        voxels_free: voxels that it gave free evidence.
        robots: other robots that it saw, and where in the map.
        echo: what of it was mapped.
    """

    ping_id: int
    voxels_occupied: int
    voxels_free: int
    robots: tuple[tuple[Robot, Point], ...] = ()
    echo: PingImage | None = field(default=None, compare=False, repr=False)


def process_ping(
    ping: Ping, pose: Pose, sonar_map: SonarMap, moving: BaseMotion = AT_REST
) -> Mapped | Reject:
    """Put one ping into the map.

    Args:
        ping: what the sonar heard.
        pose: the base in the map frame, when the sound met the middle of the image.
        sonar_map: the map; unchanged when the ping is rejected.
        moving: how the base moves then.
    """
    try:
        echo = ping_image_of(ping, sonar_map.config.sonar)
        echo, robots = filter_ping_image(echo, sonar_map.config)
        map_T_sonar = pose.map_T_base @ sonar_map.base_T_sonar  # noqa: N806 frames are named
        sound_mps = ping.credible_speed_of_sound_mps
        middle_s = ping.max_range_m / 2 / sound_mps
        motion = moving.of_sonar(pose, sonar_map.base_T_sonar, middle_s, sound_mps)
        changed = sonar_map.integrate(echo, map_T_sonar, motion)
    except MapError as error:
        return Reject(error.reason, str(error))
    seen = tuple((robot, robot.position_m(map_T_sonar)) for robot in robots)
    return Mapped(ping.ping_id, changed.occupied, changed.free, seen, echo)


class StepRunner:
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
    """Settings that the way of a ping follows: in `take`, `PoseLookup` and `LocalizationStage`."""

    def __init__(
        self,
        sonar_map: SonarMap,
        clock: Callable[[], float],
        counters: PipelineCounters | None = None,
    ) -> None:
        self.counters = counters or PipelineCounters()
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
