"""Arguments for the core, and the meaning of its errors."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypedDict

import msgspec
import numpy as np

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, MapError, os_reason
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.io import atomic_file

__all__ = [
    "Fan",
    "aperture_rad",
    "arc_params",
    "check_size",
    "core_motion",
    "fan_arguments",
    "fixed_settings",
    "load_map",
    "prior_log_odds",
    "refusals",
    "rule_params",
    "save_map",
]

MAX_FAN_VOXELS = 500_000_000
"""Limit of a ping's voxels: more would take gigabytes."""

AT_REST = PingMotion(np.zeros(3), np.zeros(3), 0.0, 1500.0)


HEARD_BEAM_WIDTHS = 1.5
"""Full aperture that the arc rule hears, in one-way widths of the beam: both ways the pattern falls
to 7 % of its amplitude there."""

ARC_DECAY_RATE, ARC_MIN_ALPHA = 1e-5, 0.999
"""Steps of the arc rule do not shrink with the number of observations."""

ARC_CONSTANTS = (
    "prior",
    "lowest",
    "highest",
    "max_ratio",
    "spread_below",
    "spread_above",
    "broad_share",
    "missed_share",
)


def fixed_settings(config: Config) -> dict[str, Any]:
    """Return the settings, by full name, that cannot change in a map that is there."""
    sections = {"iwlo": config.iwlo, "adaptive": config.adaptive}
    found = {"octree.voxel_resolution": config.octree.voxel_resolution}
    if config.mapping.rule == "arc":
        return {
            **found,
            "mapping.rule": "arc",
            **{f"arc.{name}": getattr(config.arc, name) for name in ARC_CONSTANTS},
        }
    for section, settings in sections.items():
        for name, value in msgspec.to_builtins(settings).items():
            found[f"{section}.{name}"] = value
    return found


def prior_log_odds(config: Config) -> float:
    """Return the log-odds of an unobserved voxel; the core's units are relative to them."""
    return config.arc.prior_log_odds if config.mapping.rule == "arc" else 0.0


def rule_params(config: Config) -> _core.IwloParams:
    """Return the constants of the update rule for the core.

    Raises:
        ConfigError: the core refuses them.
    """
    if config.mapping.rule == "arc":
        return _arc_rule_params(config)
    iwlo, adaptive = config.iwlo, config.adaptive
    with _refused_settings("iwlo"):
        return _core.IwloParams(
            L_occ=iwlo.L_occ,
            L_free=iwlo.L_free,
            L_min=iwlo.L_min,
            L_max=iwlo.L_max,
            sharpness=iwlo.sharpness,
            decay_rate=iwlo.decay_rate,
            min_alpha=iwlo.min_alpha,
            intensity_threshold=config.filtering.intensity_threshold,
            intensity_max=iwlo.intensity_max,
            adaptive_update=adaptive.update,
            adaptive_threshold=adaptive.threshold,
            adaptive_max_ratio=adaptive.max_ratio,
            adaptive_min_ratio=adaptive.min_ratio,
            protect_occupied=adaptive.protect_occupied,
        )


def _arc_rule_params(config: Config) -> _core.IwloParams:
    arc = config.arc
    with _refused_settings("arc"):
        return _core.IwloParams(
            L_free=-arc_params(config).free_step,
            L_min=arc.lowest - arc.prior_log_odds,
            L_max=arc.highest - arc.prior_log_odds,
            decay_rate=ARC_DECAY_RATE,
            min_alpha=ARC_MIN_ALPHA,
            adaptive_max_ratio=arc.max_ratio,
            adaptive_min_ratio=0.0,
            prior=arc.prior_log_odds,
        )


def arc_params(config: Config) -> _core.ArcParams:
    """Return the constants of the arc rule's model for the core."""
    arc = config.arc
    return _core.ArcParams(
        half_aperture_rad=aperture_rad(config) / 2,
        beam_width_rad=math.radians(arc.beam_width),
        spread_below=arc.spread_below,
        spread_above=arc.spread_above,
        broad_share=arc.broad_share,
        missed_share=arc.missed_share,
    )


@contextmanager
def _refused_settings(section: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise ConfigError(f"$.{section}: {error}", f"$.{section}") from error


def aperture_rad(config: Config) -> float:
    """Return the full vertical aperture in which the rule places echoes."""
    if config.mapping.rule == "arc":
        return math.radians(HEARD_BEAM_WIDTHS * config.arc.beam_width)
    return math.radians(config.sonar.vertical_aperture)


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
        "vertical_aperture_rad": aperture_rad(config),
        "min_range_m": config.filtering.min_range,
        "motion": core_motion(motion if config.mapping.within_ping_motion else None),
    }


def check_size(image: PingImage, config: Config) -> None:
    """Refuse a ping whose work, estimated from its geometry alone, is above the limit.

    Raises:
        MapError: its swath holds more voxels than `mapping.max_swath_voxels`.
    """
    resolution_m = config.octree.voxel_resolution
    width = float(image.bearings_rad[-1] - image.bearings_rad[0])
    height = 2 * math.sin(aperture_rad(config) / 2)
    voxels = width * height * (image.max_range_m / resolution_m) ** 3 / 3
    most = config.mapping.max_swath_voxels
    if not voxels <= most:
        raise MapError(
            f"a swath of {image.max_range_m:g} m holds {voxels:.2g} voxels of {resolution_m:g} m, "
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


def core_motion(motion: PingMotion | None) -> _core.PingMotion:
    """Return a motion for the core; None is a sonar at rest."""
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
            another resolution, rule, prior, clamps or learning rate (`bad_map_file`).
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
