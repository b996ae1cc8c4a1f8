"""Reads a map from its file part by part; it may be larger than memory."""

import itertools
import struct
import tempfile
import weakref
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import astuple, dataclass
from functools import cached_property
from operator import add
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, cast

import numpy as np
import zstandard
from numpy.typing import NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.errors import ExportError, StoreError, os_reason
from mapperd.io import atomic_file
from mapperd.mapping.file_headers import map_header_bytes
from mapperd.mapping.sonar_map import MapCounts, SonarMap, Voxels, fingerprint
from mapperd.store.database import check_version, open_reader, reading, translated
from mapperd.store.metadata import check_checksum, check_kind, lost_in, progress_in
from mapperd.store.octree import SIZE, Subtree, TreeFile, brick_paths, subtree_in
from mapperd.store.tiles import (
    COLUMNS,
    LAYERS,
    DamagedBrickError,
    Key,
    check_row,
    layer_of,
    rows_of,
    unpack,
)
from mapperd.store.transfer import check_structure

__all__ = ["StoredMap"]

BRICKS_AT_ONCE = 16
"""Bricks of a part in memory; each may take 1.5 MB, and half as much while it is read."""

DECODED_AT_ONCE = 8
"""Bricks decoded before they are put into a part."""

COPIED_AT_ONCE = 1 << 20

Columns = tuple[int, int, int]
"""Bricks of one x and of a range of y, both ends included."""


