"""The map as the map stream serves it to clients.

One worker thread, which is not the mapping thread, uses all of this. It reads the map under the
map's locks, for some milliseconds at most.
"""

import math
import weakref
import zlib
from collections.abc import Callable, Iterable
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd import _core
from mapperd.errors import StoreError
from mapperd.mapping.core_args import prior_log_odds
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.encoder import BlockEncoder
from mapperd.server.map_index import BlockIndex, ChangedRows, StoredBricks, vector_of
from mapperd.server.priority_queue import Part
from mapperd.server.subscription import Subscription
from mapperd.store.metadata import MapIdentity, fresh
from mapperd.store.tiles import Key
from mapperd.wire.messages import Interest, MapInfo, Resume, Vector

__all__ = ["MapFile", "MapSource", "MapStorage", "MapView", "Source", "why_not"]


def why_not(  # noqa: PLR0911 one reason each
    resume: Resume,
    interest: Interest,
    *,
    map_id: str,
    identity: MapIdentity,
    looked: int,
    newest: int,
    has_losses: bool,
) -> str:
    """Return why a client cannot resume; "" if it can.

    Args:
        resume: what the client holds.
        interest: what the client wants.
        map_id: id of the map, as clients know it.
        identity: of the map.
        looked: highest revision that any client can have completely.
        newest: newest revision of the map.
        has_losses: a part of the map's file was damaged.
    """
    held = (resume.level, resume.detail, resume.radius_m, resume.box)
    if resume.map != map_id:
        return "another_map"
    if held != (interest.level, interest.detail, interest.radius_m, interest.box):
        return "another_interest"
    if interest.radius_m > 0:
        return "moving_interest"  # the position of the vehicle then is unknown
    if resume.revision is None:
        return "never_complete"
    claimed = max(resume.revision, resume.newest or 0)
    if resume.session == identity.session:
        return "" if resume.revision <= looked and claimed <= newest else "never_told"
    kept = identity.valid_up_to(resume.session)
    if kept is None:
        return "unknown_session"
    if resume.newest is None or claimed > kept:
        return "not_kept"
    return "map_damaged" if has_losses else ""


BLOCKS_AT_ONCE = 1 << 16
"""Blocks of the stream that one look indexes."""

BRICKS_AT_ONCE = 32
"""Bricks of the file that one look indexes."""

UNUSED_NS = 60_000_000_000
"""Time after which an unused index is dropped."""

ATTEMPTS = 4

NO_BRICKS = np.zeros((0, 3), np.int32)

Origin = tuple[float, float] | None


class MapFile(Protocol):
    """The map's file: `TileStore` while this process writes it."""

    @property
    def path(self) -> Path:
        """Return where it is."""

    @property
    def identity(self) -> MapIdentity:
        """Return which map it holds."""

    @property
    def lost(self) -> AbstractSet[Key]:
        """Return the damaged bricks."""

    def suspect(self, keys: Iterable[Key]) -> None:
        """Report bricks that were found damaged."""


class MapStorage(Protocol):
    """Storage of the map: `mapperd.pipeline.persistence`."""

    @property
    def store(self) -> MapFile | None:
        """The map's file; None if the map is only in memory."""


