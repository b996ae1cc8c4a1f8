"""The scan of a ping that comes with a pose."""

import math

from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.imaging.filter_chain import filter_echo
from mapperd.imaging.ping_image import echo_of
from mapperd.localization.burst_filter import BurstWatch
from mapperd.localization.extraction import Surroundings, scan_of
from mapperd.localization.levelling import level_T_base
from mapperd.localization.scan import Scan
from mapperd.mapping.sonar_map import mounting
from mapperd.odometry.fusion import FusedPose
from mapperd.reject import Reject
from oculus_driver.ping import Ping

__all__ = ["burst_watch", "scan_of_ping"]

UNNAMED = ("", "none")
"""Owners of the depth that are no source."""


def burst_watch(config: Config) -> BurstWatch:
    """What tells bursts from what the vehicle's motion changes."""
    limits = config.odometry.limits
    return BurstWatch(limits.max_speed, math.radians(limits.max_turn_rate))


def scan_of_ping(
    ping: Ping, pose: FusedPose, t_ns: int, config: Config, watch: BurstWatch
) -> Scan | Reject:
    """Take the first surface of each beam out of a ping.

    Args:
        ping: what the sonar heard.
        pose: of the base at its time; of it only attitude and depth count.
        t_ns: that time.
        config: the settings.
        watch: has seen the pings before.

    Returns:
        The scan, or why there is none: `burst`, or as the map would refuse the ping.
    """
    try:
        echo, _ = filter_echo(echo_of(ping, config.sonar), config)
    except MapError as error:
        return Reject(error.reason, str(error))
    return scan_of(echo, _around(ping, pose, t_ns, config), config, watch)


def _around(ping: Ping, pose: FusedPose, t_ns: int, config: Config) -> Surroundings:
    """The surface is at height 0 where a source of depth has been named; the floor is unknown."""
    level_T_sonar = level_T_base(pose.pose.map_q_base) @ mounting(config)  # noqa: N806 frames
    depth_m = None
    if config.odometry.owners.depth not in UNNAMED:
        depth_m = -float(pose.pose.position_m[2]) - float(level_T_sonar[2, 3])
    return Surroundings(t_ns, level_T_sonar, depth_m=depth_m, gamma_byte=ping.gamma)
