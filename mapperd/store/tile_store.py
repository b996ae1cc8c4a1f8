"""A map with some tiles in memory and a copy of all tiles in one file.

A tile is evicted only after the file holds its current content. Each save writes all changes and
the position in the input up to which the map is complete. At any time the file therefore holds the
whole map between two pings, and which two.
"""

import sqlite3
import threading
import weakref
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from mapperd import _core
from mapperd.errors import MapError, StoreError
from mapperd.io import sync_folder
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.database import (
    migrate,
    only_writer,
    open_reader,
    open_writer,
    transaction,
    translated,
)
from mapperd.store.metadata import (
    MapIdentity,
    begun,
    check_checksum,
    check_kind,
    lost_in,
    progress_in,
    restore_settings,
    write_checksum,
    write_kind,
)
from mapperd.store.tiles import Key, ResidentTiles
from mapperd.store.transfer import Loader, Position, Saver, Snapshot, check_structure, made

__all__ = ["StoreCounters", "TileStore", "tile_bricks"]

OVERDRAFT = 4
"""Multiple of the cache that changed tiles may take while saving fails."""


@dataclass(slots=True)
class StoreCounters:
    """Counters since the file was opened."""

    tiles_loaded: int = 0
    tiles_dropped: int = 0
    saves: int = 0
    saves_failed: int = 0
    bricks_damaged: int = 0


def tile_bricks(tile_size_m: float, resolution_m: float) -> int:
    """Return the bricks along a tile's edge: the size rounded to whole bricks, at least 1."""
    return max(1, round(tile_size_m / (_core.BRICK_VOXELS * resolution_m)))


