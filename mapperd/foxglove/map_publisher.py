"""When the map is told as a whole, and when what changed of it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapperd.client.block_table import keys_of, names_of
from mapperd.client.changes import MapChanged
from mapperd.client.mirror import MapMirror
from mapperd.foxglove.channels import Said
from mapperd.foxglove.clouds import changes_cloud, map_cloud, map_rows
from mapperd.foxglove.told_cells import ToldCells

__all__ = ["LIVE", "RECORDING", "MapTeller", "Pace"]

POINT_BYTES = 24
SLICE = 4096
"""Blocks of the whole map that are read at a time, some 50 ms; all else is told in between."""


@dataclass(frozen=True, slots=True)
class Pace:
    """How often the whole map is told, while it changes.

    Attributes:
        shortest_s: between two messages of a channel.
        bytes_per_s: of whole maps, on average.
        share: cells that were told as changes meanwhile, of those of the whole map.
        longest_s: in spite of `share`.
    """

    shortest_s: float = 1.0
    bytes_per_s: float = math.inf
    share: float = 0.0
    longest_s: float = math.inf


LIVE = Pace(bytes_per_s=8e6)
"""A viewer shows the newest cloud of a channel alone."""

RECORDING = Pace(share=1.0, longest_s=60.0)
"""The file stays within twice the changes, and a viewer that jumps in it finds a whole map soon."""


@dataclass(slots=True)
class _Whole:
    """A map that is about to be told.

    Attributes:
        keys: (N, 3) of blocks that are still to be read.
        rows: of those that were.
        stamp_ns: what `age_s` is counted from.
    """

    keys: NDArray[np.int32]
    stamp_ns: int
    rows: list[NDArray[np.void]] = field(default_factory=list)


class MapTeller:
    """The channels `/map` and `/map_changes`.

    Args:
        pace: of the whole map.
    """

    def __init__(self, pace: Pace) -> None:
        self._pace = pace
        self._told = ToldCells()
        self._changed: set[bytes] = set()
        self._stamp_ns = 0
        self._whole_due = True
        self._begun: _Whole | None = None
        self._whole_s = -math.inf
        self._changes_s = -math.inf
        self._whole_cells = 0
        self._cells_since = 0
        self._changed_since = False

    def note(self, change: MapChanged) -> None:
        """Some blocks are others."""
        self._changed.update(names_of(change.keys))
        self._stamp_ns = change.stamp_ns or self._stamp_ns
        self._changed_since = True

    def renew(self) -> None:
        """Somebody new listens: tell all of it next."""
        self._whole_due = True

    def reset(self) -> None:
        """The map is another one."""
        self._changed.clear()
        self._stamp_ns = 0
        self._begun = None
        self._whole_due = True

    def due(
        self, mirror: MapMirror, now_s: float, stamp_ns: int, *, last: bool = False
    ) -> Iterator[Said]:
        """What is to be said now; a large map is read over several calls, and told by the last.

        Args:
            mirror: with all changes that were noted.
            now_s: monotonic.
            stamp_ns: of the daemon, for a map of which nothing was told yet.
            last: nothing follows; the whole map is told if it changed at all.
        """
        stamp_ns = self._stamp_ns or stamp_ns
        due = self._whole_due or (last and self._changed_since) or self._whole_soon(now_s)
        if due and (self._begun is None or (last and self._changed_since)):
            self._begin(mirror, stamp_ns)
        if self._begun is not None:
            yield from self._go_on(mirror, self._begun, now_s, last=last)
        elif self._changed and now_s - self._changes_s >= self._pace.shortest_s:
            yield from self._changes(mirror, now_s, stamp_ns)

    def _whole_soon(self, now_s: float) -> bool:
        passed_s = now_s - self._whole_s
        pause_s = max(
            self._pace.shortest_s, self._whole_cells * POINT_BYTES / self._pace.bytes_per_s
        )
        enough = (
            self._cells_since >= self._pace.share * self._whole_cells
            or passed_s >= self._pace.longest_s
        )
        return self._changed_since and enough and passed_s >= pause_s

    def _begin(self, mirror: MapMirror, stamp_ns: int) -> None:
        """What changes from now on may be read or not: it is told afterwards."""
        self._begun = _Whole(mirror.keys(), stamp_ns)
        self._told.clear()
        self._changed.clear()
        self._changed_since = False

    def _go_on(
        self, mirror: MapMirror, whole: _Whole, now_s: float, *, last: bool
    ) -> Iterator[Said]:
        count = len(whole.keys) if last else SLICE
        keys, whole.keys = whole.keys[:count], whole.keys[count:]
        cells = mirror.cells(keys=keys)
        self._told.replace(names_of(keys), cells, mirror.cell_m)
        whole.rows.append(map_rows(cells, whole.stamp_ns))
        if not len(whole.keys):
            self._begun = None
            rows = np.concatenate(whole.rows)
            self._whole_due = False
            self._whole_s = self._changes_s = now_s
            self._whole_cells, self._cells_since = len(rows), 0
            message = map_cloud(rows, mirror.facts.frame, whole.stamp_ns)
            yield Said("/map", message, whole.stamp_ns)

    def _changes(self, mirror: MapMirror, now_s: float, stamp_ns: int) -> Iterator[Said]:
        cells = mirror.cells(keys=keys_of(self._changed))
        gone_m = self._told.replace(self._changed, cells, mirror.cell_m)
        self._changed.clear()
        self._changes_s = now_s
        self._cells_since += len(cells) + len(gone_m)
        if len(cells) or len(gone_m):
            message = changes_cloud(cells, gone_m, mirror.facts.frame, stamp_ns)
            yield Said("/map_changes", message, stamp_ns)
