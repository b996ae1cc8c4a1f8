"""Reads the map's file, also while another process writes it; never changes it."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import zstandard
from numpy.typing import NDArray

from mapperd import _core
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.database import check_version, open_reader, reading, translated
from mapperd.store.metadata import check_checksum, check_kind, kind_in, lost_in, progress_in
from mapperd.store.tiles import COLUMNS, BrickRow, DamagedBrickError, Key, rows_of, unpack
from mapperd.store.transfer import check_structure

__all__ = ["BRICK_VOXELS", "Loaded", "StoreReader"]

BRICK_VOXELS = _core.BRICK_VOXELS
"""Voxels along an edge of a brick: brick k of an axis begins at voxel k times this."""

AT_ONCE = 64
"""Bricks decoded at once; each may take 1.5 MB."""


@dataclass(frozen=True, slots=True)
class Loaded:
    """One saved state of a map.

    Attributes:
        revision: its revision, for requests of later changes.
        position: position in the input up to which it is complete.
        bricks: number of bricks read.
        lost: bricks that are missing because their rows are or were damaged.
    """

    revision: int
    position: bytes
    bricks: int
    lost: frozenset[Key]


class StoreReader:
    """The file of a map, open for reading; a context manager.

    Args:
        path: the file.
        finished: it is closed and will not be written again: read it without locks, which network
            folders may lack.

    Raises:
        StoreError: it cannot be read, or has another version.
    """

    def __init__(self, path: Path, *, finished: bool = False) -> None:
        self.path = path
        self._is_sound = False
        self._unpacker = zstandard.ZstdDecompressor()
        with ExitStack() as opening:
            self._connection = open_reader(path, finished=finished)
            opening.callback(self._connection.close)
            with translated(path):
                check_version(self._connection, path)
            self._open = opening.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open.close()

    def kind(self) -> dict[str, Any]:
        """Return the settings, by name, that the map was made with; `load` requires them.

        Raises:
            StoreError: the file cannot be read.
        """
        with translated(self.path), reading(self._connection):
            check_checksum(self._connection, self.path)
            return kind_in(self._connection, self.path)

    def rows(self) -> Iterator[BrickRow]:
        """Yield all bricks as stored, for another file with the same settings.

        Raises:
            StoreError: the file cannot be read, a row of it is damaged, or bricks of it are lost.
        """
        with self._reading():
            if lost := lost_in(self._connection, self.path):
                text = f"{len(lost)} damaged bricks of it are not rebuilt"
                remedy = "map its recordings into a new file"
                raise StoreError(f"{self.path}: {text}: {remedy}", "bricks_lost")
            found = self._connection.execute(
                f"SELECT {COLUMNS} FROM brick ORDER BY x, y, z"  # noqa: S608 our own text
            )
            for row in rows_of(found):
                try:
                    unpack(self._unpacker, row)
                except DamagedBrickError as error:
                    raise StoreError(
                        f"{self.path}: is damaged: brick {row.key}: {error}", "damaged"
                    ) from error
                yield row

    def load(self, sonar_map: SonarMap, since: int = 0) -> Loaded:
        """Update a map in memory to the last saved state.

        Args:
            sonar_map: a map with the same settings; changed bricks are replaced.
            since: the `revision` of its content; 0 if it is empty.

        Raises:
            StoreError: the file cannot be read, or is of other settings.
        """
        bricks = 0
        with self._reading():
            check_kind(self._connection, self.path, sonar_map.config)
            revision, position = progress_in(self._connection, self.path) or (0, b"")
            lost = lost_in(self._connection, self.path)
            found = self._connection.execute(
                # For 0 read all rows, even those with a damaged revision.
                f"SELECT {COLUMNS} FROM brick WHERE revision > ? OR NOT ?",  # noqa: S608 our own
                (since, since),
            )
            for batch in self._batches(rows_of(found), lost):
                sonar_map.core.put_bricks(batch)
                bricks += len(batch)
        return Loaded(revision, position, bricks, frozenset(lost))

    def keys(self) -> NDArray[np.int64]:
        """Return the keys (N, 3) of all bricks, ascending, including lost ones.

        Raises:
            StoreError: the file cannot be read.
        """
        with self._reading():
            found = self._connection.execute(
                "SELECT x, y, z FROM brick UNION SELECT x, y, z FROM quarantine WHERE NOT rebuilt"
            ).fetchall()
        keys = np.array(found, dtype=np.int64).reshape(-1, 3)
        return keys[np.lexsort(keys.T[::-1])]

    def load_box(self, sonar_map: SonarMap, low: Key, high: Key) -> frozenset[Key]:
        """Load a part of the map into another; memory holds only that part.

        Args:
            sonar_map: a map in memory with the same settings; bricks of the box are replaced.
            low: key of the box's first brick.
            high: key of its last brick, included.

        Returns:
            lost bricks of the box.

        Raises:
            StoreError: the file cannot be read, or is of other settings.
        """
        box = [edge for pair in zip(low, high, strict=True) for edge in pair]
        inside = "x BETWEEN ? AND ? AND y BETWEEN ? AND ? AND z BETWEEN ? AND ?"
        with self._reading():
            check_kind(self._connection, self.path, sonar_map.config)
            lost = set(
                self._connection.execute(
                    f"SELECT x, y, z FROM quarantine WHERE NOT rebuilt AND {inside}",  # noqa: S608
                    box,
                )
            )
            found = self._connection.execute(
                f"SELECT {COLUMNS} FROM brick WHERE {inside}",  # noqa: S608 our own text
                box,
            )
            for batch in self._batches(rows_of(found), lost):
                sonar_map.core.put_bricks(batch)
        return frozenset(lost)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Read one state of the file; it is checked once, before an index is used."""
        with translated(self.path), reading(self._connection):
            if not self._is_sound:
                check_checksum(self._connection, self.path)
                check_structure(self._connection, self.path)
                self._is_sound = True
            yield

    def _batches(
        self, rows: Iterable[BrickRow], lost: set[Key]
    ) -> Iterator[list[tuple[Key, bytes]]]:
        batch = []
        for row in rows:
            try:
                batch.append((row.key, unpack(self._unpacker, row)))
            except DamagedBrickError:
                lost.add(row.key)
            if len(batch) == AT_ONCE:
                yield batch
                batch = []
        yield batch
