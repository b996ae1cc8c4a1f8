"""The map as the map stream serves it to clients.

All of it is of one thread, which is not that of the pings; the map itself is read under its own
locks, each for some milliseconds at most.
"""

import math
import weakref
import zlib
from collections.abc import Callable
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd import _core
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.encoder import BlockEncoder
from mapperd.server.map_index import BlockIndex, ChangedRows, StoredBricks, vector_of
from mapperd.server.priority_queue import Part
from mapperd.server.subscription import Subscription
from mapperd.store.metadata import Identity, fresh
from mapperd.store.tile_store import TileStore
from mapperd.wire.messages import Interest, MapFacts, Resume, Vector

__all__ = ["MapSource", "MapStorage", "MapView", "Source", "why_not"]


def why_not(  # noqa: PLR0911 one reason each
    resume: Resume,
    interest: Interest,
    *,
    map_id: str,
    identity: Identity,
    looked: int,
    newest: int,
    has_losses: bool,
) -> str:
    """Why a client has to be sent everything; "" when what it holds is good.

    Args:
        resume: what it holds.
        interest: what it wants.
        map_id: as it is sent to clients.
        identity: of the map.
        looked: the highest revision up to which anybody can have been sent all.
        newest: of the map.
        has_losses: something of the map in the file was damaged.
    """
    held = (resume.level, resume.detail, resume.radius_m, resume.box)
    if resume.map != map_id:
        return "another_map"
    if held != (interest.level, interest.detail, interest.radius_m, interest.box):
        return "another_interest"
    if interest.radius_m > 0:
        return "moving_interest"  # where the vehicle was then is forgotten
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
"""A view that nobody uses is forgotten then."""

ATTEMPTS = 4

NO_BRICKS = np.zeros((0, 3), np.int32)

Origin = tuple[float, float] | None


class MapStorage(Protocol):
    """Where the map is kept: `mapperd.pipeline.persistence`."""

    @property
    def store(self) -> TileStore | None:
        """Its file; None where it is in memory alone."""


