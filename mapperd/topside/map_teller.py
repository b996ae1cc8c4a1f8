"""When the map is told as a whole, and when what changed of it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from mapperd.client.block_table import keys_of, names_of
from mapperd.client.changes import MapChanged
from mapperd.client.mirror import MapMirror
from mapperd.topside.channels import Said
from mapperd.topside.clouds import changes_cloud, map_cloud
from mapperd.topside.told_cells import ToldCells

__all__ = ["LIVE", "RECORDING", "MapTeller", "Pace"]

POINT_BYTES = 24


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
        self._whole_due = True

    def due(
        self, mirror: MapMirror, now_s: float, stamp_ns: int, *, last: bool = False
    ) -> Iterator[Said]:
        """What is to be said now.

        Args:
            mirror: with all changes that were noted.
            now_s: monotonic.
            stamp_ns: of the daemon, for a map of which nothing was told yet.
            last: nothing follows; the whole map is told if it changed at all.
        """
        stamp_ns = self._stamp_ns or stamp_ns
        if self._whole_due or (last and self._changed_since) or self._whole_soon(now_s):
            yield self._whole(mirror, now_s, stamp_ns)
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

    def _whole(self, mirror: MapMirror, now_s: float, stamp_ns: int) -> Said:
        cells = mirror.cells()
        self._told.restart(cells, mirror.cell_m)
        self._changed.clear()
        self._whole_due = self._changed_since = False
        self._whole_s = self._changes_s = now_s
        self._whole_cells, self._cells_since = len(cells), 0
        return Said("/map", map_cloud(cells, mirror.facts.frame, stamp_ns), stamp_ns)

    def _changes(self, mirror: MapMirror, now_s: float, stamp_ns: int) -> Iterator[Said]:
        cells = mirror.cells(keys=keys_of(self._changed))
        gone_m = self._told.replace(self._changed, cells, mirror.cell_m)
        self._changed.clear()
        self._changes_s = now_s
        self._cells_since += len(cells) + len(gone_m)
        if len(cells) or len(gone_m):
            message = changes_cloud(cells, gone_m, mirror.facts.frame, stamp_ns)
            yield Said("/map_changes", message, stamp_ns)
