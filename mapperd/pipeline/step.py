"""THE STEP: what happens to a ping. Live, replayed and simulated pings all come through here."""

from dataclasses import dataclass, field

from mapperd.errors import MapError
from mapperd.geometry.frames import Pose
from mapperd.geometry.motion import BaseMotion
from mapperd.imaging.filter_chain import filter_echo
from mapperd.imaging.ping_image import Echo, echo_of
from mapperd.imaging.robots import Point, Robot
from mapperd.mapping.sonar_map import SonarMap
from mapperd.reject import Reject
from oculus_driver.ping import Ping

__all__ = ["Mapped", "process_ping"]

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
    echo: Echo | None = field(default=None, compare=False, repr=False)


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
        echo = echo_of(ping, sonar_map.config.sonar)
        echo, robots = filter_echo(echo, sonar_map.config)
        map_T_sonar = pose.map_T_base @ sonar_map.base_T_sonar  # noqa: N806 frames are named
        sound_mps = ping.credible_speed_of_sound_mps
        middle_s = ping.max_range_m / 2 / sound_mps
        motion = moving.of_sonar(pose, sonar_map.base_T_sonar, middle_s, sound_mps)
        changed = sonar_map.integrate(echo, map_T_sonar, motion)
    except MapError as error:
        return Reject(error.reason, str(error))
    seen = tuple((robot, robot.position_m(map_T_sonar)) for robot in robots)
    return Mapped(ping.ping_id, changed.occupied, changed.free, seen, echo)