class MapSource:
    """Watches one map for all clients; a context manager.

    Args:
        sonar_map: the map; create this before mapping begins.
        keep: storage of the map.
        log_odds_step: step of the quantised log-odds.
        origin_deg: returns latitude and longitude of the map's zero; None if unknown.

    Raises:
        StoreError: the map's file cannot be opened.

    Attributes:
        now_ns: Unix time of the last look.
        trouble: why the map's file cannot be read at the moment; None if it can.
        encoder: encodes blocks as messages.
    """

    def __init__(
        self,
        sonar_map: SonarMap,
        keep: MapStorage,
        *,
        log_odds_step: float = 0.25,
        origin_deg: Callable[[], Origin] = lambda: None,
    ) -> None:
        self.now_ns = 0
        self.trouble: str | None = None
        self._map = sonar_map
        self._core = sonar_map.core
        self._store = keep.store
        self._step = log_odds_step
        self._origin_deg = origin_deg
        path = None if self._store is None else self._store.path
        self._files = None if path is None else StoredBricks(path, sonar_map.config)
        self.encoder = BlockEncoder(self._core, self._files)
        self._subscriptions: weakref.WeakSet[Subscription] = weakref.WeakSet()
        self._views: dict[tuple[int, str], BlockIndex] = {}
        self._revision, self._replaced_at, *_ = self._core.changed_blocks(1 << 62, NO_BRICKS)
        self._identity = fresh() if self._store is None else self._store.identity
        self._file_version: int | None = None
        self._info = self._current_info()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the map's file."""
        if self._files is not None:
            self._files.close()

    @property
    def session(self) -> str:
        """Id of the session that counts the revisions."""
        return self._identity.session

    @property
    def revision(self) -> int:
        """Revision of the map at the last look."""
        return self._revision

    @property
    def indexing(self) -> int:
        """Blocks in memory and bricks in the file that are still to be indexed."""
        return sum(view.left for view in self._views.values())

    @property
    def memory_bytes(self) -> int:
        """Memory of the indexes and of all subscriptions."""
        views = sum(view.memory_bytes for view in self._views.values())
        return views + sum(one.memory_bytes for one in self._subscriptions)

    def info(self) -> MapInfo:
        """Return what clients must know about the map."""
        return self._info

    def subscribe(self, interest: Interest, resume: Resume | None = None) -> Subscription:
        """Begin a client's subscription.

        Args:
            interest: the part of the map that the client wants.
            resume: what the client claims to hold.
        """
        known_up_to, reason = None, ""
        if resume is not None:
            reason = self._why_not(resume, interest)
            known_up_to = resume.revision if not reason else None
        one = Subscription(self, interest, known_up_to, reason)
        self._subscriptions.add(one)
        return one

    def view_of(self, interest: Interest) -> BlockIndex:
        """Return the index of blocks for the level and detail of an interest."""
        key = interest.level, interest.detail
        view = self._views.get(key)
        if view is None:
            core_view = _core.StreamView(
                interest.level,
                interest.detail,
                log_odds_step=self._step,
                occupied_log_odds=self._info.occupied_log_odds,
                free_log_odds=self._info.free_log_odds,
            )
            view = self._views[key] = BlockIndex(interest.level, core_view, self._map.resolution_m)
        view.unused_since_ns = None
        return view

    def look(self, now_ns: int, position_m: ArrayLike | None = None) -> None:
        """Find what changed since the last look.

        Args:
            now_ns: Unix time.
            position_m: (3,) of the vehicle, map frame; the nearest changes are indexed first.
        """
        self.now_ns = now_ns
        self.trouble = None
        self.encoder.begin(now_ns)
        try:
            self._look(vector_of(position_m))
        except StoreError as error:
            self.trouble = str(error)
            self._file_version = None
        self._forget_unused()

    def _look(self, position_m: Vector | None) -> None:
        self._notice_another_map()
        rows, changed, calm = self._changes()
        self._revision, replaced_at, blocks, revisions, here = changed
        if replaced_at != self._replaced_at:
            self._replaced_at, self._identity = replaced_at, fresh()
            self._start_again()
            rows, changed, calm = self._changes()
            self._revision, _, blocks, revisions, here = changed
        self.encoder.times.note(self._revision, self.now_ns)
        for view in self._views.values():
            view.note_blocks(blocks[revisions > view.looked])
            if rows is not None:
                away = ~here & (rows.revisions > view.in_file)
                at = None if view.in_file < 0 else self._revision
                view.note_bricks(rows.keys[away], at)
                view.in_file = rows.revision
            view.looked = self._revision
            view.work(self._core, position_m, BLOCKS_AT_ONCE)
            if self._files is not None:
                view.work_on_file(self._files, position_m, BRICKS_AT_ONCE)
            if calm and not view.left:
                view.settled = self._revision
        self._notice_damage()

    def _changes(self) -> "tuple[ChangedRows | None, _Changed, bool]":
        """Find what changed in the file and in memory since the last look.

        A tile is in the file before it leaves memory. So each change is in one or the other, unless
        the file is written to between the two looks.

        Returns:
            rows of the file; changes in memory, and which bricks of the rows are in memory;
            whether both are of one state.
        """
        views = self._views.values()
        since = min((view.looked for view in views), default=self._revision)
        if self._files is None or not views:
            return None, self._core.changed_blocks(since, NO_BRICKS), True
        in_file = min(view.in_file for view in views)
        for _ in range(ATTEMPTS):
            version = self._files.version()
            rows = None
            if version != self._file_version or in_file < 0:
                rows = self._files.changed_since(in_file)
                self._core.raise_revision(rows.revision)  # if another process writes the file
            bricks = NO_BRICKS if rows is None else rows.keys
            changed = self._core.changed_blocks(since, bricks)
            if self._files.version() == version:
                self._file_version = version
                return rows, changed, True
        self._file_version = None
        return rows, changed, False

    def _notice_damage(self) -> None:
        """Report to the clients and to the mapping thread what is damaged in the file."""
        if self._files is None or self._store is None:
            return
        if found := self._files.damaged - self._store.lost:
            self._store.suspect(found)
        if self._info.bricks_lost != self._bricks_lost():
            self._start_again()

    def _bricks_lost(self) -> int:
        if self._files is None or self._store is None:
            return 0
        return len(self._store.lost | self._files.damaged | self._files.quarantined)

    def _notice_another_map(self) -> None:
        """Start again if the map was replaced or its description changed."""
        if self._store is not None:
            self._identity, before = self._store.identity, self._identity
            if before.map != self._identity.map:
                if self._files is not None:
                    self._files.damaged.clear()
                    self._files.quarantined = frozenset()
                self._start_again()
        if self._info != self._current_info():
            self._start_again()

    def _start_again(self) -> None:
        self._info = self._current_info()
        self._views.clear()
        self._file_version = None
        for one in list(self._subscriptions):
            one.restart()

    def _current_info(self) -> MapInfo:
        config = self._map.config
        resolution_m = self._map.resolution_m
        occupied = _log_odds(config.occupied_threshold)
        free = _log_odds(config.free_threshold)
        # A map of another description is another map for a client that resumes.
        prior = prior_log_odds(config)
        values = (resolution_m, self._step, occupied, free, *((prior,) if prior else ()))
        way = zlib.crc32(repr(values).encode())
        return MapInfo(
            id=f"{self._identity.map}-{way:08x}",
            resolution_m=resolution_m,
            log_odds_step=self._step,
            occupied_log_odds=occupied,
            free_log_odds=free,
            frame=config.frames.map,
            origin_deg=self._origin_deg(),
            bricks_lost=self._bricks_lost(),
            prior_log_odds=prior,
        )

    def _why_not(self, resume: Resume, interest: Interest) -> str:
        try:
            return why_not(
                resume,
                interest,
                map_id=self._info.id,
                identity=self._identity,
                looked=self._revision,
                newest=self._core.revision,
                has_losses=self._files is not None and self._files.has_losses(),
            )
        except StoreError:
            return "store_unreadable"

    def _forget_unused(self) -> None:
        for key, view in list(self._views.items()):
            if view.listeners:
                continue
            if view.unused_since_ns is None:
                view.unused_since_ns = self.now_ns
            elif self.now_ns - view.unused_since_ns > UNUSED_NS:
                del self._views[key]