class TileStore:
    """The file of one map; a context manager that saves at its end.

    The mapping thread makes all calls except `write`, `suspect`, `lost` and `status`.

    Args:
        path: the file; created if missing.
        sonar_map: empty; from now on it holds only some of the tiles.
        tile_size_m: edge of a tile, rounded to whole bricks.
        cache_tiles: number of tiles in memory; more if one ping needs more.

    Raises:
        StoreError: the file cannot be used, or is of other settings.

    Attributes:
        position: position of the map when the file was opened; empty in a new file.
        saved_position: position at the last save.
        identity: identity of the map; any thread may read it.
        counters: counters since the file was opened.
        trouble: why saving fails; None if it works.
        had_checksum: False if the file was of version 1, whose settings cannot be verified.
    """

    def __init__(
        self, path: Path, sonar_map: SonarMap, *, tile_size_m: float, cache_tiles: int
    ) -> None:
        if cache_tiles < 1:
            raise ValueError("cache_tiles must be 1 or more")
        self.path = path
        self.counters = StoreCounters()
        self.trouble: str | None = None
        self._core = sonar_map.core
        edge = tile_bricks(tile_size_m, sonar_map.resolution_m)
        self._limit = cache_tiles
        self._tiles = ResidentTiles(cache_tiles)
        self._damaged: dict[Key, str] = {}
        self._suspects: set[Key] = set()
        self._rewritten: set[Key] = set()
        self._unsaved: set[Key] = set()
        self._writing = threading.Lock()
        self._numbers = self._written = 0
        self._open = ExitStack()
        with ExitStack() as opening:
            opening.enter_context(only_writer(path))
            writer = open_writer(path)
            opening.callback(writer.close)
            with translated(path):
                migrate(writer, path)
                self._saved_revision, self.position, self._lost = self._begin(writer, sonar_map)
                with transaction(writer):
                    self.identity: MapIdentity = begun(writer, self._saved_revision)
                    write_checksum(writer)
                self._saver = Saver(writer)
            self.saved_position = self.position
            reader = open_reader(path)
            opening.callback(reader.close)
            self._loader = Loader(reader, path, edge)
            self._core.raise_revision(self._saved_revision)
            self._core.cut_into_tiles(edge, _weakly(self._fetch))
            self._noted: tuple[int, Position] = (self._core.revision, self.position)
            self._open = opening.pop_all()

    def _begin(
        self, writer: sqlite3.Connection, sonar_map: SonarMap
    ) -> tuple[int, bytes, set[Key]]:
        found = progress_in(writer, self.path)
        self._check_checksum(writer, sonar_map)
        if found is None:
            with transaction(writer):
                write_kind(writer, sonar_map.config)
                writer.execute("INSERT INTO progress (id, revision, position) VALUES (1, 0, x'')")
            return 0, b"", set()
        check_kind(writer, self.path, sonar_map.config)
        return *found, lost_in(writer, self.path)

    def _check_checksum(self, writer: sqlite3.Connection, sonar_map: SonarMap) -> None:
        """Check the metadata; restore damaged settings if they are those of the map."""
        try:
            self.had_checksum = check_checksum(writer, self.path)
        except StoreError:
            check_structure(writer, self.path)
            with transaction(writer):
                if not restore_settings(writer, sonar_map.config):
                    raise
            self.had_checksum = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Save, except after an exception: then the last save stands."""
        try:
            if kind is None:
                self.save()
        finally:
            self.close()

    def close(self) -> None:
        """Close the file as last saved."""
        self._open.close()

    @property
    def steps(self) -> int:
        """Increases during a save; any thread may read it."""
        return self.counters.saves + self.counters.saves_failed + self._saver.bricks_packed

    @property
    def bytes_written(self) -> int:
        """Bytes of bricks written since the file was opened."""
        return self._saver.bytes_written

    @property
    def lost(self) -> frozenset[Key]:
        """Damaged bricks that are not rebuilt; any thread may read it.

        Their content is missing in the map.
        """
        return frozenset(self._lost)

    def advance(self, position: Position) -> None:
        """Note after each ping the position in the input up to which the map is complete.

        Args:
            position: the position, or a function that makes it in the writing thread. If it raises
                a `StoreError`, nothing is written.
        """
        self._noted = (self._core.revision, position)

    def take(self) -> Snapshot:
        """Return the unsaved changes as a snapshot for `write`.

        Raises:
            StoreError: the map was changed since `advance` (`out_of_step`).
        """
        noted_revision, position = self._noted
        revision, bricks = self._core.bricks_since(self._saved_revision)
        if revision != noted_revision:
            raise StoreError(
                f"{self.path}: the map changed without a record of its progress", "out_of_step"
            )
        if self._rewritten:
            missing = self._rewritten.difference(key for key, _, _ in bricks)
            bricks = [*bricks, *(brick for brick in self._resident() if brick[0] in missing)]
            self._rewritten.clear()
        self._numbers += 1
        return Snapshot(self._numbers, revision, position, bricks, dict(self._damaged))

    def write(self, snapshot: Snapshot) -> None:
        """Write a snapshot; any thread may call it. A snapshot older than the file is skipped.

        Raises:
            StoreError: it cannot be written; the file is unchanged and the map stays in memory.
        """
        with self._writing:
            if snapshot.number <= self._written:
                return
            try:
                with translated(self.path):
                    snapshot = _sealed(snapshot)
                    self._saver.write(snapshot)
            except StoreError as error:
                self.counters.saves_failed += 1
                self.trouble = str(error)
                raise
            self._written = snapshot.number
            self._saved_revision = snapshot.revision
            self.saved_position = made(snapshot.position)
            for key in snapshot.damaged:
                self._damaged.pop(key, None)
            self._lost.difference_update(snapshot.rebuilt)
            self.counters.saves += 1
            self.trouble = None

    def save(self) -> None:
        """Write all changes.

        Raises:
            StoreError: they cannot be written; the file is unchanged and the map stays in memory.
        """
        self.write(self.take())

    def save_part(self) -> int:
        """Write as many changed bricks as there is space for; the file loses the rest.

        The position counts the map as complete and lists the lost bricks.

        Returns:
            number of bricks that are not in the file; they stay in memory.

        Raises:
            StoreError: not even the position can be written; the file is unchanged.
        """
        snapshot = self.take()
        bricks = list(snapshot.bricks)
        unsaved = {key for key, _, _ in bricks}
        rebuilt = unsaved - self._lost
        self.write(replace(snapshot, bricks=(), unsaved=tuple(unsaved)))
        self._lost |= unsaved
        self._unsaved = unsaved
        for key, changed_at, brick in bricks:
            self._numbers += 1
            whole_again = (key,) if key in rebuilt else ()
            row = [(key, changed_at, brick)]
            position = self.saved_position
            some = Snapshot(self._numbers, snapshot.revision, position, row, {}, whole_again)
            try:
                self.write(some)
            except StoreError:
                break
            unsaved.discard(key)
        return len(unsaved)

    def unsaved(self) -> list[tuple[Key, int, bytes]]:
        """Return the bricks in memory that differ from the file."""
        bricks: list[tuple[Key, int, bytes]] = self._core.bricks_since(self._saved_revision)[1]
        if not self._unsaved:
            return bricks
        return [brick for brick in self._resident() if brick[0] in self._unsaved]

    def sync(self) -> None:
        """Move the write-ahead log into the file, durably.

        Raises:
            StoreError: it cannot be moved.
        """
        with self._writing, translated(self.path):
            is_done = self._saver.sync()
            sync_folder(self.path.parent)
        if not is_done:
            raise StoreError(f"{self.path}: a reader holds its write-ahead log", "busy")

    def check(self) -> frozenset[Key]:
        """Check the whole file for damage, which otherwise shows when a tile is loaded.

        No tile may be in memory yet, because its rows would then not count as lost.

        Returns:
            all lost bricks.

        Raises:
            StoreError: its structure is damaged.
        """
        self._check_unused()
        self._note_damage(self._loader.damage())
        return self.lost

    def suspect(self, keys: Iterable[Key]) -> None:
        """Report bricks that another reader found damaged; any thread may call it."""
        with self._writing:
            self._suspects.update(keys)

    def settle_suspects(self) -> None:
        """Recheck the reported bricks: those in memory are written again, others are lost.

        Raises:
            StoreError: the file cannot be read.
        """
        if not self._suspects:
            return
        with self._writing:
            suspects, self._suspects = self._suspects, set()
        damaged = self._loader.damage(suspects)
        if not damaged:
            return
        resident = {key for key, _, _ in self._resident()}.intersection(damaged)
        self._rewritten |= resident
        self._note_damage({key: why for key, why in damaged.items() if key not in resident})
        if self._rewritten:
            self._try_to_save()

    def _resident(self) -> list[tuple[Key, int, bytes]]:
        """Return the bricks in memory that are not empty."""
        bricks: list[tuple[Key, int, bytes]] = self._core.bricks_since(0)[1]
        return bricks

    def reset(self) -> None:
        """Empty the map and its file; the position in the input stays.

        Raises:
            StoreError: the file cannot be written; nothing changes.
        """
        revision, position = self._core.revision + 1, made(self._noted[1])
        with self._writing, translated(self.path):
            identity = self._saver.forget(revision, position, self.identity)
            self._numbers += 1
            self._written, self._saved_revision = self._numbers, revision
        self._forget(self._tiles.all())
        self._core.raise_revision(revision)
        self._noted = (revision, position)
        self._damaged.clear()
        self._lost.clear()
        self.identity = identity  # last: whoever sees the new identity must not find the old map

    def restore(self, bricks: Iterable[tuple[Key, bytes]], *, whole: bool) -> None:
        """Write rebuilt bricks into the file; no tile may be in memory yet.

        Args:
            bricks: those of `lost` that are not empty; others replace those of the file.
            whole: they are complete up to `position`; otherwise they still count as lost.

        Raises:
            StoreError: they cannot be written; nothing changes.
        """
        self._check_unused()
        self._core.raise_revision(self._core.revision + 1)
        revision = self._core.revision
        self._noted = (revision, self._noted[1])
        self._numbers += 1
        rows = [(key, revision, brick) for key, brick in bricks]
        rebuilt = tuple(sorted(self._lost)) if whole else ()
        self.write(Snapshot(self._numbers, revision, self._noted[1], rows, {}, rebuilt))

    def status(self) -> dict[str, object]:
        """Status for people: tiles, saves and losses."""
        return {
            "state": "saving" if self.trouble is None else "stuck",
            "reason": self.trouble,
            "tiles": len(self._tiles),
            "tiles_loaded": self.counters.tiles_loaded,
            "tiles_dropped": self.counters.tiles_dropped,
            "saves": self.counters.saves,
            "saves_failed": self.counters.saves_failed,
            "bytes_written": self._saver.bytes_written,
            "bricks_lost": len(self._lost),
        }

    def _check_unused(self) -> None:
        if len(self._tiles):
            raise ValueError("tiles are in memory already")

    def _fetch(self, tiles: list[Key]) -> None:
        missing = self._tiles.missing(tiles)
        if missing:
            self._make_room(len(missing), frozenset(tiles))
            damaged = self._loader.load(self._core, missing)
            self.counters.tiles_loaded += len(missing)
            self._note_damage(damaged)
        self._tiles.use(tiles, self._core.revision)

    def _make_room(self, coming: int, needed: frozenset[Key]) -> None:
        surplus = self._tiles.surplus(coming, needed)
        if self._tiles.changed_since(self._saved_revision, surplus):
            self._try_to_save()
        unsaved = self._tiles.changed_since(self._saved_revision, surplus)
        self._forget([tile for tile in surplus if tile not in unsaved])
        if unsaved and len(self._tiles) + coming > OVERDRAFT * self._limit + len(needed):
            raise MapError(f"nothing can be saved: {self.trouble}", "store_stuck")

    def _try_to_save(self) -> None:
        try:
            self.save()
        except StoreError as error:
            if error.reason == "out_of_step":
                raise

    def _forget(self, tiles: list[Key]) -> None:
        self._core.drop_tiles(tiles)
        self._tiles.drop(tiles)
        self.counters.tiles_dropped += len(tiles)

    def _note_damage(self, damaged: dict[Key, str]) -> None:
        if not damaged:
            return
        self._damaged |= damaged
        self._lost |= damaged.keys()
        self.counters.bricks_damaged += len(damaged)
        self._try_to_save()


def _sealed(snapshot: Snapshot) -> Snapshot:
    return replace(snapshot, position=made(snapshot.position))


def _weakly(fetch: Callable[[list[Key]], None]) -> Callable[[list[Key]], None]:
    """Weak callback for the core, so that the core does not keep a closed store alive."""
    method = weakref.WeakMethod(fetch)

    def ask(tiles: list[Key]) -> None:
        target = method()
        if target is None:
            raise StoreError("the map's file is closed", "closed")
        target(tiles)

    return ask
