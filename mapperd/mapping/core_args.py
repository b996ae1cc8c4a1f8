"""Arguments for the core, and the meaning of its errors."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypedDict

import numpy as np

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.errors import MapError, os_reason
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.io import atomic_file

__all__ = ["Fan", "check_size", "fan_arguments", "load_map", "refusals", "save_map"]

MAX_FAN_VOXELS = 500_000_000
"""Limit of a ping's voxels: more would take gigabytes."""

AT_REST = PingMotion(np.zeros(3), np.zeros(3), 0.0, 1500.0)


class Fan(TypedDict):
    """Arguments that both integrators share."""

    vertical_aperture_rad: float
    min_range_m: float
    motion: _core.PingMotion


def fan_arguments(config: Config, motion: PingMotion | None) -> Fan:
    """Return the arguments that both integrators need besides the ping.

    Raises:
        ValueError: the motion is invalid.
    """
    return {
        "vertical_aperture_rad": math.radians(config.sonar.vertical_aperture),
        "min_range_m": config.filtering.min_range,
        "motion": _core_motion(motion if config.mapping.within_ping_motion else None),
    }


def check_size(echo: PingImage, config: Config) -> None:
    """Refuse a ping whose work, estimated from its geometry alone, is above the limit.

    Raises:
        MapError: its swath holds more voxels than `mapping.max_swath_voxels`.
    """
    resolution_m = config.octree.voxel_resolution
    width = float(echo.bearings_rad[-1] - echo.bearings_rad[0])
    height = 2 * math.sin(math.radians(config.sonar.vertical_aperture) / 2)
    voxels = width * height * (echo.max_range_m / resolution_m) ** 3 / 3
    most = config.mapping.max_swath_voxels
    if not voxels <= most:
        raise MapError(
            f"a swath of {echo.max_range_m:g} m holds {voxels:.2g} voxels of {resolution_m:g} m, "
            f"more than {most:.2g}: set a larger octree.voxel_resolution, or "
            "mapping.max_swath_voxels",
            "fan_too_large",
        )


@contextmanager
def refusals() -> Iterator[None]:
    """Convert the core's refusal of a ping into a `MapError`."""
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


def save_map(core: _core.VoxelMap, path: Path) -> None:
    """Write a map to a file atomically; equal maps give equal files.

    Raises:
        ExportError: the file cannot be written.
    """
    data = core.encode_map()
    with atomic_file(path) as file:
        file.write(data)


def load_map(core: _core.VoxelMap, path: Path) -> None:
    """Replace a map's content by that of a file; an error leaves it unchanged.

    Raises:
        MapError: the file cannot be read (`unreadable`), is not a complete map file, or has
            another resolution, clamps or learning rate (`bad_map_file`).
    """
    magic = _core.MAP_FILE_MAGIC
    try:
        with path.open("rb") as file:
            begin = file.read(len(magic))
            # Do not read a device or a huge file of another kind to its end.
            data = begin + file.read() if begin == magic else begin
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {os_reason(error)}", "unreadable") from error
    try:
        core.load_map(data)
    except ValueError as error:
        raise MapError(f"{path}: {error}", "bad_map_file") from error
