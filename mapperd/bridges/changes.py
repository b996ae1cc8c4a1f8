"""The watch for changes: compares the live map with a known one, and reports to the daemon.

Only blocks that changed are compared again, by the code of `mapperctl diff`. The daemon makes
events of the reports and keeps them in its status, for all its clients.
"""

import asyncio
import contextlib
import math
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.bridges.vehicle import BridgeClient, ConnectionState, LinkReporter
from mapperd.client.changes import ClientChange, LinkChanged, MapChanged, MapReset
from mapperd.client.mirror import MapMirror, keys_of, map_of, names_of
from mapperd.client.validation import AskError
from mapperd.config.tree import ChangesConfig
from mapperd.mapping.difference import (
    MapChange,
    changes_among,
    compare_parts,
    occupied_centres,
)
from mapperd.mapping.queries import MapContent
from mapperd.mapping.sonar_map import SonarMap
from mapperd.wire.messages import BLOCK_EDGE, Want

__all__ = ["WANTS", "ChangeTracker", "MapWatch", "TrackedChange", "in_memory", "serve"]

WANTS: tuple[Want, ...] = ("map", "pose", "localization", "status", "settings")

Floats = NDArray[np.float64]

NONE = np.zeros((0, 3))
TIMEOUT_S = 10.0
AT_ONCE = 50
"""Reports of one request."""

GROWN = 2
"""A change is reported again when it has this many times its voxels of the last report."""


def in_memory(known: MapContent) -> SonarMap:
    """Return a map in memory: a map on disk would be read anew at each comparison."""
    if isinstance(known, SonarMap):
        return known
    with tempfile.TemporaryDirectory(prefix="mapperd-") as folder:
        path = Path(folder) / "known.map"
        known.save(path)
        loaded = SonarMap(known.config)
        loaded.load(path)
    return loaded


class MapWatch:
    """Keeps the differences of a mirror from a known map.

    Args:
        known: the known map.
        config: tolerance and least size.

    Raises:
        MapError: the tolerance is too large for the known map.
    """

    def __init__(self, known: SonarMap, config: ChangesConfig) -> None:
        self._known = known
        self._known_m = occupied_centres(known)
        self._tolerance_m = config.tolerance or None
        self._min_voxels = config.min_voxels
        compare_parts(NONE, known, NONE, known, self._tolerance_m)  # refuses a wrong tolerance
        self.reset()

    def reset(self) -> None:
        """Begin again: the mirror has another map."""
        self._edge_m = 0.0
        self._rows_of: dict[bytes, NDArray[np.intp]] = {}
        self._appeared: dict[bytes, Floats] = {}
        self._vanished: dict[bytes, Floats] = {}
        self._link_m = self._grid_m = self._known.resolution_m

    def update(self, mirror: MapMirror, names: Iterable[bytes]) -> None:
        """Compare blocks of the mirror again."""
        wanted = set(names)
        if not wanted:
            return
        with mirror.lock:
            self._index(mirror.cell_m)
            tolerance_m = self._tolerance_m or 2 * max(self._known.resolution_m, mirror.cell_m)
            margin = math.ceil(tolerance_m / self._edge_m)
            near = _around(keys_of(wanted), margin)
            cells, info, cell_m = mirror.cells("known", keys=near), mirror.info, mirror.cell_m
        part = map_of(cells, cell_m, info)
        rows = [self._rows_of[name] for name in names_of(near) if name in self._rows_of]
        known_m = self._known_m[np.concatenate(rows)] if rows else NONE
        found = compare_parts(known_m, self._known, occupied_centres(part), part, self._tolerance_m)
        self._link_m, self._grid_m = max(found.tolerance_m, found.grid_m), found.grid_m
        for held, way in ((self._appeared, found.appeared), (self._vanished, found.vanished)):
            changed_m = way.centres_m[way.changed]
            by_block = _by_block(changed_m, self._edge_m)
            for name in wanted:
                held.pop(name, None)
                if name in by_block:
                    held[name] = changed_m[by_block[name]]

    def changes(self) -> list[MapChange]:
        """Return what appeared and vanished, the largest changes first."""
        appeared, vanished = (
            np.concatenate(list(held.values())) if held else NONE
            for held in (self._appeared, self._vanished)
        )
        return changes_among(appeared, vanished, self._link_m, self._grid_m, self._min_voxels)

    def _index(self, cell_m: float) -> None:
        edge_m = BLOCK_EDGE * cell_m
        if edge_m != self._edge_m:
            self._edge_m = edge_m
            self._rows_of = _by_block(self._known_m, edge_m)