_Changed = tuple[int, int, NDArray[np.int32], NDArray[np.uint64], NDArray[np.bool_]]


def _log_odds(probability: float) -> float:
    return math.log(probability / (1 - probability))


class MapView(Protocol):
    """The map as one client sees it: what was sent, and what is still to be sent."""

    resumed: bool
    """Whether the client may keep what it held."""

    reason: str
    """Why it may not."""

    @property
    def number(self) -> int:
        """Number of the last message."""

    @property
    def left(self) -> int:
        """Blocks that are still to be sent."""

    @property
    def near_left(self) -> int:
        """Near blocks that are left of this pass after the last message."""

    def next(self, position_m: Vector | None, most_bytes: int, part: Part = "any") -> bytes | None:
        """Return the next message as bytes of the wire; None if nothing is left.

        Args:
            position_m: (3,) of the vehicle, map frame; the nearest blocks come first.
            most_bytes: approximate limit; a message has at least one block.
            part: part of the map to send.
        """

    def change(self, interest: Interest) -> None:
        """Change the interest."""

    def settle(self, number: int) -> None:
        """Note that the client has used the messages up to this one."""

    def resume(self, interest: Interest, number: int) -> bool:
        """Resume after a message: the blocks of later ones are sent again.

        Returns:
            whether the client may keep what it holds.
        """

    def close(self) -> None:
        """End the view."""


class Source(Protocol):
    """The map that a server serves, used in its worker thread only."""

    @property
    def session(self) -> str:
        """Id of the session that counts the revisions."""

    @property
    def revision(self) -> int:
        """Revision of the map at the last look."""

    def info(self) -> MapInfo:
        """Return what clients must know about the map."""

    def look(self, now_ns: int, position_m: Vector | None = None) -> None:
        """Find what changed since the last look, nearest to the vehicle first.

        Args:
            now_ns: Unix time.
            position_m: (3,) of the vehicle, map frame.
        """

    def subscribe(self, interest: Interest, resume: Resume | None = None) -> MapView:
        """Begin the view of a client."""
