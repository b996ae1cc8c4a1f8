"""Verifies the checksums and the structure of a large map file while pings are mapped into it."""

import threading
from collections.abc import Callable

from mapperd.errors import StoreError
from mapperd.store.database import open_reader
from mapperd.store.tile_store import TileStore
from mapperd.store.transfer import check_structure, damaged_rows

__all__ = ["Verification"]

PAUSE_S = 0.002
"""Between two reads, which leaves the disk and the processor to the pings."""

INSTRUCTIONS = 10_000
"""Of SQLite between two looks at whether to stop."""


class Verification:
    """Reads a whole file once, in a thread of `start`; the store receives the damaged bricks.

    Args:
        store: open.
        on_end: called in the thread with what is wrong with the structure of the file, or with
            None if it is sound; not called after `stop`.

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
        """Start to read."""
        self.state = "running"
        self._thread.start()

    def stop(self) -> None:
        """End the thread, whether or not all is read."""
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
