"""Keeps a session's map in its file, with all that is needed to go on after a kill.

The estimators are written as bytes only now and then, between two chunks. In between, the file
says how many pieces of work came since: who goes on takes the estimators as they were, lets them
make the same work again, leaves out what is in the map, and does the rest.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from mapperd.errors import StoreError
from mapperd.localization.session import LocalizationSession, saved_state
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.decoder import SessionDecoder, Work
from mapperd.pipeline.pose_lookup import FixedPose, origin_of
from mapperd.pipeline.watchdog import Worker
from mapperd.store.checkpoint import encode_state
from mapperd.store.position import Position, RecordingOffset, RecordingOffsets
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore
from mapperd.store.transfer import Snapshot

__all__ = ["SqlitePersistence"]

PATIENCE_S = 2.0
"""A save waits so long for the recording to be written, and for the thread of the pings."""

LOOK_S = 0.05

COST = 50
"""Between two checkpoints lies so many times what one of them takes: at most 2 % of the time."""


@dataclass(slots=True)
class _Point:
    """A checkpoint: of a moment between two chunks."""

    number: int
    works: int
    config: dict[str, Any] | None
    fixed: bool
    checkpoint: bytes
    localization: bytes = b""
    place: RecordingOffset | None = None


class SqlitePersistence:
    """Keeps the map of one session, as `mapperd.pipeline.persistence.MapPersistence` says.

    Args:
        store: the map's file, open.
        sonar_map: its map.
        session: id.
        sessions: those before it since the map was empty.
        interval_s: between saves; asked each time.
        resumed: where the file says that the session goes on.
        on_trouble: is told why nothing can be saved, and None when that is over.
    """

    def __init__(
        self,
        store: TileStore,
        sonar_map: SonarMap,
        session: str,
        sessions: tuple[str, ...] = (),
        *,
        interval_s: Callable[[], float] = lambda: 5.0,
        resumed: Position | None = None,
        on_trouble: Callable[[str | None], None] = lambda _: None,
    ) -> None:
        self.store = store
        self._map = sonar_map
        self._session = session
        self._sessions = tuple(one for one in sessions if one != session)
        self._interval_s = interval_s
        self._resumed = resumed
        self._on_trouble = on_trouble
        self._done = 0
        self._next: _Point | None = None
        self._wanted: _Request | None = None
        self._saving = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._save_on, name="saving", daemon=True)
        self._began = self._ended = self._stuck = False
        self._checked_s = self._pause_s = 0.0
        self._wake: Callable[[], None] = lambda: None

    def begin(
        self,
        engine: SessionDecoder,
        places: RecordingOffsets,
        wake: Callable[[], None],
        localizing: LocalizationSession | None = None,
    ) -> None:
        """Begin the session: nothing is in the map of it, but what `resumed` says.

        Args:
            engine: as it is before the first chunk.
            places: of the recording.
            wake: lets the thread of the pings come to `between` soon.
            localizing: what the poses depend on; None where they do not.
        """
        self._localizing = localizing
        self._engine, self._places, self._wake = engine, places, wake
        self._point = self._point_at(0, 0)
        self._complete(self._point)
        self._began = True
        if self._resumed is not None:
            self._point.place = self._resumed.place
            self._point.checkpoint = self._resumed.checkpoint
            self._point.localization = self._resumed.localization
        self._checked_s = time.monotonic()
        self._advance()
        if self._resumed is None:
            self._try_to_save()  # from the first byte on, the recording is found after a kill
        self._thread.start()

    def skip(self, works: int) -> None:
        """So many pieces of work since the checkpoint are in the map already."""
        self._done = works
        self._advance()

    def between(self, number: int, waiting: int) -> None:
        """A moment between two pieces of work, and between two chunks.

        Args:
            number: of the piece of the recording that was taken last.
            waiting: pieces of work that wait.
        """
        now_s = time.monotonic()
        pause_s = max(min(self._interval_s(), 5.0), self._pause_s)
        if self._next is None and now_s - self._checked_s >= pause_s:
            self._next = self._point_at(number, self._done + waiting)
            self._checked_s = time.monotonic()
            self._pause_s = COST * (self._checked_s - now_s)
        self._settle()
        request = self._wanted
        if request is not None:
            self._wanted = None
            request.serve(self.store)

    def done(self, work: Work) -> None:  # noqa: ARG002 each counts
        """A piece of work is in the map."""
        self._done += 1
        self._settle()
        self._advance()

    def reset(self) -> None:
        """Empty the map.

        Raises:
            StoreError: it cannot be; nothing is changed.
        """
        before, self._sessions = self._sessions, ()
        try:
            self.store.reset()
        except StoreError:
            self._sessions = before
            raise

    def end(self) -> None:
        """All of the session is in the map: save it, in the thread of the pings."""
        self.stop()
        position = Position(
            self._session, whole=True, sessions=self._all_sessions, origin_deg=self._origin_deg()
        )
        self.store.advance(partial(self._sealed_whole, position))
        self._try_to_save()

    def stop(self) -> None:
        """Save nothing any more by itself."""
        self._ended = True
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    def save(self) -> int | None:
        """Bring the map to the disk; not in the thread of the pings, nor in an event loop.

        Returns:
            bytes written.

        Raises:
            StoreError: it cannot be written.
        """
        with self._saving:
            before = self.store.bytes_written
            if not self._ended:
                self.store.write(self._asked())
            return self.store.bytes_written - before

    def whole(self) -> SonarMap:
        """The whole map, as it was saved last, in memory.

        Raises:
            StoreError: it cannot be read.
        """
        whole = SonarMap(self._map.config)
        with StoreReader(self.store.path) as reader:
            reader.load(whole)
        return whole

    def worker(self) -> Worker:
        """For a watchdog: the thread that writes."""
        counters = self.store.counters
        done = counters.saves + counters.saves_failed
        return Worker("saving", int(self._saving.locked()), done)

    def status(self) -> dict[str, Any]:
        """For a person."""
        return {
            "path": str(self.store.path),
            **self.store.status(),
            "checkpoint_bytes": len(self._point.checkpoint) if self._began else 0,
        }

    @property
    def path(self) -> Path:
        """Of the map's file."""
        return self.store.path

    @property
    def _all_sessions(self) -> tuple[str, ...]:
        return (*self._sessions, self._session)

    def _try_to_save(self) -> None:
        try:
            self.store.save()
        except StoreError as error:
            self._on_trouble(str(error))
        else:
            self._on_trouble(None)

    def _asked(self) -> Snapshot:
        """Ask the thread of the pings for a snapshot."""
        request = _Request()
        self._wanted = request
        self._wake()
        until_s = time.monotonic() + PATIENCE_S
        while not request.ready.wait(LOOK_S):
            if self._ended or time.monotonic() > until_s:
                self._wanted = None
                raise StoreError(f"{self.store.path}: a ping is being mapped", "busy")
        if request.error is not None:
            raise request.error
        assert request.snapshot is not None  # noqa: S101 it is ready
        return request.snapshot

    def _point_at(self, number: int, works: int) -> _Point:
        engine = self._engine
        return _Point(
            number,
            works,
            msgspec.to_builtins(engine.config),
            isinstance(engine.poses, FixedPose),
            encode_state(engine.state()),
        )

    def _settle(self) -> None:
        """Use a newer checkpoint once all the work that it had given is done."""
        if self._next is not None and self._done >= self._next.works:
            if self._done == self._next.works:
                self._point = self._next
                self._complete(self._point)
            self._next = None

    def _complete(self, point: _Point) -> None:
        """Add what only the work before the checkpoint brings about."""
        if self._localizing is not None:
            began_s = time.monotonic()
            point.localization = saved_state(self._localizing)
            self._pause_s += COST * (time.monotonic() - began_s)

    def _advance(self) -> None:
        point, done = self._point, self._done - self._point.works
        self.store.advance(partial(self._sealed, point, done, self._places.newest))

    def _sealed(self, point: _Point, done: int, newest: int) -> bytes:
        """A position as it is written: all that it stands on is written before."""
        self._await(newest)
        point.place = point.place or self._places.place_of(point.number)
        if point.place is None:
            raise StoreError("nobody knows any more where the recording goes on", "busy")
        return Position(
            self._session,
            whole=False,
            sessions=self._all_sessions,
            place=point.place,
            done=done,
            config=point.config,
            fixed=point.fixed,
            checkpoint=point.checkpoint,
            origin_deg=self._origin_deg(),
            localization=point.localization,
        ).encoded()

    def _origin_deg(self) -> tuple[float, float] | None:
        """Where the map's zero is, so that the next session has it there too."""
        return origin_of(self._map.config, self._engine.poses)

    def _sealed_whole(self, position: Position) -> bytes:
        self._await(self._places.newest)
        return position.encoded()

    def _await(self, number: int) -> None:
        """Wait for the recording; a disk that is full is waited for once, and not with each ping.

        Raises:
            StoreError: it is not written.
        """
        patience_s = 0.0 if self._stuck else PATIENCE_S
        self._stuck = not self._places.wait_for(number, patience_s)
        if self._stuck:
            raise StoreError("the recording is not written yet", "busy")

    def _save_on(self) -> None:
        while not self._stop.wait(self._interval_s()):
            try:
                self.save()
            except StoreError as error:
                self._on_trouble(str(error))
            else:
                self._on_trouble(None)


class _Request:
    """Somebody waits for a snapshot."""

    def __init__(self) -> None:
        self.ready = threading.Event()
        self.snapshot: Snapshot | None = None
        self.error: StoreError | None = None

    def serve(self, store: TileStore) -> None:
        """In the thread of the pings."""
        try:
            self.snapshot = store.take()
        except StoreError as error:
            self.error = error
        self.ready.set()