def _by_block(centres_m: Floats, edge_m: float) -> dict[bytes, NDArray[np.intp]]:
    """Return the rows of each block of the mirror, by its name."""
    if not len(centres_m):
        return {}
    keys = np.floor(centres_m / edge_m).astype(np.int32)
    order = np.lexsort(keys.T)
    begins = np.flatnonzero(np.r_[True, (keys[order][1:] != keys[order][:-1]).any(axis=1)])
    names = names_of(keys[order][begins])
    return dict(zip(names, np.split(order, begins[1:]), strict=True))


def _around(keys: NDArray[np.int32], margin: int) -> NDArray[np.int32]:
    """Return blocks (N, 3) and those next to them, each once."""
    steps = np.arange(-margin, margin + 1)
    offsets = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 1, 3)
    return np.unique((keys + offsets).reshape(-1, 3), axis=0).astype(np.int32)


@dataclass(frozen=True, slots=True)
class TrackedChange:
    """A change with a name.

    Attributes:
        id: stays the same while the change is there.
        change: as it was last found.
        is_reported: it was found twice, and is reported.
        voxels: number of the last report.
    """

    id: str
    change: MapChange
    is_reported: bool = False
    voxels: int = 0


class ChangeTracker:
    """Follows changes through comparisons; one that is found only once is not reported.

    Args:
        slack_m: boxes of one kind that are nearer than this are the same change.
    """

    def __init__(self, slack_m: float) -> None:
        self._slack_m = slack_m
        self._tracked: list[TrackedChange] = []
        self._count = 0

    @property
    def reported(self) -> list[TrackedChange]:
        """The changes that are there and reported."""
        return [one for one in self._tracked if one.is_reported]

    def update(self, changes: Iterable[MapChange]) -> tuple[list[TrackedChange], list[str]]:
        """Take the changes of a comparison, the largest first.

        Returns:
            changes to report, new ones and grown ones; ids of changes that are over.
        """
        left, tracked, due = list(self._tracked), [], []
        for change in changes:
            before = next((one for one in left if self._is_same(one.change, change)), None)
            if before is None:
                self._count += 1
                tracked.append(TrackedChange(f"{change.kind}-{self._count}", change))
                continue
            left.remove(before)
            is_due = not before.is_reported or change.voxels >= GROWN * before.voxels
            now = replace(
                before,
                change=change,
                is_reported=True,
                voxels=change.voxels if is_due else before.voxels,
            )
            tracked.append(now)
            if is_due:
                due.append(now)
        self._tracked = tracked
        return due, [one.id for one in left if one.is_reported]

    def _is_same(self, one: MapChange, other: MapChange) -> bool:
        return one.kind == other.kind and all(
            low <= other_high + self._slack_m and other_low <= high + self._slack_m
            for low, high, other_low, other_high in zip(
                one.low_m, one.high_m, other.low_m, other.high_m, strict=True
            )
        )


TICK_S = 0.25
SHARE = 33.0
"""Blocks are compared again after this many times the processor time of the last ones."""

SLICE = 300
"""Blocks that are compared at once; those that changed last come first."""


