"""Assigns pings to tiles and maps the tiles.

Tiles do not affect the map. A tile that exceeds a worker's memory is cut in eight.
"""

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mapper_survey.engine import Engine
from mapper_survey.errors import SurveyError
from mapper_survey.fingerprint import digest_of, program_digest
from mapper_survey.folder import Folder, mark, marked, scratch
from mapper_survey.planning import DivePlan, mark_name, spool_name
from mapper_survey.spool import Record, RecordReader, Rows
from mapperd.config.tree import Config
from mapperd.errors import MapperdError
from mapperd.mapping.sonar_map import BLOCK_VOXELS, BRICK_VOXELS, SonarMap
from mapperd.store.maintenance import packed, write_whole

__all__ = [
    "PLACE",
    "Key",
    "Scope",
    "SpooledDive",
    "Tile",
    "TileResult",
    "TileStage",
    "TileTask",
    "children_of",
    "map_tile",
    "ordinals_of",
    "shard_mark",
    "tiles_of",
]


Key = tuple[int, int, int]

PLACE = np.dtype([("ordinal", "<i8"), ("dive", "<i4"), ("size", "<i4"), ("offset", "<i8")])
"""Ping of a tile: its number in the survey, from 1, and the position of its record."""

BLOCKS = BRICK_VOXELS // BLOCK_VOXELS
"""Blocks along a brick's edge."""


