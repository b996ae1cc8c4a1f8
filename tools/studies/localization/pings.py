"""Scans of a dive from its simulated pings."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from sonar_sim import Pose, Simulator
from sonar_sim.poses import quaternion_of, rotation_of

from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.imaging.ping_image import ping_image_of_array
from mapperd.localization.extraction import Surroundings, scan_of
from mapperd.localization.levelling import level_T_base
from mapperd.localization.scan import Scan
from studies.localization.world import World

__all__ = ["ping_scans"]

Floats = NDArray[np.float64]


def ping_scans(world: World, config: Config, seed: int) -> Callable[[int, Floats, int], Scan]:
    """What makes the scan of a ping's number, place (6,) and stamp; some 0.2 s of one core each."""
    sonar = world.scenario.sonar
    simulator = Simulator(world.scenario.scene, sonar, seed)
    sines = np.linspace(-1.0, 1.0, sonar.beams) * math.sin(sonar.half_aperture_rad)
    bearing = np.arcsin(sines)

    def scan(number: int, place: Floats, stamp_ns: int) -> Scan:
        pose = Pose(place[:3], rotation_of(*place[3:]))
        ping = simulator.ping(pose, number)
        echo = ping_image_of_array(ping.image, sonar.range_m, bearing, config.sonar)
        around = Surroundings(
            stamp_ns,
            level_T_base(quaternion_of(pose.rotation)),
            height_m=float(place[2]) - world.place.floor_m,
            depth_m=-float(place[2]),
            gamma_byte=sonar.gamma_byte,
        )
        made = scan_of(echo, around, config)
        if isinstance(made, Reject):
            raise TypeError("nobody watches for bursts here")
        return made

    return scan
