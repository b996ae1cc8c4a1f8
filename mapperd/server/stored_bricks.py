"""The part of a map that is in its file alone, read beside whoever writes it."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zstandard
from numpy.typing import NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import iwlo_params
from mapperd.store.bricks import COLUMNS, BrickRow, DamagedBrickError, Key, rows_of, unpack
from mapperd.store.database import open_reader, reading, translated

__all__ = ["ChangedRows", "StoredBricks"]

FARTHEST = 1 << 27
"""Of a brick of a map: keys beyond are of damaged rows."""


@dataclass(frozen=True, slots=True, eq=False)
class ChangedRows:
    """Bricks of the file that changed after a revision.

    Attributes:
        keys: (N, 3) int32.
        revisions: (N,) int64, of each.
        revision: of the map in the file.
    """

    keys: NDArray[np.int32]
    revisions: NDArray[np.int64]
    revision: int


class StoredBricks:
    """Reads bricks; of one thread.

    Args:
        path: of the file.
        config: settings of its map.

    Raises:
        StoreError: it cannot be opened.
    """

    def __init__(self, path: Path, config: Config) -> None:
        self._path = path
        self._unpacker = zstandard.ZstdDecompressor()
        self._scratch = _core.VoxelMap(config.octree.voxel_resolution, iwlo_params(config))
        with ExitStack() as opening:
            self._connection = open_reader(path)
            opening.callback(self._connection.close)
            self._open = opening.pop_all()

    def close(self) -> None:
        """Let go of the file."""
        self._open.close()

    def version(self) -> int:
        """Another number whenever the file was written to.

        Raises:
            StoreError: it cannot be read.
        """
        with translated(self._path):
            return int(self._connection.execute("PRAGMA data_version").fetchone()[0])

    def changed_since(self, revision: int) -> ChangedRows:
        """Bricks whose rows changed after a revision.

        Raises:
            StoreError: the file cannot be read.
        """
        with translated(self._path), reading(self._connection):
            progress = self._connection.execute("SELECT revision FROM progress").fetchone()
            found = self._connection.execute(
                "SELECT x, y, z, revision FROM brick WHERE revision > ?1 AND"
                " x BETWEEN -?2 AND ?2 AND y BETWEEN -?2 AND ?2 AND z BETWEEN -?2 AND ?2",
                (revision, FARTHEST),
            ).fetchall()
        columns = np.array(found, np.int64).reshape(-1, 4)
        return ChangedRows(
            columns[:, :3].astype(np.int32),
            columns[:, 3],
            int(progress[0]) if progress is not None else 0,
        )

    def has_losses(self) -> bool:
        """Something of the map was damaged, and is not there any more.

        Raises:
            StoreError: the file cannot be read.
        """
        with translated(self._path):
            lost = "SELECT EXISTS (SELECT 1 FROM quarantine WHERE NOT rebuilt)"
            return bool(self._connection.execute(lost).fetchone()[0])

    def load(self, bricks: NDArray[np.int32]) -> tuple[_core.VoxelMap, dict[Key, int]]:
        """A map of some bricks alone, good until the next call.

        Args:
            bricks: keys (N, 3); those that are not in the file, or damaged in it, are unknown.

        Returns:
            the map; the revision of each brick's row.

        Raises:
            StoreError: the file cannot be read.
        """
        self._scratch.clear()
        rows: list[BrickRow] = []
        with translated(self._path), reading(self._connection):
            for key in bricks.tolist():
                rows += rows_of(
                    self._connection.execute(
                        f"SELECT {COLUMNS} FROM brick WHERE x = ? AND y = ? AND z = ?",  # noqa: S608 our own text
                        key,
                    )
                )
        revisions = {}
        for row in rows:
            try:
                self._scratch.put_bricks([(row.key, unpack(self._unpacker, row))])
            except (DamagedBrickError, ValueError):
                continue  # whoever needs it for mapping says so
            revisions[row.key] = row.revision
        return self._scratch, revisions
