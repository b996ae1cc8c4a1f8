"""The map: a thin public wrapper over the C++ core, built from the settings."""

import hashlib
import math
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, MapError
from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.io import atomic_file
from mapperd.mapping.core_args import check_size, fan_arguments, load_map, refusals, save_map

__all__ = [
    "BLOCK_VOXELS",
    "BRICK_VOXELS",
    "MapCounts",
    "PingStats",
    "SonarMap",
    "Voxels",
    "fingerprint",
    "iwlo_params",
    "mounting",
]

PingStats = _core.PingStats
"""What one ping changed, in voxels."""

BLOCK_VOXELS = _core.BLOCK_EDGE
"""Voxels along the edge of a block, the least that the map keeps as one."""

BRICK_VOXELS = _core.BRICK_VOXELS
"""Voxels along the edge of a brick, the least that its file keeps as one."""

HASH_VERSION = 2
"""Part of the fingerprint: another layout of its input is another version."""

BLOCKS_AT_ONCE = 1024

OCTOMAP_REACH_VOXELS = 32768
"""OctoMap numbers voxels with 16 bits, the origin in the middle."""

Floats = NDArray[np.float64]

Key = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Voxels:
    """Some voxels of a map, in the map's fixed order.

    Attributes:
        centres_m: (N, 3) float64, map frame.
        probability: (N,) float32, of being occupied.
        count: (N,) uint16, number of pings that observed it (saturates).
    """

    centres_m: Floats
    probability: NDArray[np.float32]
    count: NDArray[np.uint16]

    def __len__(self) -> int:
        return len(self.count)

    @property
    def box_m(self) -> Floats:
        """(2, 3) float64, lowest and highest centre; zeros without voxels."""
        centres_m = self.centres_m if len(self) else np.zeros((1, 3))
        return np.stack([centres_m.min(axis=0), centres_m.max(axis=0)])

    def batches(self) -> Iterator[Self]:
        """Yield all of them at once."""
        yield self


@dataclass(frozen=True, slots=True)
class MapCounts:
    """Observed voxels by class."""

    occupied: int
    free: int
    uncertain: int


