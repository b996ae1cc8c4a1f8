"""Maintains files of maps: verification, rebuilding of lost bricks, renaming of damaged files.

By IWLO the evidence of a ping does not depend on the map, and bricks are independent. To restore
lost bricks bit by bit, the same pings are mapped again and only those bricks are kept. By the arc
rule it depends on the bricks around, so all are mapped again and replaced. `Verification` checks a
large file while pings are mapped into it.
"""

import sqlite3
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path

import zstandard

from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.database import migrate, open_reader, transaction, translated
from mapperd.store.metadata import begun, progress_in, write_checksum, write_kind
from mapperd.store.position import Position, position_in
from mapperd.store.tile_store import TileStore
from mapperd.store.tiles import COLUMNS, LEVEL, BrickRow, Key, pack
from mapperd.store.transfer import check_structure, damaged_rows

__all__ = [
    "Verification",
    "packed",
    "position_of_damaged",
    "put_aside",
    "rebuild_lost",
    "write_whole",
]

MapAgain = Callable[[SonarMap], bool]
"""Maps the input again from its start to the store's position; False if parts are missing."""


def rebuild_lost(store: TileStore, sonar_map: SonarMap, map_again: MapAgain) -> int:
    """Rebuild lost bricks before anything is mapped into the store.

    Memory holds the lost bricks and one ping, or by the arc rule the whole map.

    Args:
        store: just opened.
        sonar_map: its map, for the settings.
        map_again: maps the recordings. If they are incomplete, the result is kept, but the bricks
            still count as lost.

    Returns:
        number of bricks that were lost.

    Raises:
        StoreError: the file cannot be written.
    """
    lost = store.lost
    if not lost:
        return 0
    scratch = SonarMap(sonar_map.config)
    independent = scratch.surface is None
    if independent:
        _keep_only(scratch, lost)
    whole = map_again(scratch)
    _, found = scratch.core.bricks_since(0)
    every = whole and not independent
    store.restore([(key, brick) for key, _, brick in found if every or key in lost], whole=whole)
    return len(lost)


def _keep_only(scratch: SonarMap, lost: frozenset[Key]) -> None:
    """Remove from a map, after every ping, all bricks that were not lost."""
    here: set[Key] = set()
    core = weakref.proxy(scratch.core)  # the core keeps its callbacks alive

    def fetch(tiles: list[Key]) -> None:
        core.drop_tiles([tile for tile in here if tile not in lost])
        here.intersection_update(lost)
        core.put_bricks([], tiles)
        here.update(tiles)

    core.cut_into_tiles(1, fetch)


BESIDE = ("", "-wal", "-shm")
"""Suffixes of SQLite's file and the files that belong to it."""


def put_aside(path: Path) -> Path:
    """Rename a closed store, so that its recordings can be mapped into a new one.

    Returns:
        the new path.

    Raises:
        StoreError: it cannot be renamed.
    """
    number = 1
    while (aside := path.with_name(f"{path.name}.damaged-{number}")).exists():
        number += 1
    try:
        for suffix in reversed(BESIDE):  # the main file last: until then it is detected as damaged
            beside = path.with_name(path.name + suffix)
            if beside.exists():
                beside.rename(aside.with_name(aside.name + suffix))
    except OSError as error:
        raise StoreError(f"{path}: cannot be put aside: {error.strerror}", "read_only") from error
    return aside


def position_of_damaged(path: Path) -> Position | None:
    """Return the position in a file that was put aside; None if it is not readable."""
    try:
        with closing(open_reader(path)) as connection, translated(path):
            progress = progress_in(connection, path)
        return None if progress is None else position_in(progress[1])
    except StoreError:
        return None


def packed(bricks: Iterable[tuple[Key, int, bytes]]) -> Iterator[BrickRow]:
    """Rows of bricks: (key, revision, bytes) each."""
    compressor = zstandard.ZstdCompressor(level=LEVEL)
    for key, revision, brick in bricks:
        yield pack(compressor, key, revision, brick)


def write_whole(path: Path, config: Config, revision: int, rows: Iterable[BrickRow]) -> int:
    """Create a map's file for `TileStore` and `StoreReader`.

    An interruption leaves a damaged file, so the caller renames it when complete.

    Args:
        path: the new file.
        config: the settings that the map was made with.
        revision: revision of the map.
        rows: its bricks, each once.

    Returns:
        number of bricks.

    Raises:
        StoreError: it cannot be written, or a brick occurs twice.
    """
    count = 0
    with translated(path):
        connection = sqlite3.connect(path, isolation_level=None)
        try:
            connection.execute("PRAGMA journal_mode = OFF")
            connection.execute("PRAGMA synchronous = OFF")
            migrate(connection, path)
            with transaction(connection):
                write_kind(connection, config)
                connection.execute(
                    "INSERT INTO progress (id, revision, position) VALUES (1, ?, x'')", (revision,)
                )
                write_checksum(connection)
                begun(connection, revision)
                for row in rows:
                    connection.execute(
                        f"INSERT INTO brick ({COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)",  # noqa: S608 our own text
                        (*row.key, row.revision, row.size, row.crc, row.data),
                    )
                    count += 1
        finally:
            connection.close()
    return count


PAUSE_S = 0.002
"""Pause between reads, for the disk and the processor of the pings."""

INSTRUCTIONS = 10_000
"""SQLite instructions between checks for a stop."""


class Verification:
    """Verifies checksums and structure of a whole file once, in a thread.

    Damaged bricks are reported to the store.

    Args:
        store: the open store.
        on_end: called in the thread with the damage of the file's structure, or None; not called
            after `stop`.

    Attributes:
        state: `waiting`, `running`, `done` or `failed`.
    """

    def __init__(self, store: TileStore, on_end: Callable[[StoreError | None], None]) -> None:
        self.state = "waiting"
        self._store = store
        self._on_end = on_end
        self._stopped = threading.Event()
        self._connection = open_reader(store.path)
        self._connection.set_progress_handler(self._stopped.is_set, INSTRUCTIONS)
        self._thread = threading.Thread(target=self._run, name="verification", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self.state = "running"
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread, complete or not."""
        self._stopped.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._connection.close()

    def _run(self) -> None:
        problem = None
        try:
            self._verify()
        except StoreError as error:
            problem = error
        if self._stopped.is_set():
            return
        self.state = "done" if problem is None else "failed"
        self._on_end(problem)

    def _verify(self) -> None:
        for damaged in damaged_rows(self._connection, self._store.path):
            self._store.suspect(damaged)
            if self._stopped.wait(PAUSE_S):
                return
        check_structure(self._connection, self._store.path)
