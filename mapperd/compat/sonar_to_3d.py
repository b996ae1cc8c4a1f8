"""`SonarTo3DMapper`: images of a sonar and poses of a robot become a 3D map.

Names are those of sonar_3d_reconstruction. The map is a `mapperd.mapping.sonar_map.SonarMap`; with
`use_outofcore` only some of its tiles are in memory.
"""

import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, NotRequired, Self, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.compat.flat_config import config_from_flat
from mapperd.compat.parameters import UPDATES, UpdateHandlers
from mapperd.config.live import with_values
from mapperd.config.paths import MAP_NAME, map_path
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, MapError, StoreError
from mapperd.export.formats import write_map
from mapperd.geometry.frames import rigid_transform
from mapperd.imaging.filter_chain import check_filters, filter_ping_image
from mapperd.imaging.ping_image import MAX_RANGE_M as MAX_RANGE_LIMIT_M
from mapperd.imaging.ping_image import PingImage, ping_image_of_array
from mapperd.imaging.robots import Sighting, Sightings
from mapperd.mapping.queries import MapContent, MapQueries, memory_stats
from mapperd.mapping.sonar_map import PingStats, SonarMap, Voxels
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore

__all__ = ["FrameStats", "PointCloud", "SonarTo3DMapper", "robot_pose"]

LENGTH_TOLERANCE = 1e-3
"""Quaternions come with rounding errors; one further from unit length is a mistake."""


