"""The step that processes one ping: live, replayed, recovered or simulated."""

from dataclasses import dataclass

from mapperd.config.tree import Config
from mapperd.errors import MapError, Reject
from mapperd.geometry.motion import BaseMotion
from mapperd.imaging.filter_chain import filter_ping_image
from mapperd.imaging.ping_image import PingImage, ping_image_of
from mapperd.imaging.robots import Point, Robot
from mapperd.localization.stage import LocalizationStage
from mapperd.mapping.sonar_map import PingStats, SonarMap
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.decoder import PosedPing
from oculus_driver.ping import Ping

__all__ = ["PingResult", "Stages", "process_ping", "skip_ping"]

Robots = tuple[Robot, ...]


@dataclass(frozen=True, slots=True)
class Stages:
    """The stages of the step that have a state.

    Attributes:
        map: the map; its settings hold for all stages of the image.
        localization: corrects the poses; None where localization is off.
    """

    map: SonarMap
    localization: LocalizationStage | None = None

    def correct(self, image: PingImage | Reject, posed: PosedPing) -> FusedPose | Reject:
        """Localize by a filtered image; return the pose to map it at, or a reject."""
        if self.localization is None or isinstance(posed.pose, Reject):
            return posed.pose
        return self.localization.correct(image, posed.pose, posed.t_ns)


@dataclass(frozen=True, slots=True, eq=False)
class PingResult:
    """Result of a ping.

    Attributes:
        posed: the ping with the odometry's pose.
        pose: the pose it was mapped at, map frame, or why it has none.
        stats: the changed voxels, or why the ping is not in the map.
        robots: other robots in the image, and their positions in the map.
        image: the image that was mapped; None for a rejected ping.
    """

    posed: PosedPing
    pose: FusedPose | Reject
    stats: PingStats | Reject
    robots: tuple[tuple[Robot, Point], ...] = ()
    image: PingImage | None = None

    @property
    def reject(self) -> Reject | None:
        """Why the ping is not in the map; None for a mapped ping."""
        return self.stats if isinstance(self.stats, Reject) else None


def process_ping(posed: PosedPing, stages: Stages) -> PingResult:
    """Process one ping; a rejected ping leaves the map unchanged.

    Args:
        posed: the ping with the pose of the base at the middle of the image.
        stages: the map and localization.
    """
    ping, sonar_map = posed.ping, stages.map
    if isinstance(posed.pose, Reject):
        return PingResult(posed, posed.pose, posed.pose)
    image, robots = filtered_image(ping, sonar_map.config)
    pose = stages.correct(image, posed)
    if isinstance(pose, Reject):
        return PingResult(posed, pose, pose)
    if isinstance(image, Reject):
        return PingResult(posed, pose, image)
    map_T_sonar = pose.pose.map_T_base @ sonar_map.base_T_sonar  # noqa: N806 frames are named
    sound_mps = ping.credible_speed_of_sound_mps
    base_motion = BaseMotion(pose.velocity_mps, pose.rate_radps)
    middle_s = ping.max_range_m / 2 / sound_mps
    motion = base_motion.of_sonar(pose.pose, sonar_map.base_T_sonar, middle_s, sound_mps)
    try:
        stats = sonar_map.integrate(image, map_T_sonar, motion)
    except MapError as error:
        return PingResult(posed, pose, Reject(error.reason, str(error)))
    located = tuple((robot, robot.position_m(map_T_sonar)) for robot in robots)
    return PingResult(posed, pose, stats, located, image)


def skip_ping(posed: PosedPing, stages: Stages, config: Config) -> None:
    """Update localization and the surface level by a ping that is already in the map."""
    if isinstance(posed.pose, Reject) or (
        stages.localization is None and stages.map.surface is None
    ):
        return
    image, _ = filtered_image(posed.ping, config)
    pose = stages.correct(image, posed)
    if not isinstance(pose, Reject) and not isinstance(image, Reject):
        stages.map.skip(image)


def filtered_image(ping: Ping, config: Config) -> tuple[PingImage | Reject, Robots]:
    """Return the image for localization and the map, or why there is none; and its robots."""
    try:
        return filter_ping_image(ping_image_of(ping, config.sonar), config)
    except MapError as error:
        return Reject(error.reason, str(error)), ()
