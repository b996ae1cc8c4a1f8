"""The map: a thin public wrapper over the C++ core, built from the settings."""

import hashlib
import math
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, MapError
from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.io import atomic_file
from mapperd.mapping.arc import ArcIntegrator, SurfaceLevel
from mapperd.mapping.core_args import (
    check_size,
    fan_arguments,
    fixed_settings,
    load_map,
    prior_log_odds,
    refusals,
    rule_params,
    save_map,
)
from mapperd.mapping.file_headers import octomap_with_rule, settings_of_octomap
from mapperd.mapping.ping_log import PingLog

__all__ = [
    "BLOCK_VOXELS",
    "BRICK_VOXELS",
    "MapCounts",
    "PingStats",
    "SonarMap",
    "Voxels",
    "fingerprint",
    "mounting",
]

PingStats = _core.PingStats
"""Numbers of voxels that one ping changed."""

BLOCK_VOXELS = _core.BLOCK_EDGE
"""Voxels along the edge of a block, the unit of memory."""

BRICK_VOXELS = _core.BRICK_VOXELS
"""Voxels along the edge of a brick, the unit of the map's file."""

HASH_VERSION = 2
"""Version of the fingerprint's input; part of the fingerprint."""

BLOCKS_AT_ONCE = 1024

BLOCKS_OF_A_BATCH = 64
"""Blocks whose voxels are listed at once: at 12 bytes a voxel of a block and 100 of a listed one,
30 MB at most."""

OCTOMAP_HEADER_BYTES = 4096

OCTOMAP_REACH_VOXELS = 32768
"""Range of OctoMap's 16-bit keys in voxels, to each side of the origin."""

Floats = NDArray[np.float64]