def robot_pose(position: ArrayLike, orientation: ArrayLike) -> NDArray[np.float64]:
    """Transform (4, 4) of a robot; the quaternion is brought to length 1.

    Args:
        position: (3,) metres.
        orientation: (4,) [qx, qy, qz, qw], of unit length within a thousandth.

    Raises:
        MapError: these are no position and no unit quaternion.
    """
    try:
        place = np.asarray(position, dtype=np.float64)
        turn = np.asarray(orientation, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MapError(f"a pose is made of numbers: {error}", "bad_pose") from error
    if place.shape != (3,) or turn.shape != (4,):
        raise MapError("a pose is a position of 3 and a quaternion of 4 numbers", "bad_pose")
    length = float(np.linalg.norm(turn))
    if not (np.isfinite(place).all() and abs(length - 1) <= LENGTH_TOLERANCE):
        raise MapError("a pose is a finite position and a unit quaternion", "bad_pose")
    x, y, z, w = turn / length
    return rigid_transform(place, (w, x, y, z))


Floats = NDArray[np.float64]


MAX_RANGE_M = 10.0
"""Default of `max_range`, as published."""

SECOND_NS = 1_000_000_000
OCCUPIED, FREE = "mapping.occupied_threshold", "mapping.free_threshold"


class FrameStats(TypedDict):
    """What one image did: counts of images, voxels and robots, times in seconds.

    An image that `frame_skip` leaves out is in `frame_count` only. `num_occupied` and `num_free`
    are the voxels that this image gave evidence of either kind, `num_voxels` those that the map
    has observed so far.
    """

    frame_count: int
    processed_count: int
    num_voxels: int
    num_occupied: int
    num_free: int
    num_robots: int
    processing_time: float
    average_processing_time: float


class PointCloud(TypedDict):
    """Voxel centres (N, 3) float64 in metres and probabilities (N,) float32 of occupied voxels.

    `free_points`, `free_probabilities` and `num_free` are there when asked for.
    """

    points: Floats
    probabilities: NDArray[np.float32]
    num_occupied: int
    free_points: NotRequired[Floats]
    free_probabilities: NotRequired[NDArray[np.float32]]
    num_free: NotRequired[int]
    frame_count: int
    processed_count: int


class SonarTo3DMapper(UpdateHandlers):
    """A map that images of a sonar are added to.

    With `use_outofcore` the map is the content of the file `outofcore_map_path`, which `mapperctl`
    also reads; without a path it is temporary. At most `outofcore_cache_size` tiles are in
    memory, and one thread uses the mapper. Its context (`with`) and `close` save.

    With `robot_detection_enabled`, samples are terrain or robots by their brightness: the keys
    `terrain_detection_*` and `robot_detection_*`.

    Args:
        config: sonar_3d_reconstruction's flat keys, such as `voxel_resolution`, listed in
            docs/reference/library.md, and `max_range` in metres. Each key has a default.
        clock: seconds, for the processing times and the age of robots.

    Raises:
        ConfigError: an unknown key, a value that is not allowed, or a filter that is on without
            its library.
        StoreError: the map's file cannot be used, or holds a map of other settings.
    """

    def __init__(
        self,
        config: Mapping[str, Any] | None = None,
        *,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        flat = {"max_range": MAX_RANGE_M} | dict(config or {})
        self.update_max_range(flat.pop("max_range"))
        self._config = config_from_flat(flat)
        check_filters(self._config)
        self._clock = clock
        self._robots = Sightings()
        self._frames = self._processed = 0
        self._seconds = 0.0
        self._map = SonarMap(self._config)
        self._open = ExitStack()
        self._store = self._opened_store() if self._config.outofcore.use else None

    def _opened_store(self) -> TileStore:
        with ExitStack() as opening:
            path = map_path(self._config, {})
            if not self._config.outofcore.map_path:
                folder = tempfile.TemporaryDirectory(prefix="mapperd-")
                path = Path(opening.enter_context(folder)) / MAP_NAME
            settings = self._config.outofcore
            store = TileStore(
                path, self._map, tile_size_m=settings.tile_size, cache_tiles=settings.cache_size
            )
            opening.callback(store.close)
            store.check()
            self._open = opening.pop_all()
        return store

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close, even after an error: the map holds whole images only."""
        self.close()

    def close(self) -> None:
        """Save a map on disk and close its file.

        Raises:
            StoreError: it cannot be saved; the file holds the map of the last save.
        """
        try:
            if self._store is not None:
                self._store.save()
        finally:
            self._store = None
            self._open.close()

    def flush_map(self) -> bool:
        """Write all that changed into the file of a map on disk, durably.

        Returns:
            True; False for a map in memory, which has no file.

        Raises:
            StoreError: it cannot be saved; the map is still in memory.
        """
        if self._store is None:
            return False
        self._store.save()
        self._store.sync()
        return True

    @contextmanager
    def _whole(self) -> Iterator[MapContent]:
        """Open the whole map: it may be larger than memory."""
        if self._store is None:
            yield self._map
            return
        self._store.save()
        with closing(StoredMap(self._store.path, self._config)) as stored:
            if stored.bricks_lost:
                text = f"{self._store.path}: {stored.bricks_lost} bricks are damaged"
                raise StoreError(text, "bricks_lost")
            yield stored

    @property
    def config(self) -> Config:
        """The settings in force."""
        return self._config

    def update(self, changes: Mapping[str, Any]) -> None:
        """Change settings for the images to come, all or none; the map stays.

        A lower `mapping.occupied_threshold` takes `mapping.free_threshold` with it.

        Args:
            changes: values by full name, `filtering.min_range`; settings that are live
                (docs/reference/configuration.md).

        Raises:
            ConfigError: a setting that is unknown or not live, or a value that is not allowed.
        """
        for name in changes:
            if name not in UPDATES:
                raise ConfigError(f"{name}: cannot change in a map that is there", f"$.{name}")
        values = {name: _plain(value) for name, value in changes.items()}
        highest = values.get(OCCUPIED, 1.0)
        if isinstance(highest, int | float):
            values.setdefault(FREE, min(highest, self._config.mapping.free_threshold))
        try:
            config = with_values(self._config, values)
        except ConfigError as error:
            text = str(error).removeprefix(": ").removeprefix("$.").removeprefix(": ")
            raise ConfigError(text, error.path) from error
        check_filters(config)
        self._map.reconfigure(config)
        self._config = config

    def update_max_range(self, value: float | np.floating[Any]) -> None:
        """Set the far edge of the last row, metres, for images that come without `max_range`.

        Raises:
            ConfigError: not above 0, or more than 10 km.
        """
        range_m = _plain(value)
        if not isinstance(range_m, int | float) or not 0 < range_m <= MAX_RANGE_LIMIT_M:
            text = f"max_range: {value!r} is not allowed; allowed: above 0, at most "
            raise ConfigError(f"{text}{MAX_RANGE_LIMIT_M:g} (m)", "max_range")
        self._max_range_m = float(range_m)

    @property
    def robot_detections(self) -> list[Sighting]:
        """Robots of the last `robot_detection_expire_sec` seconds, oldest first.

        Their times are nanoseconds of the clock.
        """
        now_ns = round(self._clock() * SECOND_NS)
        return self._robots.since(now_ns, self._config.robot_detection.expire_sec)

    def process_sonar_image(
        self,
        polar_image: ArrayLike,
        robot_position: ArrayLike,
        robot_orientation: ArrayLike,
        *,
        max_range: float | None = None,
        bearings: ArrayLike | None = None,
    ) -> FrameStats:
        """Add one image; with `frame_skip` N, the first of every N.

        The whole of every beam is used (sonar_3d_reconstruction left out every second beam of 512,
        and free space between its samples).

        Args:
            polar_image: (rows, beams), row 0 nearest, column 0 the most negative bearing; uint8,
                uint16 (scaled from full scale) or float in 0..255.
            robot_position: (3,) metres in the map: x forward or east, y left or north, z up.
            robot_orientation: (4,) unit quaternion [qx, qy, qz, qw] that takes robot coordinates
                (x forward, y left, z up) to map coordinates.
            max_range: metres, far edge of the last row; None for the key `max_range`.
            bearings: (beams,) radians, increasing, positive to starboard; None for beams uniform
                in sine over `horizontal_fov`.

        Raises:
            MapError: the image, pose, range or bearings are invalid or outside the map; its
                `reason` states which. The map is unchanged.
        """
        start = self._clock()
        self._frames += 1
        skipped = (self._frames - 1) % self._config.processing.frame_skip > 0
        occupied = free = robots = 0
        if not skipped:
            range_m = self._max_range_m if max_range is None else max_range
            image = ping_image_of_array(polar_image, range_m, bearings, self._config.sonar)
            map_T_base = robot_pose(robot_position, robot_orientation)  # noqa: N806 frames are named
            changed, robots = self._integrate(image, map_T_base, round(start * SECOND_NS))
            occupied, free = changed.occupied, changed.free
            self._processed += 1
        known = self._map.core.known_count()
        elapsed = 0.0 if skipped else self._clock() - start
        self._seconds += elapsed
        return FrameStats(
            frame_count=self._frames,
            processed_count=self._processed,
            num_voxels=known,
            num_occupied=occupied,
            num_free=free,
            num_robots=robots,
            processing_time=elapsed,
            average_processing_time=self._seconds / max(self._processed, 1),
        )

    def _integrate(
        self,
        image: PingImage,
        map_T_base: Floats,  # noqa: N803 frames are named
        t_ns: int,
    ) -> tuple[PingStats, int]:
        """Filter and add an image; return what changed and the number of robots in it."""
        image, robots = filter_ping_image(image, self._config)
        map_T_sonar = map_T_base @ self._map.base_T_sonar  # noqa: N806 frames are named
        try:
            changed = self._map.integrate(image, map_T_sonar)
        finally:
            if self._store is not None:  # tiles may leave memory as they are now
                self._store.advance(self._store.position)
        self._robots.add(Sighting(t_ns, one.position_m(map_T_sonar), one) for one in robots)
        return changed, len(robots)

    def get_point_cloud(self, include_free: bool = False) -> PointCloud:  # noqa: FBT001, FBT002
        """Occupied voxels, and free ones if asked for (sonar_3d_reconstruction only warned).

        Occupied: above `occupied_threshold`. Free: observed and below `free_threshold`. Points are
        voxel CENTRES (sonar_3d_reconstruction's were the lowest corners).
        """
        with self._whole() as whole:
            occupied = _together(whole.occupied().batches())
            cloud = PointCloud(
                points=occupied.centres_m,
                probabilities=occupied.probability,
                num_occupied=len(occupied),
                frame_count=self._frames,
                processed_count=self._processed,
            )
            if include_free:
                free = _together(self._free(whole))
                cloud["free_points"] = free.centres_m
                cloud["free_probabilities"] = free.probability
                cloud["num_free"] = len(free)
        return cloud

    def _free(self, whole: MapContent) -> Iterator[Voxels]:
        if isinstance(whole, StoredMap):
            yield from whole.free()
        else:
            yield self._map.voxels("free")

    @property
    def queries(self) -> MapQueries:
        """Points, boxes, rays and distances, by the thresholds of the settings.

        Raises:
            MapError: the map is on disk (`in_tiles`).
        """
        self._map.check_whole()
        return MapQueries(
            self._map.core,
            occupied_threshold=self._config.occupied_threshold,
            free_threshold=self._config.free_threshold,
        )

    def merge(self, *others: "SonarTo3DMapper") -> None:
        """Add the evidence of other maps; neither their order nor who takes them matters.

        Log-odds are added, then clamped to L_min..L_max; counts are added up to where they settle.

        Raises:
            ValueError: other resolutions, clamps or learning rates, or the map itself; nothing is
                changed.
            MapError: one of the maps is on disk (`in_tiles`); nothing is changed.
        """
        for one in (self, *others):
            one._map.check_whole()  # noqa: SLF001 same class
        self._map.core.merge(*(other._map.core for other in others))  # noqa: SLF001 same class

    def reset_map(self) -> None:
        """Forget all voxels, also those on disk, robots and counters; the settings stay.

        Raises:
            StoreError: the map's file cannot be written; nothing is changed.
        """
        if self._store is not None:
            self._store.reset()
        else:
            self._map = SonarMap(self._config)
        self._robots = Sightings()
        self._frames = self._processed = 0
        self._seconds = 0.0

    def get_memory_stats(self) -> dict[str, Any]:
        """Fields of `MemoryStats`, with `backend`, `resolution` and `memory_bytes`.

        `backend` is "memory" or "outofcore", where the counts are those of the tiles in memory.
        """
        core = self._map.core
        return {
            "backend": "memory" if self._store is None else "outofcore",
            "resolution": core.resolution_m,
            "memory_bytes": core.memory_bytes,
            **asdict(memory_stats(core)),
        }

    def save_merged_octree(self, filename: str | PathLike[str]) -> bool:
        """Write the map as an OctoMap binary tree (`.bt`), whole or not at all.

        The thresholds of the settings decide the classes (sonar_3d_reconstruction could not save
        this map and saved others with everything above 0.5 as occupied).

        Returns:
            True; failing is an exception.

        Raises:
            MapError: the name ends in something else than `.bt`, or a voxel lies beyond OctoMap's
                reach.
            ExportError: the file cannot be written.
            StoreError: the map's file cannot be used, or is damaged.
        """
        if Path(filename).suffix != ".bt":
            raise MapError(f"{filename}: a name that ends in .bt was expected", "bad_file_name")
        return self.save_map(filename)

    def save_map(self, filename: str | PathLike[str]) -> bool:
        """Write the map as its name ends.

        `.map`: all of it, for `load_map`; `.bt`: OctoMap's classes; `.ot`: OctoMap's log-odds;
        `.ply`: occupied voxels.

        Returns:
            True; failing is an exception.

        Raises:
            MapError: another suffix, or a voxel lies beyond OctoMap's reach.
            ExportError: the file cannot be written.
            StoreError: the map's file cannot be used, or is damaged.
        """
        path = Path(filename)
        if path.suffix not in (".bt", ".ot", ".ply", ".map"):
            raise MapError(f"{path}: .map, .bt, .ot or .ply was expected", "bad_file_name")
        with self._whole() as whole:
            write_map(whole, path)
        return True

    def load_map(self, filename: str | PathLike[str]) -> bool:
        """Replace the map by that of a `.map` file; the counters of images stay.

        Returns:
            True; failing is an exception, and leaves the map as it was.

        Raises:
            MapError: the file cannot be read, is no whole map, or was saved with another
                resolution, other clamps or another learning rate; or this map is on disk.
        """
        self._map.load(filename)
        return True


def _plain(value: object) -> object:
    return value.item() if isinstance(value, np.generic) else value


def _together(batches: Iterable[Voxels]) -> Voxels:
    """Concatenate voxels."""
    some = list(batches)
    if not some:
        return Voxels(np.empty((0, 3)), np.empty(0, np.float32), np.empty(0, np.uint16))
    return Voxels(
        np.concatenate([one.centres_m for one in some]),
        np.concatenate([one.probability for one in some]),
        np.concatenate([one.count for one in some]),
    )
