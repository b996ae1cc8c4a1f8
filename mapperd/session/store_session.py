"""Keeps a session's map in its file, with all that is needed to resume after a crash.

A checkpoint of the estimators is written only at intervals, between two chunks. In between, the
file holds the number of pieces of work since the checkpoint. A recovery restores the checkpoint,
decodes the recording from there, skips the work that is in the map, and does the rest.
"""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
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
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore
from mapperd.store.transfer import Snapshot

__all__ = ["SqlitePersistence"]

TIMEOUT_S = 2.0
"""How long a save waits for the recording to be written, and for the mapping thread."""

POLL_INTERVAL_S = 0.05

COST = 50
"""Minimum time between two checkpoints in durations of one: they take at most 2 % of the time."""


@dataclass(slots=True)
class _SavePoint:
    """A checkpoint between two chunks."""

    number: int
    works: int
    config: dict[str, Any] | None
    fixed: bool
    checkpoint: bytes
    localization: bytes = b""
    surface: bytes = b""
    place: RecordingOffset | None = None


class SqlitePersistence:
    """Keeps the map of one session in a file; see `mapperd.pipeline.persistence.MapPersistence`.

    Args:
        store: the map's file, open.
        sonar_map: its map.
        session: id.
        earlier: position of the file at the end of the sessions before; None in a new file.
        not_mapped: recorded sessions that are not in the map, and why.
        data_lost: whether some of them belong to this map.
        interval_s: returns the time between saves.
        resumed: position of the file within this session.
        on_trouble: called with why saving fails, and with None when it works again.
        on_damage: called with the number of bricks that were found damaged since the last call.
        on_begin: called when the file holds the beginning of the session durably.
        on_loss: called at the end with what of the session is not in the file.
        on_broken: called with the error when a reader finds the file damaged as a whole.
        must_begin: whether a session that the file cannot take is refused at its beginning.
    """

    def __init__(
        self,
        store: TileStore,
        sonar_map: SonarMap,
        session: str,
        earlier: Position | None = None,
        *,
        not_mapped: Mapping[str, str] = MappingProxyType({}),
        data_lost: bool = False,
        interval_s: Callable[[], float] = lambda: 5.0,
        resumed: Position | None = None,
        on_trouble: Callable[[str | None], None] = lambda _: None,
        on_damage: Callable[[int], None] = lambda _: None,
        on_begin: Callable[[], None] = lambda: None,
        on_loss: Callable[[str], None] = lambda _: None,
        on_broken: Callable[[StoreError], None] = lambda _: None,
        must_begin: bool = True,
    ) -> None:
        self.store = store
        self._map = sonar_map
        self._session = session
        self._earlier = earlier
        before = () if earlier is None else earlier.sessions
        self._sessions = tuple(one for one in before if one != session)
        self._emptied = () if earlier is None else earlier.emptied
        self._incomplete = {} if earlier is None else dict(earlier.incomplete)
        self._ends = {} if earlier is None else earlier.ends
        self._not_mapped = dict(not_mapped)
        self._data_lost = data_lost
        self._interval_s = interval_s
        self._resumed = resumed
        self._on_trouble = on_trouble
        self._on_damage = on_damage
        self._on_begin = on_begin
        self._on_loss = on_loss
        self._on_broken = on_broken
        self._must_begin = must_begin
        self._loss: str | None = None
        self._pings_lost = 0
        self._lost_before = store.lost
        self._unrecorded = () if earlier is None else earlier.unrecorded
        self._damage_reported = store.counters.bricks_damaged
        self._done = 0
        self._next: _SavePoint | None = None
        self._wanted: _PendingSnapshot | None = None
        self._saving = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._save_on, name="saving", daemon=True)
        self._began = self._ended = self._stuck = False
        self._checked_s = self._pause_s = 0.0
        self._wake: Callable[[], None] = lambda: None

    def begin(
        self,
        decoder: SessionDecoder,
        offsets: RecordingOffsets,
        wake: Callable[[], None],
        localization: LocalizationSession | None = None,
    ) -> None:
        """Begin the session, or resume it at `resumed`.

        Args:
            decoder: before its first chunk.
            offsets: of the recording.
            wake: makes the mapping thread call `between` soon.
            localization: the one that affects the map; None without one.

        Raises:
            StoreError: the file cannot take the beginning of the session, and must; or an earlier
                session is not in it as a whole, and not stated to be incomplete.
        """
        earlier = self._earlier
        if self._resumed is None and earlier is not None and not earlier.states_all:
            text = f"{self.store.path}: session {earlier.session} is not in the map as a whole"
            raise StoreError(f"{text}; the next start maps the rest", "out_of_step")
        self._localization = localization
        self._decoder, self._offsets, self._wake = decoder, offsets, wake
        self._point = self._point_at(0, 0)
        self._complete(self._point)
        self._began = True
        if self._resumed is not None:
            self._point.place = self._resumed.place
            self._point.checkpoint = self._resumed.checkpoint
            self._point.localization = self._resumed.localization
            self._point.surface = self._resumed.surface
        self._checked_s = time.monotonic()
        self._advance()
        if self._resumed is None:
            self._save_beginning()
        self._on_begin()
        self._thread.start()

    def skip(self, works: int) -> None:
        """Declare that `works` pieces of work since the checkpoint are in the map already."""
        self._done = works
        self._advance()

    def between(self, number: int, waiting: int) -> None:
        """Make a checkpoint if one is due, and serve a waiting save.

        Args:
            number: of the last decoded piece of the recording.
            waiting: number of waiting pieces of work.
        """
        now_s = time.monotonic()
        pause_s = max(min(self._interval_s(), 5.0), self._pause_s)
        if self._next is None and now_s - self._checked_s >= pause_s:
            self._next = self._point_at(number, self._done + waiting)
            self._checked_s = time.monotonic()
            self._pause_s = COST * (self._checked_s - now_s)
        self._settle()
        self._report_damage()
        request = self._wanted
        if request is not None:
            self._wanted = None
            request.serve(self.store)

    def done(self, work: Work) -> None:  # noqa: ARG002 each counts
        """Count a finished piece of work."""
        self._done += 1
        self._settle()
        self._advance()

    def reset(self) -> None:
        """Empty the map.

        Raises:
            StoreError: the map cannot be emptied; it is unchanged.
        """
        before = self._sessions, self._emptied, self._incomplete, self._unrecorded
        self._sessions, self._emptied = (), (*self._emptied, *self._sessions)
        self._incomplete, self._unrecorded, self._data_lost = {}, (), False
        try:
            self.store.reset()
        except StoreError:
            self._sessions, self._emptied, self._incomplete, self._unrecorded = before
            raise
        self._pings_lost = 0

    def lacks(self, why: str) -> None:
        """Note that a part of the session's recording is not in the map."""
        self._incomplete = {**self._incomplete, self._session: why}

    def lose_ping(self, why: str) -> None:
        """Note that a ping of the session is not in the map."""
        self._pings_lost += 1
        self.lacks(f"pings were not mapped: {why}")

    def end(self) -> None:
        """Save the whole session, in the mapping thread."""
        self.stop()
        self._report_damage()
        self._loss = self._save_whole()
        if (loss := self._stated_loss) is not None:
            self._on_loss(loss)
        self._try_to_sync()

    def stop(self) -> None:
        """Stop saving at intervals."""
        self._ended = True
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    def save(self) -> int | None:
        """Write the map to the disk; return the written bytes. Blocks; not in the mapping thread.

        Raises:
            StoreError: the file cannot be written.
        """
        with self._saving:
            before = self.store.bytes_written
            if not self._ended:
                self.store.write(self._request_snapshot())
            return self.store.bytes_written - before

    def whole(self) -> StoredMap:
        """Return the whole map, as last saved; after the end, with what could not be saved.

        The caller closes it.

        Raises:
            StoreError: the file cannot be read, or its structure is damaged.
        """
        unsaved = [] if self._loss is None else self.store.unsaved()
        try:
            whole = StoredMap(
                self.store.path,
                self._map.config,
                unsaved={key: brick for key, _, brick in unsaved},
                incomplete=self._lost_before,
            )
        except StoreError as error:
            if error.reason == "damaged":
                self._on_broken(error)
            raise
        self.store.suspect(whole.lost)
        return whole

    @property
    def unsaved(self) -> str | None:
        """Why the file lacks a part of the session after the end; None if it lacks none."""
        return self._loss

    def worker(self) -> Worker:
        """Return the progress of the saving thread for the watchdog."""
        return Worker("saving", int(self._saving.locked()), self.store.steps)

    def status(self) -> dict[str, Any]:
        """Return the status of the file for a person."""
        return {
            "path": str(self.store.path),
            **self.store.status(),
            "checkpoint_bytes": len(self._point.checkpoint) if self._began else 0,
            "sessions_not_mapped": self._not_mapped | self._incomplete,
            "data_lost": self._data_lost or bool(self._incomplete),
            "loss": self._stated_loss,
        }

    @property
    def _stated_loss(self) -> str | None:
        """What of the session is not in the file, for a person."""
        lost = f"{self._pings_lost} {self._incomplete.get(self._session)}"
        losses = [lost] if self._pings_lost else []
        if self._loss is not None:
            losses.append(self._loss)
        return "; ".join(losses) or None

    @property
    def path(self) -> Path:
        """Path of the map's file."""
        return self.store.path

    @property
    def _all_sessions(self) -> tuple[str, ...]:
        return (*self._sessions, self._session)

    def _report_damage(self) -> None:
        """Take over what other readers of the file found, and report new damage."""
        try:
            self.store.settle_suspects()
        except StoreError as error:
            self._on_trouble(str(error))
        found = self.store.counters.bricks_damaged
        if found != self._damage_reported:
            self._on_damage(found - self._damage_reported)
            self._damage_reported = found

    def _save_beginning(self) -> None:
        """Save, so that a recovery finds the recording from the first byte on."""
        try:
            self.store.save()
        except StoreError as error:
            if self._must_begin:
                raise
            self._on_trouble(str(error))
        else:
            self._on_trouble(None)
        self._try_to_sync()

    def _save_whole(self) -> str | None:
        """Save the whole session, or what there is space for; return what is not in the file.

        While the recording has the whole session, the file stays at its last save: the next start
        maps the rest. Otherwise the file is the only place for the map.
        """
        position = self._last_position()
        self.store.advance(partial(self._sealed_whole, position))
        try:
            self.store.save()
        except StoreError as error:
            self._on_trouble(str(error))
            if not (self._stuck or self._offsets.missing):
                return f"{error}; the next start maps the rest from the recording"
        else:
            self._on_trouble(None)
            return None
        return self._save_part(self._last_position())

    def _save_part(self, position: Position) -> str | None:
        self._lost_before = self.store.lost
        self.store.advance(position.encoded())
        try:
            self.store.save()
        except StoreError as error:
            reason = str(error)
        else:
            self._on_trouble(None)
            return None
        whole, self._incomplete = self._incomplete, {**self._incomplete, self._session: reason}
        self.store.advance(self._last_position().encoded())
        try:
            count = self.store.save_part()
        except StoreError as error:
            return f"{error}; nothing since the last save is in the file, nor in a recording"
        if count:
            return f"{reason}; {count} bricks are not in the file, and count as lost"
        self._incomplete = whole
        return None

    def _last_position(self) -> Position:
        """Return the position at the end of the session."""
        unrecorded = self._unrecorded
        if self._stuck or self._offsets.missing:
            unrecorded = (*unrecorded, self._session)
        return Position(
            self._session,
            whole=True,
            sessions=self._all_sessions,
            origin_deg=self._origin_deg(),
            emptied=self._emptied,
            incomplete=self._incomplete,
            unrecorded=unrecorded,
            ends=self._known_ends(self._offsets.end),
        )

    def _known_ends(self, end: RecordingOffset | None) -> dict[str, RecordingOffset]:
        """Return the ends of the recordings of the sessions in the map."""
        ends = {one: self._ends[one] for one in self._sessions if one in self._ends}
        return ends if end is None else {**ends, self._session: end}

    def _try_to_sync(self) -> None:
        if self.store.trouble is None:
            try:
                self.store.sync()
            except StoreError as error:
                self._on_trouble(str(error))

    def _request_snapshot(self) -> Snapshot:
        """Request a snapshot from the mapping thread and wait for it."""
        request = _PendingSnapshot()
        self._wanted = request
        self._wake()
        until_s = time.monotonic() + TIMEOUT_S
        while not request.ready.wait(POLL_INTERVAL_S):
            if self._ended or time.monotonic() > until_s:
                self._wanted = None
                raise StoreError(f"{self.store.path}: a ping is being mapped", "busy")
        if request.error is not None:
            raise request.error
        assert request.snapshot is not None  # noqa: S101 it is ready
        return request.snapshot

    def _point_at(self, number: int, works: int) -> _SavePoint:
        decoder = self._decoder
        return _SavePoint(
            number,
            works,
            msgspec.to_builtins(decoder.config),
            isinstance(decoder.poses, FixedPose),
            encode_state(decoder.state()),
        )

    def _settle(self) -> None:
        """Use the newer checkpoint once all work before it is done."""
        if self._next is not None and self._done >= self._next.works:
            if self._done == self._next.works:
                self._point = self._next
                self._complete(self._point)
            self._next = None

    def _complete(self, point: _SavePoint) -> None:
        """Add the states that depend on the work before the checkpoint."""
        if self._map.surface is not None:
            point.surface = encode_state(self._map.surface.state())
        if self._localization is not None:
            began_s = time.monotonic()
            point.localization = saved_state(self._localization)
            self._pause_s += COST * (time.monotonic() - began_s)

    def _advance(self) -> None:
        point, done = self._point, self._done - self._point.works
        self.store.advance(partial(self._sealed, point, done, self._offsets.newest))

    def _sealed(self, point: _SavePoint, done: int, newest: int) -> bytes:
        """Return the position to write; the recording up to it is written before."""
        self._await(newest)
        point.place = point.place or self._offsets.place_of(point.number)
        if point.place is None:
            raise StoreError("the position in the recording is not known any more", "busy")
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
            surface=point.surface,
            emptied=self._emptied,
            incomplete=self._incomplete,
            unrecorded=self._unrecorded,
            ends=self._known_ends(None),
        ).encoded()

    def _origin_deg(self) -> tuple[float, float] | None:
        """Return the map's origin for the next session."""
        return origin_of(self._map.config, self._decoder.poses)

    def _sealed_whole(self, position: Position) -> bytes:
        self._await(self._offsets.newest)
        ends = self._known_ends(self._offsets.end)
        return msgspec.structs.replace(position, ends=ends).encoded()

    def _await(self, number: int) -> None:
        """Wait until the recording is written; only once for a full disk, not for each ping.

        Raises:
            StoreError: it is not written.
        """
        timeout_s = 0.0 if self._stuck else TIMEOUT_S
        self._stuck = not self._offsets.wait_for(number, timeout_s)
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


class _PendingSnapshot:
    """A pending request for a snapshot."""

    def __init__(self) -> None:
        self.ready = threading.Event()
        self.snapshot: Snapshot | None = None
        self.error: StoreError | None = None

    def serve(self, store: TileStore) -> None:
        """Take the snapshot, in the mapping thread."""
        try:
            self.snapshot = store.take()
        except StoreError as error:
            self.error = error
        self.ready.set()