Key = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Voxels:
    """Some voxels of a map, in the map's fixed order.

    Attributes:
        centres_m: (N, 3) float64, map frame.
        probability: (N,) float32, probability of being occupied.
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
        """Yield all voxels at once."""
        yield self


@dataclass(frozen=True, slots=True)
class MapCounts:
    """Observed voxels by class."""

    occupied: int
    free: int
    uncertain: int


class SonarMap:
    """A 3D occupancy map that sonar pings are integrated into.

    If a `TileStore` keeps it on disk, voxels and counts cover only the tiles in memory.

    Args:
        config: the settings.

    Raises:
        ConfigError: the core refuses constants of the rule.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self._map = _core.VoxelMap(config.octree.voxel_resolution, rule_params(config))
        self._arc = ArcIntegrator(config) if config.mapping.rule == "arc" else None
        self._base_T_sonar = mounting(config)

    def reconfigure(self, config: Config) -> None:
        """Use other settings for the next pings; no other thread may integrate meanwhile.

        Raises:
            ConfigError: they change the grid, the rule or its constants. The old settings stay.
        """
        if config.mapping.rule != self.config.mapping.rule:
            path = "$.mapping.rule"
            raise ConfigError(f"{path}: cannot change in a map that is there", path)
        before, after = fixed_settings(self.config), fixed_settings(config)
        for name in before:
            if before[name] != after[name]:
                path = f"$.{name.partition('.')[0]}"
                raise ConfigError(f"{path}: cannot change in a map that is there", path)
        if self._arc is not None:
            self._arc.reconfigure(config)
        self._map.set_intensity_threshold(config.filtering.intensity_threshold)
        self._base_T_sonar = mounting(config)
        self.config = config

    def start_session(self) -> None:
        """Forget what was learnt of an earlier session's sonar; the voxels stay."""
        if self._arc is not None:
            log, self._arc = self._arc.log, ArcIntegrator(self.config)
            self._arc.log = log

    def clear(self) -> None:
        """Empty the map."""
        self._map.clear()
        if self._arc is not None and self._arc.log is not None:
            self._arc.log.clear()

    def keep_pings(self, folder: Path) -> None:
        """Keep the pings from here on in a temporary file of a folder, for `refine`.

        Raises:
            ConfigError: the map does not follow the arc rule.
            ExportError: the file cannot be made; `integrate` raises it if it cannot be written.
        """
        if self._arc is None:
            path = "$.mapping.rule"
            raise ConfigError(f"{path}: only a map of the rule arc can be refined", path)
        self._arc.log = PingLog(folder)

    @property
    def kept_pings(self) -> int:
        """Number of pings that `refine` will integrate again."""
        return 0 if self._arc is None or self._arc.log is None else len(self._arc.log)

    def refine(self) -> Iterator[int]:
        """Integrate the echoes of all kept pings once more, the last ping first.

        When the pings were integrated, the map did not hold the later ones, and early echoes were
        spread over their arcs. Now each is explained by all other pings. Afterwards `integrate`
        continues as before, and the log is empty.

        Yields:
            the number of pings done, after each.

        Raises:
            ExportError: the temporary file cannot be read.
        """
        if self._arc is not None:
            for done, _ in enumerate(self._arc.refine(self._map), start=1):
                yield done

    @property
    def surface(self) -> SurfaceLevel | None:
        """Level of surfaces in this session, which the arc rule estimates; None by IWLO."""
        return None if self._arc is None else self._arc.surface

    def rule_facts(self) -> dict[str, Any]:
        """Return `rule` and, of the arc rule, `surface_level` and `surface_returns`.

        The first returns that the level rests on are None where the settings set it.
        """
        if self._arc is None:
            return {"rule": "iwlo"}
        returns = self._arc.surface.returns if self.config.arc.level == 0 else None
        return {"rule": "arc", "surface_level": self._arc.level, "surface_returns": returns}

    @property
    def core(self) -> _core.VoxelMap:
        """The core's map of voxels, for access without a ping."""
        return self._map

    @property
    def resolution_m(self) -> float:
        """Edge of a voxel."""
        return self._map.resolution_m

    @property
    def memory_bytes(self) -> int:
        """Memory of the voxels."""
        return self._map.memory_bytes

    @property
    def base_T_sonar(self) -> Floats:  # noqa: N802 frames are named
        """(4, 4) rigid transform of the mounting."""
        return self._base_T_sonar.copy()

    @property
    def octomap_reach_m(self) -> float:
        """Maximum distance of a voxel from the origin along each axis for `octomap_bt`."""
        return OCTOMAP_REACH_VOXELS * self.resolution_m

    def integrate(
        self,
        image: PingImage,
        map_T_sonar: Floats,  # noqa: N803 frames are named
        motion: PingMotion | None = None,
    ) -> PingStats:
        """Integrate one ping with the rule and the integrator of the settings.

        Args:
            image: the ping's intensities and geometry.
            map_T_sonar: (4, 4) rigid transform of the sonar at the ping's time.
            motion: motion of the sonar during the ping, ignored without
                `mapping.within_ping_motion`; None is a sonar at rest.

        Raises:
            MapError: the geometry is invalid, the fan has too many voxels, the pose is out of the
                map's range, or the motion is impossible (faster than a fiftieth of the speed of
                sound, or more than a radian in one ping). The map is unchanged.
        """
        self.skip(image)
        check_size(image, self.config)
        settings = self.config.mapping
        if self._arc is not None:
            with refusals():
                return self._arc.integrate(self._map, image, map_T_sonar, motion)
        ping = (image.intensity, image.bearings_rad, image.range_resolution_m, map_T_sonar)
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

    def skip(self, image: PingImage) -> None:
        """Learn what a ping tells of the session's sonar; `integrate` does it for its own pings.

        Args:
            image: a ping that is in the map already, or refused by it.
        """
        if self._arc is not None:
            self._arc.add_returns(image)

    def blocks_of(
        self,
        image: PingImage,
        map_T_sonar: Floats,  # noqa: N803 frames are named
        motion: PingMotion | None = None,
    ) -> tuple[Key, Key] | None:
        """Return the box that `integrate` may change, first and last block, from the geometry.

        Returns:
            the box in blocks of `BLOCK_VOXELS` voxels an edge; None for a ping without evidence.

        Raises:
            MapError: as `integrate`, for the same pings.
        """
        check_size(image, self.config)
        settings = self.config.mapping
        with refusals():
            return self._map.blocks_of_ping(
                image.intensity,
                image.bearings_rad,
                image.range_resolution_m,
                map_T_sonar,
                **fan_arguments(self.config, motion),
                carve_no_return=self._arc is not None
                or (settings.integrator != "rays" and settings.carve_no_return),
            )

    def voxels(self, kind: Literal["occupied", "free"]) -> Voxels:
        """Return the observed voxels of one class.

        Occupied: above `Config.occupied_threshold`. Free: below `Config.free_threshold`.
        """
        limits = (
            {"min_log_odds": self._occupied_log_odds}
            if kind == "occupied"
            else {"max_log_odds": self._free_log_odds}
        )
        centres, log_odds, count = self._map.voxels(**limits)
        probability = 1 / (1 + np.exp(-log_odds.astype(np.float64)))
        return Voxels(centres, probability.astype(np.float32), count)

    def voxel_batches(self, kind: Literal["occupied", "free"]) -> Iterator[Voxels]:
        """Yield the voxels of `voxels`, in its order, few at a time; nobody may write meanwhile."""
        low, high = (
            (self._occupied_log_odds, math.inf)
            if kind == "occupied"
            else (-math.inf, self._free_log_odds)
        )
        prior = prior_log_odds(self.config)
        for begin in range(0, self._map.block_count, BLOCKS_OF_A_BATCH):
            keys, units, count = self._map.blocks(begin, BLOCKS_OF_A_BATCH)
            log_odds = units * _core.LOG_ODDS_UNIT + prior
            block, voxel = np.nonzero((count > 0) & (log_odds > low) & (log_odds < high))
            places = np.stack(np.unravel_index(voxel, 3 * (BLOCK_VOXELS,))[::-1], axis=1)
            places += keys[block].astype(np.int64) * BLOCK_VOXELS
            probability = 1 / (1 + np.exp(-log_odds[block, voxel]))
            centres: Floats = np.multiply(places + 0.5, self.resolution_m, dtype=np.float64)
            yield Voxels(centres, probability.astype(np.float32), count[block, voxel])

    def occupied(self) -> Voxels:
        """Return the occupied voxels."""
        return self.voxels("occupied")

    def counts(self) -> MapCounts:
        """Observed voxels by class."""
        return MapCounts(*self._map.class_counts(self._occupied_log_odds, self._free_log_odds))

    def sha256(self) -> str:
        """Return the fingerprint of the content; equal maps have equal ones on every machine.

        The hash runs over a header (name, version, resolution) and, for every block with an
        observed voxel in order of its key: key as int32, log-odds less the prior in units of 2**-24
        as int32, counts as uint16, all little endian; unobserved voxels are zeros. No other thread
        may change the map meanwhile.

        Raises:
            MapError: the map is in tiles (`in_tiles`); this also holds for the files below.
        """
        self.check_whole()
        return fingerprint([self._map], self.resolution_m)

    def parts(self) -> Iterator[_core.VoxelMap]:
        """Yield a copy of the map, for slow readers."""
        self.check_whole()
        yield self._map.with_rule(rule_params(self.config))

    @property
    def bricks_lost(self) -> int:
        """Always 0; only files can be damaged."""
        return 0

    def close(self) -> None:
        """Forget the pings that were kept for `refine`."""
        if self._arc is not None and self._arc.log is not None:
            self._arc.log.close()
            self._arc.log = None

    def save(self, path: str | PathLike[str]) -> None:
        """Write the map to a file (`.map`), atomically and without loss.

        Equal maps give equal files.

        Raises:
            ExportError: the file cannot be written.
        """
        self.check_whole()
        save_map(self._map, Path(path))

    def load(self, path: str | PathLike[str]) -> None:
        """Replace the content by that of a file of `save`; further pings give the same map.

        Raises:
            MapError: the file cannot be read, is damaged, or was saved with another resolution,
                rule or prior, other clamps or another learning rate. The map is unchanged.
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
        """Return the map as an OctoMap binary tree with classes by the settings' thresholds.

        Raises:
            MapError: a voxel lies farther than `octomap_reach_m` from the origin.
        """
        self.check_whole()
        try:
            data = self._map.octomap_bt(self._occupied_log_odds, self._free_log_odds)
        except (ValueError, IndexError, OverflowError) as error:
            raise MapError(str(error), "out_of_reach") from error
        return octomap_with_rule(data, self.config)

    def octomap_ot(self) -> bytes:
        """Return the map as a full OctoMap tree: log-odds of all observed voxels, without counts.

        Raises:
            MapError: a voxel lies outside OctoMap's range of 32768 voxels from the origin.
        """
        self.check_whole()
        try:
            data = self._map.octomap_ot()
        except IndexError as error:
            raise MapError(str(error), "out_of_reach") from error
        return octomap_with_rule(data, self.config)

    def load_octomap(self, data: bytes) -> None:
        """Replace the map's content by that of an OctoMap file, `.bt` or `.ot`.

        The file has no counts: they become 1. A `.bt` has classes only: free becomes log-odds -2
        and occupied 3.5 (probabilities 0.12 and 0.97); more extreme thresholds make them unknown.

        Raises:
            MapError: not a complete tree of this map's resolution and rule, or too large; the text
                states the cause and the byte. The map is unchanged.
        """
        self.check_whole()
        stated, settings = settings_of_octomap(data[:OCTOMAP_HEADER_BYTES]), self.config
        if stated["mapping.rule"] != settings.mapping.rule or (
            stated.get("arc.prior", settings.arc.prior) != settings.arc.prior
        ):
            text = "OctoMap file: it is of another mapping.rule or arc.prior than the map"
            raise MapError(text, "bad_octomap_file")
        try:
            self._map.load_octomap(data)
        except ValueError as error:
            raise MapError(str(error), "bad_octomap_file") from error

    @property
    def _occupied_log_odds(self) -> float:
        return _log_odds(self.config.occupied_threshold)

    @property
    def _free_log_odds(self) -> float:
        return _log_odds(self.config.free_threshold)

    def check_whole(self) -> None:
        """Refuse if only a part is in memory; `mapperd.store.stored_map` reads the whole.

        Raises:
            MapError: the map is in tiles (`in_tiles`).
        """
        if self._map.is_in_tiles:
            raise MapError("the map is in tiles: read it from its file", "in_tiles")


def fingerprint(parts: Iterable[_core.VoxelMap], resolution_m: float) -> str:
    """Return `SonarMap.sha256` of a map.

    Args:
        parts: disjoint parts of the map in its fixed order.
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


def mounting(config: Config) -> Floats:
    """Return `base_T_sonar` of the settings, (4, 4) rigid transform."""
    position, angles = config.mounting.position, config.mounting.orientation
    pose = pose_from_rpy(
        (position.x, position.y, position.z), (angles.roll, angles.pitch, angles.yaw)
    )
    return pose.map_T_base


def _log_odds(probability: float) -> float:
    return math.log(probability / (1 - probability))