class MapSource:
    """Watches one map for all clients, `with`.

    Args:
        sonar_map: the map; nobody maps before this is made.
        keep: where it is kept.
        log_odds_step: of the quantised log-odds.
        origin_deg: says where the map's zero is.

    Raises:
        StoreError: the map's file cannot be opened.

    Attributes:
        now_ns: of the last look, Unix.
        trouble: why something of the map's file cannot be sent at the moment; None: all is well.
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
        self._facts = self._facts_now()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the map's file."""
        if self._files is not None:
            self._files.close()

    @property
    def session(self) -> str:
        """Which the revisions are of."""
        return self._identity.session

    @property
    def revision(self) -> int:
        """Of the map, when it was looked at last."""
        return self._revision

    @property
    def indexing(self) -> int:
        """Blocks, and bricks of the file, that are still to be found; 0 once all are."""
        return sum(view.left for view in self._views.values())

    @property
    def memory_bytes(self) -> int:
        """Of indexes, and of what each client was sent."""
        views = sum(view.memory_bytes for view in self._views.values())
        return views + sum(one.memory_bytes for one in self._subscriptions)

    def facts(self) -> MapFacts:
        """About the map."""
        return self._facts

    def subscribe(self, interest: Interest, resume: Resume | None = None) -> Subscription:
        """A client comes.

        Args:
            interest: in what.
            resume: what it says that it holds.
        """
        known_up_to, reason = None, ""
        if resume is not None:
            reason = self._why_not(resume, interest)
            known_up_to = resume.revision if not reason else None
        one = Subscription(self, interest, known_up_to, reason)
        self._subscriptions.add(one)
        return one

    def view_of(self, interest: Interest) -> BlockIndex:
        """The blocks as an interest has them told."""
        key = interest.level, interest.detail
        view = self._views.get(key)
        if view is None:
            core_view = _core.StreamView(
                interest.level,
                interest.detail,
                log_odds_step=self._step,
                occupied_log_odds=self._facts.occupied_log_odds,
                free_log_odds=self._facts.free_log_odds,
            )
            view = self._views[key] = BlockIndex(interest.level, core_view, self._map.resolution_m)
        view.unused_since_ns = None
        return view

    def look(self, now_ns: int, position_m: ArrayLike | None = None) -> None:
        """Find what changed since the last look.

        Args:
            now_ns: Unix.
            position_m: (3,) of the vehicle: what is nearest is found first where there is much.
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
        """What changed in the file and in memory since it was looked at.

        A tile that leaves memory is in the file before: what changed is in the one or the other,
        as long as the file is not written to meanwhile.

        Returns:
            rows of the file; what is in memory, and which of the rows' bricks are; whether both
            are of one state.
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
        if self._facts.bricks_lost != self._bricks_lost():
            self._start_again()

    def _bricks_lost(self) -> int:
        if self._files is None or self._store is None:
            return 0
        return len(self._store.lost | self._files.damaged)

    def _notice_another_map(self) -> None:
        """All is sent again of another map, and of this one when it is sent in another way."""
        if self._store is not None:
            self._identity, before = self._store.identity, self._identity
            if before.map != self._identity.map:
                if self._files is not None:
                    self._files.damaged.clear()
                self._start_again()
        if self._facts != self._facts_now():
            self._start_again()

    def _start_again(self) -> None:
        self._facts = self._facts_now()
        self._views.clear()
        self._file_version = None
        for one in list(self._subscriptions):
            one.restart()

    def _facts_now(self) -> MapFacts:
        mapping = self._map.config.mapping
        resolution_m = self._map.resolution_m
        occupied = _log_odds(mapping.occupied_threshold)
        free = _log_odds(mapping.free_threshold)
        # What is sent in another way is another map to whoever resumes.
        way = zlib.crc32(repr((resolution_m, self._step, occupied, free)).encode())
        return MapFacts(
            id=f"{self._identity.map}-{way:08x}",
            resolution_m=resolution_m,
            log_odds_step=self._step,
            occupied_log_odds=occupied,
            free_log_odds=free,
            frame=self._map.config.frames.map,
            origin_deg=self._origin_deg(),
            bricks_lost=self._bricks_lost(),
        )

    def _why_not(self, resume: Resume, interest: Interest) -> str:
        try:
            return why_not(
                resume,
                interest,
                map_id=self._facts.id,
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
    """What of the map one client has been sent."""

    resumed: bool
    """What the client held was right."""

    reason: str
    """Why not."""

    @property
    def number(self) -> int:
        """Number of the last message."""

    @property
    def left(self) -> int:
        """Blocks that are still to be sent."""

    @property
    def near_left(self) -> int:
        """Of those the ones near the vehicle that belong to this pass, as of the last message."""

    def next(self, position_m: Vector | None, most_bytes: int, part: Part = "any") -> bytes | None:
        """The next message as it goes over the wire; None where all is sent.

        Args:
            position_m: of the vehicle, what is nearest to it comes first.
            most_bytes: about; one block is always told.
            part: of the map, that it may be about.
        """

    def change(self, interest: Interest) -> None:
        """Something else is of interest from now on."""

    def settle(self, number: int) -> None:
        """Note that the client has used the messages up to this one."""

    def go_on(self, interest: Interest, number: int) -> bool:
        """The client is back, and has messages up to this one; later ones are sent again.

        Returns:
            whether it may keep what it holds.
        """

    def close(self) -> None:
        """The client is gone."""


class Source(Protocol):
    """The map."""

    @property
    def session(self) -> str:
        """Which the revisions are of."""

    @property
    def revision(self) -> int:
        """As of the last look."""

    def facts(self) -> MapFacts:
        """What is the same for all of it."""

    def look(self, now_ns: int, position_m: Vector | None = None) -> None:
        """Find what changed since the last look, nearest to the vehicle first."""

    def subscribe(self, interest: Interest, resume: Resume | None = None) -> MapView:
        """Begin to tell a client."""
