"""Loads a known map: files of Nav2, of this project, of its store, and of OctoMap."""

import hashlib
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.errors import MapError, StoreError
from mapperd.localization.map_io import read_nav2_map
from mapperd.localization.maps import (
    GridMap,
    LocalizationMap,
    VolumeMap,
    depth_slice,
    keep_boundaries,
    volume_map,
)
from mapperd.mapping.file_headers import settings_of_octomap
from mapperd.mapping.queries import MapQueries
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import StoreReader

__all__ = ["MAX_FILE_BYTES", "MAX_SIDE", "MAX_VOXELS", "KnownMap", "load_known_map"]


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """A loaded map.

    Attributes:
        path: the file.
        sha256: hash of the content; equal for equal maps.
        map: the map for the filter.
    """

    path: str
    sha256: str
    map: LocalizationMap

    @property
    def grid(self) -> GridMap:
        """The planar map, or the slice of the vehicle's band; for pictures."""
        return self.map.grid if isinstance(self.map, VolumeMap) else self.map


Floats = NDArray[np.float64]

MAX_VOXELS = 1 << 26
"""Maximum voxels in the box of a 3D map: distances and likelihoods take 512 MiB."""

MAX_SIDE = 32000
"""Maximum cells along a side of a planar map; the filter's limit."""

MAX_FILE_BYTES = 1 << 30
"""Maximum size of a map in one file."""

SQLITE = b"SQLite format 3\0"

BAND_M = 0.5
"""Height of the band if the settings name none."""


def load_known_map(path: Path, config: Config) -> KnownMap:
    """Load a map by its kind: `.yaml` of Nav2, `.bt`, `.ot`, a store, else `.map`.

    Args:
        path: the file.
        config: `localization.geometry` and `band_*`, thresholds of `mapping`, and for maps with
            voxels the resolution.

    Raises:
        MapError: it cannot be read, is not a map, or is too large; one line.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        grid = read_nav2_map(path)
        known = KnownMap(str(path), _fingerprint(grid), grid)
    else:
        voxels = _voxels_in(path, config)
        known = KnownMap(str(path), voxels.sha256(), _located(voxels, path, config))
    if max(known.grid.occupancy.shape) > MAX_SIDE:
        raise MapError(f"{path}: more than {MAX_SIDE} cells along a side", "too_large")
    return known


def _fingerprint(grid: GridMap) -> str:
    numbers = (grid.resolution_m, grid.origin_x_m, grid.origin_y_m, grid.origin_yaw_rad)
    digest = hashlib.sha256(b"mapperd grid\0")
    digest.update(struct.pack("<4d2q", *numbers, *grid.occupancy.shape))
    digest.update(grid.occupancy.data)
    return digest.hexdigest()


def _voxels_in(path: Path, config: Config) -> SonarMap:
    """Load a whole map with voxels into memory."""
    try:
        if not path.is_file():  # a pipe would block
            raise MapError(f"{path}: there is no such file", "bad_map_file")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise MapError(f"{path}: larger than {MAX_FILE_BYTES} bytes", "bad_map_file")
        with path.open("rb") as file:
            begin = file.read(len(SQLITE))
        if begin == SQLITE:
            sonar_map = SonarMap(config)
            with StoreReader(path) as reader:
                lost = reader.load(sonar_map).lost
            if lost:
                text = f"{path}: {len(lost)} bricks of it are damaged; holes would look like water"
                raise MapError(text, "bricks_lost")
        elif path.suffix.lower() in (".bt", ".ot"):
            sonar_map = _octomap_in(path, config)
        else:
            sonar_map = SonarMap(config)
            sonar_map.load(path)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise MapError(f"{path}: cannot be read: {error}", "bad_map_file") from error
    except StoreError as error:
        raise MapError(str(error), "bad_map_file") from error
    return sonar_map


def _octomap_in(path: Path, config: Config) -> SonarMap:
    data = path.read_bytes()
    try:
        stated = settings_of_octomap(data)
        stated.pop("octree.voxel_resolution", None)  # which must be that of the settings
        sonar_map = SonarMap(with_values(config, stated))
        sonar_map.load_octomap(data)
    except MapError as error:
        raise MapError(f"{path}: {error}", error.reason) from error
    return sonar_map


def _located(sonar_map: SonarMap, path: Path, config: Config) -> LocalizationMap:
    queries = MapQueries(
        sonar_map.core,
        occupied_threshold=sonar_map.config.occupied_threshold,
        free_threshold=sonar_map.config.free_threshold,
    )
    free_m, occupied_m = (sonar_map.voxels(kind).centres_m for kind in ("free", "occupied"))
    if len(occupied_m) == 0:
        raise MapError(f"{path}: nothing in it is occupied", "empty_map")
    half_m = sonar_map.resolution_m / 2
    known_m = np.concatenate([free_m, occupied_m])
    low, high = known_m.min(axis=0) - half_m, known_m.max(axis=0) + half_m
    bottom, top = _band_m(free_m, config, low, high)
    if config.localization.geometry == "2d":
        return depth_slice(queries, np.array([*low[:2], bottom]), np.array([*high[:2], top]))
    _check_size(high - low, sonar_map.resolution_m, path)
    if config.localization.boundaries_only and keep_boundaries(sonar_map) == 0:
        raise MapError(f"{path}: nothing in it is occupied beside free space", "empty_map")
    try:
        reach_m = config.amcl.laser_likelihood_max_dist
        return volume_map(queries, low, high, (bottom, top), reach_m)
    except ValueError as error:
        raise MapError(f"{path}: {error}", "too_large") from error


def _band_m(free_m: Floats, config: Config, low: Floats, high: Floats) -> tuple[float, float]:
    """Return the band of heights of the vehicle: as set, else around the most free voxels."""
    ours = config.localization
    if ours.band_low < ours.band_high:
        return ours.band_low, ours.band_high
    if len(free_m) == 0:
        return float(low[2]), float(high[2])
    heights, counts = np.unique(free_m[:, 2], return_counts=True)
    middle_m = float(heights[counts.argmax()])
    return middle_m - BAND_M / 2, middle_m + BAND_M / 2


def _check_size(size_m: Floats, resolution_m: float, path: Path) -> None:
    voxels = float(np.prod(np.ceil(size_m / resolution_m)))
    if voxels > MAX_VOXELS:
        sides = " x ".join(f"{side:.0f}" for side in size_m)
        raise MapError(
            f"{path}: {sides} m are {voxels:.2g} voxels of {resolution_m:g} m, at most "
            f"{MAX_VOXELS:.2g} can be localized on: set localization.geometry 2d, or take a map "
            "of larger voxels",
            "too_large",
        )