class StoredMap:
    """One saved state of a map in its file; `mapperd.mapping.queries.MapContent`.

    The file may be written meanwhile: this state is read until `close`.

    Args:
        path: of the file.
        config: settings; those that the map was made with come from the file.
        unsaved: bricks that replace those of the file.
        incomplete: bricks that count as lost if they are damaged in the file, even if unsaved.

    Raises:
        StoreError: the file cannot be read, its structure is damaged, or it is of other settings.

    Attributes:
        config: as given.
        position: position in the input up to which the map is complete.
        lost: damaged bricks, which are missing or incomplete.
        has_checksum: False if the file is of version 1, whose settings cannot be verified.
    """

    def __init__(
        self,
        path: Path,
        config: Config,
        *,
        unsaved: Mapping[Key, bytes] = MappingProxyType({}),
        incomplete: frozenset[Key] = frozenset(),
    ) -> None:
        self.config = config
        self._path = path
        self._unsaved = unsaved
        self._unpacker = zstandard.ZstdDecompressor()
        with ExitStack() as opening, translated(path):
            self._connection = open_reader(path)
            opening.callback(self._connection.close)
            check_version(self._connection, path)
            opening.enter_context(reading(self._connection))
            self.has_checksum = check_checksum(self._connection, path)
            check_kind(self._connection, path, config)
            check_structure(self._connection, path)
            _, self.position = progress_in(self._connection, path) or (0, b"")
            damaged = self._damaged()
            self.lost = damaged - (unsaved.keys() - incomplete)
            self._not_read = damaged | unsaved.keys()
            self._keys = self._sound_keys()
            self._closing = weakref.finalize(self, opening.pop_all().close)

    def close(self) -> None:
        """Close the file."""
        self._closing()

    @property
    def resolution_m(self) -> float:
        """Edge of a voxel."""
        return self.config.octree.voxel_resolution

    @property
    def bricks_lost(self) -> int:
        """Damaged bricks, whose space is unknown."""
        return len(self.lost)

    @property
    def memory_bytes(self) -> int:
        """Memory of the largest part; counted together with the voxels."""
        return self._survey.memory_bytes

    def counts(self) -> MapCounts:
        """Count the observed voxels by class."""
        return self._survey.counts

    def sha256(self) -> str:
        """Return the fingerprint of the content; see `SonarMap.sha256`."""
        return fingerprint(self.parts(), self.resolution_m)

    def occupied(self) -> "_StoredVoxels":
        """Return the occupied voxels; they are counted now and read at each use."""
        survey = self._survey
        return _StoredVoxels(self._in_order, survey.counts.occupied, survey.box_m)

    def free(self) -> Iterator[Voxels]:
        """Yield the free voxels, few at a time."""
        for part in self._in_order():
            yield from part.voxel_batches("free")

    def parts(self) -> Iterator[_core.VoxelMap]:
        """Yield parts in the map's fixed order, each valid until the next."""
        for part in self._in_order():
            yield part.core

    def save(self, path: Path) -> None:
        """Write the map without loss; the bytes are those of `SonarMap.save`.

        Raises:
            ExportError: the file cannot be written.
            StoreError: the map's file cannot be read.
        """
        header, _ = _map_file_parts(SonarMap(self.config))
        blocks = 0
        with atomic_file(path) as file, _spool(path) as body:
            for part in self._in_order():
                begin, data = _map_file_parts(part)
                blocks += _BLOCKS.unpack(begin[-_BLOCKS.size :])[0]
                body.write(data)
            begin = header[: -_BLOCKS.size] + _BLOCKS.pack(blocks)
            file.write(begin)
            crc = zlib.crc32(begin)
            for data in _contents(body):
                crc = zlib.crc32(data, crc)
                file.write(data)
            file.write(struct.pack("<I", crc))

    def save_octomap(self, path: Path) -> None:
        """Write OctoMap's tree; the bytes are those of `SonarMap.save_octomap`.

        Raises:
            MapError: a voxel lies outside OctoMap's range.
            ExportError: the file cannot be written.
            StoreError: the map's file cannot be read.
        """
        binary = path.suffix == ".bt"
        paths = brick_paths(self._keys)
        brick = SonarMap(self.config)
        for key in self._keys[paths < 0]:  # refused if it has anything to write
            self._subtree(brick, key, binary=binary)
        order = np.argsort(paths, kind="stable")[np.count_nonzero(paths < 0) :]
        keys = self._keys[order]
        with atomic_file(path) as file, _spool(path) as body:
            tree = TreeFile(body, binary=binary)
            tree.write(
                paths[order].tolist(), lambda i: self._subtree(brick, keys[i], binary=binary)
            )
            empty = _octomap_of(SonarMap(self.config), binary=binary)
            file.write(SIZE.sub(b"size %d" % tree.nodes, empty))
            for data in _contents(body):
                file.write(data)

    @cached_property
    def _survey(self) -> "_MapTotals":
        counts = MapCounts(0, 0, 0)
        memory_bytes = 0
        corners_m = []
        for part in self._parts_in_any_order():
            counts = MapCounts(*map(add, astuple(counts), astuple(part.counts())))
            memory_bytes = max(memory_bytes, part.memory_bytes)
            occupied = part.voxel_batches("occupied")
            corners_m += [some.box_m for some in occupied if len(some)]
        both_m = np.concatenate(corners_m) if corners_m else np.zeros((2, 3))
        box_m = np.stack([both_m.min(axis=0), both_m.max(axis=0)])
        return _MapTotals(counts, memory_bytes, box_m)

    def _damaged(self) -> frozenset[Key]:
        lost = lost_in(self._connection, self._path)
        found = self._connection.execute(f"SELECT {COLUMNS} FROM brick")  # noqa: S608 our own text
        for row in rows_of(found):
            try:
                check_row(row)
            except DamagedBrickError:
                lost.add(row.key)
        return frozenset(lost)

    def _sound_keys(self) -> NDArray[np.int64]:
        """Return the keys (N, 3) of all bricks except lost ones, ascending."""
        found = self._connection.execute("SELECT x, y, z FROM brick ORDER BY x, y, z")
        keys = sorted({*found}.difference(self._not_read) | self._unsaved.keys())
        return np.array(keys, dtype=np.int64).reshape(-1, 3)

    def _in_order(self) -> Iterator[SonarMap]:
        """Yield parts in the order of their blocks' keys, which start with x.

        If one x has too many bricks, their layers of blocks are read one by one.
        """
        part = SonarMap(self.config)
        for group in self._groups():
            if len(group) == 1:
                self._read(part, group[0])
                yield part
                continue
            for layer, columns in itertools.product(range(LAYERS), group):
                self._read(part, columns, layer)
                yield part

    def _parts_in_any_order(self) -> Iterator[SonarMap]:
        part = SonarMap(self.config)
        for columns in itertools.chain.from_iterable(self._groups()):
            self._read(part, columns)
            yield part

    def _groups(self) -> Iterator[list[Columns]]:
        """Divide the bricks of each x into groups that fit in memory."""
        for x in np.unique(self._keys[:, 0]):
            ys, counts = np.unique(self._keys[self._keys[:, 0] == x, 1], return_counts=True)
            group: list[Columns] = []
            bricks = 0
            for y, count in zip(ys.tolist(), counts.tolist(), strict=True):
                if group and bricks + count <= BRICKS_AT_ONCE:
                    group[-1] = (*group[-1][:2], y)
                    bricks += count
                else:
                    group.append((int(x), y, y))
                    bricks = count
            yield group

    def _read(self, part: SonarMap, columns: Columns, layer: int | None = None) -> None:
        """Load the bricks of columns, or one layer of blocks of each, into a part."""
        with translated(self._path):
            found = self._connection.execute(
                f"SELECT {COLUMNS} FROM brick WHERE x = ? AND y BETWEEN ? AND ? ORDER BY y, z",  # noqa: S608 our own text
                columns,
            )
            x, low, high = columns
            unsaved = [key for key in self._unsaved if key[0] == x and low <= key[1] <= high]
            self._fill(part, found, unsaved, layer)

    def _subtree(self, part: SonarMap, key: Iterable[int], *, binary: bool) -> Subtree | None:
        x, y, z = key
        with translated(self._path):
            found = self._connection.execute(
                f"SELECT {COLUMNS} FROM brick WHERE (x, y, z) = (?, ?, ?)",  # noqa: S608 our own text
                one := (int(x), int(y), int(z)),
            )
            self._fill(part, found, [one] if one in self._unsaved else [])
        return subtree_in(_octomap_of(part, binary=binary), binary=binary)

    def _fill(
        self,
        part: SonarMap,
        found: Iterable[tuple[Any, ...]],
        unsaved: Iterable[Key],
        layer: int | None = None,
    ) -> None:
        part.core.clear()
        self._put(part, [(key, self._unsaved[key]) for key in unsaved], layer)
        rows = (row for row in rows_of(found) if row.key not in self._not_read)
        while some := list(itertools.islice(rows, DECODED_AT_ONCE)):
            try:
                bricks = [(row.key, unpack(self._unpacker, row)) for row in some]
                self._put(part, bricks, layer)
            except (DamagedBrickError, ValueError) as error:
                text = f"{self._path}: is damaged: a brick of {some[0].key} to {some[-1].key}"
                raise StoreError(f"{text}: {error}", "damaged") from error

    @staticmethod
    def _put(part: SonarMap, bricks: list[tuple[Key, bytes]], layer: int | None) -> None:
        if layer is not None:
            bricks = [(key, layer_of(brick, layer)) for key, brick in bricks]
        part.core.put_bricks(bricks)