class SonarMap:
    """A 3D occupancy map that sonar pings are integrated into.

    Where a `TileStore` keeps it on disk, voxels and counts are those of the tiles in memory.

    Args:
        config: the settings; the map keeps them.

    Raises:
        ConfigError: the core refuses the rule's constants.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self._map = _core.VoxelMap(config.octree.voxel_resolution, iwlo_params(config))
        self._base_T_sonar = mounting(config)

    def reconfigure(self, config: Config) -> None:
        """Take other settings for the pings to come; nobody integrates meanwhile.

        Raises:
            ConfigError: they are for another map: of another grid or another rule, the intensity
                threshold aside. The settings are as before.
        """
        for section in ("octree", "iwlo", "adaptive"):
            if getattr(config, section) != getattr(self.config, section):
                path = f"$.{section}"
                raise ConfigError(f"{path}: cannot change in a map that is there", path)
        self._map.set_intensity_threshold(config.filtering.intensity_threshold)
        self._base_T_sonar = mounting(config)
        self.config = config

    @property
    def core(self) -> _core.VoxelMap:
        """The one store of voxels, for what reads or writes it without a ping."""
        return self._map

    @property
    def resolution_m(self) -> float:
        """Edge of a voxel."""
        return self._map.resolution_m

    @property
    def memory_bytes(self) -> int:
        """Memory that the voxels take."""
        return self._map.memory_bytes

    @property
    def base_T_sonar(self) -> Floats:  # noqa: N802 frames are named
        """(4, 4) rigid transform of the mounting."""
        return self._base_T_sonar.copy()

    @property
    def octomap_reach_m(self) -> float:
        """How far from the origin, along each axis, a voxel may lie for `octomap_bt`."""
        return OCTOMAP_REACH_VOXELS * self.resolution_m

    def integrate(
        self,
        echo: PingImage,
        map_T_sonar: Floats,  # noqa: N803 frames are named
        motion: PingMotion | None = None,
    ) -> PingStats:
        """Add one ping's evidence with the integrator of the settings.

        Args:
            echo: the ping's intensities and geometry.
            map_T_sonar: (4, 4) rigid transform of the sonar at the ping's time.
            motion: of the sonar during the ping, which `mapping.within_ping_motion` may leave
                out; None is a sonar at rest.

        Raises:
            MapError: the geometry is not a ping's, the fan holds too many voxels to be meant, the
                pose leaves the map's reach, or the sonar cannot move so (faster than a fiftieth of
                sound, by more than a radian in one ping). The map is as before.
        """
        check_size(echo, self.config)
        settings = self.config.mapping
        ping = (echo.intensity, echo.bearings_rad, echo.range_resolution_m, map_T_sonar)
        with refusals():
            if settings.integrator == "rays":
                return self._map.integrate_rays(
                    *ping,
                    **fan_arguments(self.config, motion),
                    angular_cone_width=settings.angular_cone_width,
                )
            return self._map.integrate_evidence_grid(
                *ping,
                **fan_arguments(self.config, motion),
                carve_no_return=settings.carve_no_return,
                aggregation=settings.aggregation,
                detail=settings.detail,
                threads=settings.threads,
            )

    def blocks_of(
        self,
        echo: PingImage,
        map_T_sonar: Floats,  # noqa: N803 frames are named
        motion: PingMotion | None = None,
    ) -> tuple[Key, Key] | None:
        """Where `integrate` may change anything: a box, first and last block, from geometry alone.

        Returns:
            the box in blocks of `BLOCK_VOXELS` voxels an edge; None for a ping without evidence.

        Raises:
            MapError: as `integrate`, for the same pings.
        """
        check_size(echo, self.config)
        settings = self.config.mapping
        with refusals():
            return self._map.blocks_of_ping(
                echo.intensity,
                echo.bearings_rad,
                echo.range_resolution_m,
                map_T_sonar,
                **fan_arguments(self.config, motion),
                carve_no_return=settings.integrator != "rays" and settings.carve_no_return,
            )

    def voxels(self, kind: Literal["occupied", "free"]) -> Voxels:
        """Observed voxels of one class.

        Occupied: above `mapping.occupied_threshold`. Free: below `mapping.free_threshold`.
        """
        limits = (
            {"min_log_odds": self._occupied_log_odds}
            if kind == "occupied"
            else {"max_log_odds": self._free_log_odds}
        )
        centres, log_odds, count = self._map.voxels(**limits)
        probability = 1 / (1 + np.exp(-log_odds.astype(np.float64)))
        return Voxels(centres, probability.astype(np.float32), count)

    def occupied(self) -> Voxels:
        """Return the occupied voxels."""
        return self.voxels("occupied")

    def counts(self) -> MapCounts:
        """Observed voxels by class."""
        return MapCounts(*self._map.class_counts(self._occupied_log_odds, self._free_log_odds))

    def sha256(self) -> str:
        """Fingerprint of the content: equal maps have equal ones, on every machine.

        The hash runs over a header (name, version, resolution) and, for every block with an
        observed voxel in order of its key: key as int32, log-odds in units of 2**-24 as int32,
        counts as uint16, all little endian; unobserved voxels are zeros. Nobody writes to the map
        meanwhile.

        Raises:
            MapError: the map is in tiles (`in_tiles`), as are the files below.
        """
        self.check_whole()
        return fingerprint([self._map], self.resolution_m)

    def parts(self) -> Iterator[_core.VoxelMap]:
        """Yield a copy of the map, for what takes long to read."""
        self.check_whole()
        yield self._map.with_rule(iwlo_params(self.config))

    @property
    def bricks_lost(self) -> int:
        """Always 0: damage is found in files."""
        return 0

    def close(self) -> None:
        """Do nothing: there is no file."""

    def save(self, path: str | PathLike[str]) -> None:
        """Write the map into a file, without loss, whole or not at all; `.map` is customary.

        Equal maps give equal files.

        Raises:
            ExportError: the file cannot be written.
        """
        self.check_whole()
        save_map(self._map, Path(path))

    def load(self, path: str | PathLike[str]) -> None:
        """Replace the content by that of a file of `save`; it goes on as the saved map would have.

        Raises:
            MapError: the file cannot be read, is damaged, or was saved with another resolution,
                other clamps or another learning rate. The map is as before.
        """
        self.check_whole()
        load_map(self._map, Path(path))

    def save_octomap(self, path: Path) -> None:
        """Write OctoMap's tree: `.bt` with classes by the thresholds, `.ot` with log-odds.

        Raises:
            MapError: a voxel lies farther than `octomap_reach_m` from the origin.
            ExportError: the file cannot be written.
        """
        data = self.octomap_bt() if path.suffix == ".bt" else self.octomap_ot()
        with atomic_file(path) as file:
            file.write(data)

    def octomap_bt(self) -> bytes:
        """The map as an OctoMap binary tree, classes by the thresholds of the settings.

        Raises:
            MapError: a voxel lies farther than `octomap_reach_m` from the origin.
        """
        self.check_whole()
        try:
            return self._map.octomap_bt(self._occupied_log_odds, self._free_log_odds)
        except (ValueError, IndexError, OverflowError) as error:
            raise MapError(str(error), "out_of_reach") from error

    def octomap_ot(self) -> bytes:
        """The map as a full OctoMap tree: log-odds of all observed voxels, without counts.

        Raises:
            MapError: a voxel lies outside OctoMap's reach of 32768 voxels from the origin.
        """
        self.check_whole()
        try:
            return self._map.octomap_ot()
        except IndexError as error:
            raise MapError(str(error), "out_of_reach") from error

    def load_octomap(self, data: bytes) -> None:
        """Replace the map's content by that of an OctoMap file, `.bt` or `.ot`.

        The file does not know how often a voxel was observed: counts become 1. A `.bt` has classes
        only; free becomes log-odds -2 and occupied 3.5 (probabilities 0.12 and 0.97), which
        thresholds further out would call uncertain.

        Raises:
            MapError: not a whole tree of this map's resolution, or one too large; the text states
                what and at which byte. The map is as before.
        """
        self.check_whole()
        try:
            self._map.load_octomap(data)
        except ValueError as error:
            raise MapError(str(error), "bad_octomap_file") from error

    @property
    def _occupied_log_odds(self) -> float:
        return _log_odds(self.config.mapping.occupied_threshold)

    @property
    def _free_log_odds(self) -> float:
        return _log_odds(self.config.mapping.free_threshold)

    def check_whole(self) -> None:
        """Refuse to take a part for the whole; `mapperd.store.stored_map` has the whole.

        Raises:
            MapError: the map is in tiles (`in_tiles`).
        """
        if self._map.is_in_tiles:
            raise MapError("the map is in tiles: read it from its file", "in_tiles")


def fingerprint(parts: Iterable[_core.VoxelMap], resolution_m: float) -> str:
    """Return `SonarMap.sha256` of a map.

    Args:
        parts: of the map, in its fixed order, without common blocks.
        resolution_m: edge of a voxel.
    """
    digest = hashlib.sha256(b"mapperd map\0")
    digest.update(struct.pack("<Id", HASH_VERSION, resolution_m))

    def add(keys: NDArray[np.int32], units: NDArray[np.int32], count: NDArray[np.uint16]) -> None:
        for i in np.flatnonzero((count > 0).any(axis=1)):
            known = np.where(count[i] > 0, units[i], 0)
            for array, kind in ((keys[i], "<i4"), (known, "<i4"), (count[i], "<u2")):
                digest.update(np.ascontiguousarray(array, dtype=kind).data)

    for part in parts:
        part.visit_blocks(add, BLOCKS_AT_ONCE)
    return digest.hexdigest()


def iwlo_params(config: Config) -> _core.IwloParams:
    """The update rule's constants for the core.

    Raises:
        ConfigError: the core refuses them.
    """
    iwlo, adaptive = config.iwlo, config.adaptive
    try:
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
    except ValueError as error:
        raise ConfigError(f"$.iwlo: {error}", "$.iwlo") from error


def mounting(config: Config) -> Floats:
    """`base_T_sonar` of the settings, (4, 4) rigid transform."""
    position, angles = config.mounting.position, config.mounting.orientation
    pose = pose_from_rpy(
        (position.x, position.y, position.z), (angles.roll, angles.pitch, angles.yaw)
    )
    return pose.map_T_base


def _log_odds(probability: float) -> float:
    return math.log(probability / (1 - probability))