class _Watcher:
    """Follows a client, compares, and reports."""

    def __init__(
        self,
        client: BridgeClient,
        known: SonarMap,
        name: str,
        config: ChangesConfig,
        report: Callable[[str], None],
    ) -> None:
        self._client = client
        self._name = name
        self._config = config
        self._report = report
        self._link = LinkReporter(report)
        self._state = ConnectionState()
        self._watch = MapWatch(known, config)
        self._tracker = ChangeTracker(config.tolerance or 2 * known.resolution_m)
        self._changed: dict[bytes, None] = {}
        self._session = ""
        self._is_begun = False
        self._is_withdrawn = False
        self._error = ""
        self._compare_s = self._report_s = -math.inf
        self._reset = False

    def take(self, change: ClientChange, now_s: float) -> None:
        self._state.take(change, now_s)
        match change:
            case LinkChanged(link):
                welcome = self._client.welcome
                is_other = welcome is not None and welcome.session != self._session
                is_connected = self._link.take(link)
                if not is_connected:
                    self._state.clear()
                if is_connected and welcome is not None and is_other:
                    self._session = welcome.session
                    self._is_begun = self._is_withdrawn = False
            case MapReset():
                self._changed.clear()
                self._reset = True
            case MapChanged():
                for name in names_of(change.keys):
                    self._changed.pop(name, None)
                    self._changed[name] = None
            case _:
                pass

    async def tick(self, now_s: float) -> None:
        if now_s < self._compare_s or self._client.link.state != "connected":
            return
        mirror, is_in_odom = self._client.mirror, self._is_in_odom()
        if mirror is None or is_in_odom is None:
            return
        if is_in_odom:
            self._compare_s = now_s + self._config.period
            self._say_error(
                "the daemon maps in the odometry's frame, which is not that of the known map: set "
                "localization.mapping to corrected"
            )
            await self._withdraw()
            return
        self._is_withdrawn = False
        if self._reset:
            self._reset = False
            self._watch.reset()
        names = {self._changed.popitem()[0] for _ in range(min(SLICE, len(self._changed)))}
        took_s = await asyncio.to_thread(self._compare, mirror, names)
        self._compare_s = now_s + SHARE * took_s
        if now_s < self._report_s:
            return
        self._report_s = now_s + self._config.period
        due, over = await asyncio.to_thread(self._find)
        await self._send(due, over)

    def _is_in_odom(self) -> bool | None:
        """Return whether the map lies in the odometry's frame; None until it is known."""
        localizes, vehicle = self._state.localizes, self._state.vehicle
        if not localizes:
            return localizes
        return None if vehicle is None else vehicle.source == "odometry"

    async def _withdraw(self) -> None:
        """Take back what was reported: it may have been compared in another frame."""
        if self._is_withdrawn:
            return
        self._is_begun = False
        with contextlib.suppress(AskError):  # with the next look
            await self._client.ask(
                "report", timeout_s=TIMEOUT_S, changes=[], known=self._name, begin=True
            )
            self._is_withdrawn = True

    def _compare(self, mirror: MapMirror, names: set[bytes]) -> float:
        began_s = time.thread_time()
        self._watch.update(mirror, names)
        return time.thread_time() - began_s

    def _find(self) -> tuple[list[TrackedChange], list[str]]:
        """Return what to report; runs in a thread, as large changes take seconds to group."""
        return self._tracker.update(self._watch.changes())

    async def _send(self, due: list[TrackedChange], over: list[str]) -> None:
        """Report to the daemon; to another session of it, everything again."""
        for one in due:
            self._report(f"{one.change.kind}: {one.change.voxels} voxels at {_where(one.change)}")
        is_begin = not self._is_begun
        reports = [_plain(one) for one in (self._tracker.reported if is_begin else due)]
        reports += [{"kind": "over", "id": id_} for id_ in over]
        if not (reports or is_begin):
            return
        try:
            for begin in range(0, max(len(reports), 1), AT_ONCE):
                await self._client.ask(
                    "report",
                    timeout_s=TIMEOUT_S,
                    changes=reports[begin : begin + AT_ONCE],
                    known=self._name,
                    begin=is_begin and begin == 0,
                )
        except AskError as error:
            self._is_begun = False  # all of them with the next comparison
            self._say_error(str(error))
        else:
            self._is_begun, self._error = True, ""

    def _say_error(self, text: str) -> None:
        if text != self._error:
            self._error = text
            self._report(f"not reported: {text}")


def _plain(tracked: TrackedChange) -> dict[str, Any]:
    change = tracked.change
    return {
        "kind": change.kind,
        "id": tracked.id,
        "low_m": list(change.low_m),
        "high_m": list(change.high_m),
        "voxels": change.voxels,
    }


def _where(change: MapChange) -> str:
    ranges = zip("xyz", change.low_m, change.high_m, strict=True)
    return ", ".join(f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in ranges) + " m"


async def serve(
    client: BridgeClient,
    known: SonarMap,
    name: str,
    config: ChangesConfig,
    report: Callable[[str], None],
) -> None:
    """Watch until cancelled, or until the client ends.

    Args:
        client: running client of the map stream with `WANTS`.
        known: the known map.
        name: of the known map, for people.
        config: period, tolerance and least size.
        report: takes one line for each change.

    Raises:
        MapError: the tolerance is too large.
        StreamError: the daemon refuses the client.
    """
    watcher = _Watcher(client, known, name, config, report)

    async def tick() -> None:
        while True:
            await watcher.tick(asyncio.get_running_loop().time())
            await asyncio.sleep(TICK_S)

    ticking = asyncio.create_task(tick())
    try:
        async for change in client.changes():
            watcher.take(change, asyncio.get_running_loop().time())
            if ticking.done():
                ticking.result()
    finally:
        ticking.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await ticking
