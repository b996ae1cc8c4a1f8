"""What the core is told of a ping beside its image, and what it says of one that it refuses."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypedDict

import numpy as np

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import Echo

__all__ = ["Fan", "check_size", "fan_arguments", "refusals"]

MAX_FAN_VOXELS = 500_000_000
"""A fan with more voxels than this would take gigabytes for a single ping."""

AT_REST = PingMotion(np.zeros(3), np.zeros(3), 0.0, 1500.0)


class Fan(TypedDict):
    """Arguments that both integrators share."""

    vertical_aperture_rad: float
    min_range_m: float
    motion: _core.PingMotion


def fan_arguments(config: Config, motion: PingMotion | None) -> Fan:
    """What both integrators want to know beside the ping.

    Raises:
        ValueError: the motion is none.
    """
    return {
        "vertical_aperture_rad": math.radians(config.sonar.vertical_aperture),
        "min_range_m": config.filtering.min_range,
        "motion": _core_motion(motion if config.mapping.within_ping_motion else None),
    }


def check_size(echo: Echo, config: Config) -> None:
    """Refuse what would exhaust the machine: a range that no sonar has, or tiny voxels.

    Raises:
        MapError: the fan holds too many voxels to be meant.
    """
    resolution_m = config.octree.voxel_resolution
    width = float(echo.bearings_rad[-1] - echo.bearings_rad[0])
    height = 2 * math.sin(math.radians(config.sonar.vertical_aperture) / 2)
    volume_m3 = width * height * echo.max_range_m**3 / 3
    if not volume_m3 <= MAX_FAN_VOXELS * resolution_m**3:
        raise MapError(
            f"a fan of {echo.max_range_m:g} m holds over {MAX_FAN_VOXELS:.0e} voxels of "
            f"{resolution_m:g} m: set a larger octree.voxel_resolution",
            "fan_too_large",
        )


@contextmanager
def refusals() -> Iterator[None]:
    """Turn what the core says of a ping that it refuses into ours."""
    try:
        yield
    except (ValueError, IndexError, OverflowError) as error:
        raise MapError(str(error), "refused_by_map") from error


def _core_motion(motion: PingMotion | None) -> _core.PingMotion:
    if motion is None:
        motion = AT_REST
    return _core.PingMotion(
        linear_mps=np.ascontiguousarray(motion.linear_mps, dtype=np.float64),
        angular_radps=np.ascontiguousarray(motion.angular_radps, dtype=np.float64),
        valid_s=motion.valid_s,
        speed_of_sound_mps=motion.speed_of_sound_mps,
    )