@dataclass(frozen=True, slots=True)
class Tile:
    """A cube of bricks: `key` in units of its edge, `edge` in bricks."""

    key: Key
    edge: int

    @property
    def name(self) -> str:
        """Unique name of the tile."""
        return f"{self.key[0]}_{self.key[1]}_{self.key[2]}_{self.edge}"

    def children(self) -> list["Tile"]:
        """Return the eight tiles of half its edge; none if its edge is odd."""
        if self.edge % 2:
            return []
        steps = itertools.product((0, 1), repeat=3)
        x, y, z = self.key
        return [Tile((2 * x + i, 2 * y + j, 2 * z + k), self.edge // 2) for i, j, k in steps]


def ordinals_of(dives: Sequence[Rows]) -> list[NDArray[np.int64]]:
    """Number all pings by time, from 1.

    Within a dive they keep their order, whatever its clock did; a ping without a time follows the
    one before it. At equal times the dive named first comes first.
    """
    times = [np.maximum.accumulate(rows["t_ns"]) if len(rows) else rows["t_ns"] for rows in dives]
    together = np.concatenate(times)
    order = np.argsort(together, kind="stable")
    ordinals = np.empty(len(together), dtype=np.int64)
    ordinals[order] = np.arange(1, len(together) + 1)
    return np.split(ordinals, np.cumsum([len(each) for each in times])[:-1])


def tiles_of(
    dives: Sequence[Rows], ordinals: Sequence[NDArray[np.int64]], edge: int
) -> dict[Tile, NDArray[np.void]]:
    """Return the pings whose boxes touch each tile, in order.

    Args:
        dives: rows of each dive.
        ordinals: numbers of their pings.
        edge: edge of a tile, in bricks.
    """
    parts: dict[Tile, list[NDArray[np.void]]] = {}
    for dive, (rows, numbers) in enumerate(zip(dives, ordinals, strict=True)):
        places = np.zeros(len(rows), dtype=PLACE)
        places["ordinal"], places["dive"] = numbers, dive
        places["size"], places["offset"] = rows["size"], rows["offset"]
        for key, chosen in _touched(rows, edge).items():
            parts.setdefault(Tile(key, edge), []).append(places[chosen])
    merged = {tile: np.concatenate(found) for tile, found in sorted(parts.items(), key=_key)}
    return {tile: found[np.argsort(found["ordinal"])] for tile, found in merged.items()}


def children_of(
    tile: Tile,
    places: NDArray[np.void],
    dives: Sequence[Rows],
    ordinals: Sequence[NDArray[np.int64]],
) -> dict[Tile, NDArray[np.void]]:
    """Cut a tile: `tiles_of` for half its edge, from the tile's pings only.

    Args:
        tile: the tile.
        places: its pings.
        dives: rows of each dive.
        ordinals: numbers of their pings.
    """
    first = np.empty((len(places), 3), dtype=np.int32)
    last = np.empty((len(places), 3), dtype=np.int32)
    for dive in np.unique(places["dive"]):
        of_dive = places["dive"] == dive
        # Within a dive numbers increase.
        at = np.searchsorted(ordinals[dive], places["ordinal"][of_dive])
        first[of_dive], last[of_dive] = dives[dive]["first"][at], dives[dive]["last"][at]
    found = {}
    for child in tile.children():
        low = np.array(child.key) * (child.edge * BLOCKS)
        high = low + (child.edge * BLOCKS - 1)
        touches = np.all((first <= high) & (last >= low), axis=1)
        if touches.any():
            found[child] = places[touches]
    return found


def _key(item: tuple[Tile, object]) -> Key:
    return item[0].key


def _touched(rows: Rows, edge: int) -> dict[Key, NDArray[np.int64]]:
    """Return the numbers of the pings that touch each tile."""
    observing = np.flatnonzero(np.all(rows["first"] <= rows["last"], axis=1))
    if not len(observing):
        return {}
    first = rows["first"][observing] // (edge * BLOCKS)
    last = rows["last"][observing] // (edge * BLOCKS)
    spans = (last - first).max(axis=0) + 1
    keys, numbers = [], []
    for step in itertools.product(*(range(int(span)) for span in spans)):
        at = first + np.array(step, dtype=np.int32)
        inside = np.all(at <= last, axis=1)
        keys.append(at[inside])
        numbers.append(observing[inside])
    return _grouped(np.concatenate(keys), np.concatenate(numbers))


def _grouped(keys: NDArray[np.int32], numbers: NDArray[np.int64]) -> dict[Key, NDArray[np.int64]]:
    order = np.lexsort((numbers, keys[:, 2], keys[:, 1], keys[:, 0]))
    keys, numbers = keys[order], numbers[order]
    cuts = np.flatnonzero(np.any(np.diff(keys, axis=0) != 0, axis=1)) + 1
    groups = zip(keys[np.r_[0, cuts]], np.split(numbers, cuts), strict=True)
    return {(int(key[0]), int(key[1]), int(key[2])): group for key, group in groups}


class SpooledDive(Struct, frozen=True):
    """A dive's spool: names of the file and of its mark, and bearing tables of its records."""

    spool: str
    mark: str
    bearings: list[bytes]


class TileTask(Struct, frozen=True):
    """One tile to map.

    Attributes:
        shard: name of the resulting file.
        key, edge: the tile.
        config: the settings.
        dives: dives of the pings.
        pings: bytes of an array of `PLACE`, in order.
        folder: the survey's folder, as for `Folder`.
        max_bytes: memory for its voxels.
    """

    shard: str
    key: Key
    edge: int
    config: Config
    dives: list[SpooledDive]
    pings: bytes
    folder: str
    max_bytes: int


class TileResult(Struct, frozen=True):
    """Result of mapping a tile.

    Attributes:
        shard: name of the file.
        too_large: its voxels exceed the memory, and nothing was kept.
        pings: number of its pings.
        bricks: number of bricks in its shard.
        cpu_s, read_bytes, written_bytes: cost of the task.
        voxel_bytes: memory of the voxels at the end.
        max_bytes: limit of that memory.
    """

    shard: str
    too_large: bool
    pings: int
    bricks: int
    cpu_s: float
    read_bytes: int
    written_bytes: int
    voxel_bytes: int
    max_bytes: int = msgspec.field(name="most_bytes")  # the key in earlier records too


def map_tile(task: TileTask) -> TileResult:
    """Map a tile into its shard, a map's file with this tile only.

    Revisions are those of the merged map: every ping counts, wherever it is.

    Raises:
        SurveyError: a spool is damaged; its mark is removed.
        OSError: the survey's folder cannot be read or written.
    """
    began_s = time.process_time()
    folder = Folder(task.folder)
    places = np.frombuffer(task.pings, dtype=PLACE)
    sonar_map = SonarMap(_single_threaded(task.config))
    sonar_map.core.limit_to_tile(task.key, task.edge)
    bricks = written = 0
    whole = _integrate(sonar_map, folder, task.dives, places, task.max_bytes)
    voxel_bytes = sonar_map.memory_bytes
    if whole:
        with scratch() as work:
            revision, found = sonar_map.core.bricks_since(0)
            bricks = write_whole(work / "shard.db", task.config, revision, packed(found))
            written = (work / "shard.db").stat().st_size
            folder.put(work / "shard.db", task.shard)
    return TileResult(
        shard=task.shard,
        too_large=not whole,
        pings=len(places),
        bricks=bricks,
        cpu_s=time.process_time() - began_s,
        read_bytes=int(places["size"].sum()),
        written_bytes=written,
        voxel_bytes=voxel_bytes,
        max_bytes=task.max_bytes,
    )


def _single_threaded(config: Config) -> Config:
    """Return settings with one thread, as workers run in parallel; the map does not change."""
    mapping = msgspec.structs.replace(config.mapping, threads=1)
    return msgspec.structs.replace(config, mapping=mapping)


def _integrate(
    sonar_map: SonarMap,
    folder: Folder,
    dives: Sequence[SpooledDive],
    places: NDArray[np.void],
    max_bytes: int,
) -> bool:
    """Map the pings; return False as soon as the voxels exceed the memory.

    Memory is checked after each ping, because one ping may take hundreds of megabytes; the check
    takes less than 1 % of the time.
    """
    with contextlib.ExitStack() as opened:
        for ordinal, ping in _pings(folder, dives, places, opened):
            sonar_map.core.raise_revision(ordinal - 1)
            sonar_map.integrate(*ping)
            if sonar_map.memory_bytes > max_bytes:
                return False
    return True


def _pings(
    folder: Folder,
    dives: Sequence[SpooledDive],
    places: NDArray[np.void],
    opened: contextlib.ExitStack,
) -> Iterator[tuple[int, Record]]:
    files: dict[int, tuple[BinaryIO, RecordReader]] = {}
    for ordinal, dive, size, offset in places.tolist():
        if dive not in files:
            file = opened.enter_context(folder.open(dives[dive].spool))
            files[dive] = file, RecordReader(dives[dive].bearings)
        file, reader = files[dive]
        file.seek(offset)
        try:
            record = reader.unpack(file.read(size))
        except MapperdError as error:
            folder.remove(dives[dive].mark)
            raise SurveyError(
                f"{dives[dive].spool}: {error}; the same command makes it again"
            ) from error
        yield ordinal, record


Show = Callable[[float, int], None]


@dataclass(frozen=True, slots=True)
class Scope:
    """Dives of one map.

    Attributes:
        name: name of the map; empty for the map of all.
        plans: plans of its dives.
        rows: rows of its dives.
    """

    name: str
    plans: Sequence[DivePlan]
    rows: Sequence[Rows]

    @property
    def pings(self) -> int:
        """Number of pings of all its dives, which is the revision of the map."""
        return sum(len(rows) for rows in self.rows)


def shard_mark(shard: str) -> str:
    """Return the name of the record of a shard."""
    return f"{shard.removesuffix('.db')}.json"


class TileStage:
    """Makes the tiles of one map.

    Args:
        scope: dives of the map.
        config: the settings.
        folder: the survey's folder.
        edge: edge of a tile, in bricks.
        max_bytes: memory for a tile's voxels.

    Attributes:
        results: results of all tiles, including those that were too large.
    """

    def __init__(
        self, scope: Scope, config: Config, folder: Folder, edge: int, max_bytes: int
    ) -> None:
        self.results: list[TileResult] = []
        self._scope = scope
        self._config = config
        self._folder = folder
        self._max_bytes = max_bytes
        self._edge = edge
        self._ordinals = ordinals_of(scope.rows)
        self._there: dict[str, int] = {}
        self._done = self._asked = 0

    def run(self, engine: Engine, show: Show) -> list[str]:
        """Map missing tiles; return the shards of the map.

        Raises:
            SurveyError: a task fails, or a single brick is too large.
        """
        self._there = self._folder.sizes("shards")
        tiles = tiles_of(self._scope.rows, self._ordinals, self._edge)
        shards: list[str] = []
        largest_first = sorted(tiles, key=lambda tile: -len(tiles[tile]))
        for tile in largest_first:
            self._take(tile, tiles.pop(tile), engine, shards)
        for task, result in engine.done():
            mark(self._folder, shard_mark(task.shard), result)
            self._took(task, result, engine, shards)
            show(self._done / max(self._asked, 1), self._done)
        return sorted(shards)

    def _take(
        self, tile: Tile, places: NDArray[np.void], engine: Engine, shards: list[str]
    ) -> None:
        """Submit a tile if it does not exist."""
        task = self._task(tile, places)
        self._asked += len(places)
        kept = self._kept(task)
        if kept is None:
            engine.submit(map_tile, task)
        else:
            self._took(task, kept, engine, shards)

    def _took(self, task: TileTask, result: TileResult, engine: Engine, shards: list[str]) -> None:
        self.results.append(result)
        self._done += result.pings
        if not result.too_large:
            shards.append(result.shard)
            return
        tile, places = Tile(task.key, task.edge), np.frombuffer(task.pings, dtype=PLACE)
        children = children_of(tile, places, self._scope.rows, self._ordinals)
        if not children:
            raise SurveyError(
                f"tile {tile.name} takes over {self._max_bytes >> 20} MiB and cannot be cut: "
                "allowed: a larger --memory-per-worker, or larger voxels"
            )
        for child, theirs in children.items():
            self._take(child, theirs, engine, shards)

    def _task(self, tile: Tile, places: NDArray[np.void]) -> TileTask:
        used = [self._scope.plans[dive].fingerprint for dive in np.unique(places["dive"])]
        key = digest_of(program_digest(), self._config, tile.name, *used, places.tobytes())
        scope = f"{self._scope.name}@" if self._scope.name else ""
        return TileTask(
            shard=f"shards/{scope}{tile.name}.{key}.db",
            key=tile.key,
            edge=tile.edge,
            config=self._config,
            dives=[
                SpooledDive(spool_name(plan), mark_name(plan), plan.bearings)
                for plan in self._scope.plans
            ],
            pings=places.tobytes(),
            folder=self._folder.url,
            max_bytes=self._max_bytes,
        )

    def _kept(self, task: TileTask) -> TileResult | None:
        if shard_mark(task.shard) not in self._there:
            return None
        result = marked(self._folder, shard_mark(task.shard), TileResult)
        if result is None:
            return None
        if result.too_large:
            return result if task.max_bytes <= result.max_bytes else None
        return result if self._there.get(task.shard) == result.written_bytes else None