@dataclass(frozen=True, slots=True)
class _MapTotals:
    """Totals of the whole map.

    Attributes:
        counts: observed voxels.
        memory_bytes: memory of the largest part.
        box_m: (2, 3) lowest and highest centre of the occupied voxels.
    """

    counts: MapCounts
    memory_bytes: int
    box_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _StoredVoxels:
    """Occupied voxels; `mapperd.mapping.queries.VoxelCloud`."""

    parts: Callable[[], Iterator[SonarMap]]
    count: int
    box_m: NDArray[np.float64]

    def __len__(self) -> int:
        return self.count

    def batches(self) -> Iterator[Voxels]:
        """Yield the voxels, few at a time: lists of those of a whole part take 10 MB a brick."""
        for part in self.parts():
            yield from part.voxel_batches("occupied")


_BLOCKS = struct.Struct("<Q")
"""Number of blocks, at the end of the header of a `.map`."""

_CRC_BYTES = 4


def _map_file_parts(part: SonarMap) -> tuple[bytes, bytes]:
    """Return header and blocks of the `.map` file of a part."""
    data = part.core.encode_map()
    begin = map_header_bytes(data)
    return data[:begin], data[begin:-_CRC_BYTES]


def _octomap_of(part: SonarMap, *, binary: bool) -> bytes:
    return part.octomap_bt() if binary else part.octomap_ot()


@contextmanager
def _spool(path: Path) -> Iterator[BinaryIO]:
    """Open an unnamed file in another's folder, for the content after its header."""
    try:
        with tempfile.TemporaryFile(dir=path.parent) as file:
            yield cast("BinaryIO", file)
    except OSError as error:
        raise ExportError(f"{path}: cannot be written: {os_reason(error)}") from error


def _contents(file: BinaryIO) -> Iterator[bytes]:
    file.seek(0)
    while data := file.read(COPIED_AT_ONCE):
        yield data
