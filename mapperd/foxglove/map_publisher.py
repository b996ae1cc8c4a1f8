"""Point clouds of the map for Foxglove: the whole map now and then, changes in between."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from foxglove.messages import PointCloud
from numpy.typing import NDArray

from mapperd.client.changes import MapChanged
from mapperd.client.mirror import Cells, MapMirror, keys_of, names_of
from mapperd.foxglove.channels import ChannelMessage
from mapperd.foxglove.geometry import cloud, pose
from mapperd.wire.blocks import CELLS
from mapperd.wire.messages import BLOCK_EDGE, LocalizationMessage, ReturnsMessage

__all__ = [
    "LIVE",
    "RECORDING",
    "MapPublisher",
    "PublishPace",
    "SentCells",
    "changes_cloud",
    "map_cloud",
    "map_rows",
    "returns_cloud",
    "scan_cloud",
]

_NONE = bytes(CELLS // 8)
_STEPS = np.array([1, BLOCK_EDGE, BLOCK_EDGE**2])


class SentCells:
    """The occupied cells that were published, one bit a cell, by block."""

    def __init__(self) -> None:
        self._bits: dict[bytes, bytes] = {}

    def clear(self) -> None:
        """Forget all cells."""
        self._bits.clear()

    def replace(self, names: Iterable[bytes], cells: Cells, cell_m: float) -> NDArray[np.float64]:
        """Set the occupied cells of some blocks.

        Args:
            names: names of the blocks.
            cells: all occupied cells in them.
            cell_m: edge of a cell.

        Returns:
            (N, 3) centres of the cells that were occupied before and are not any more.
        """
        now = _bits_by_block(cells, cell_m)
        before = []
        gone_from = []
        for name in names:
            old = self._bits.pop(name, None)
            new = now.get(name, _NONE)
            if new != _NONE:
                self._bits[name] = new
            if old is not None and old != new:
                before.append((old, new))
                gone_from.append(name)
        if not before:
            return np.zeros((0, 3))
        old_bits, new_bits = _unpacked(o for o, _ in before), _unpacked(n for _, n in before)
        row, offset = np.nonzero(old_bits & ~new_bits)
        local = offset[:, None] // _STEPS % BLOCK_EDGE
        index = keys_of(gone_from)[row].astype(np.int64) * BLOCK_EDGE + local
        return np.asarray((index + 0.5) * cell_m, np.float64)


def _bits_by_block(cells: Cells, cell_m: float) -> dict[bytes, bytes]:
    if not len(cells):
        return {}
    index = np.floor(cells.centres_m / cell_m).astype(np.int64)
    owner = index // BLOCK_EDGE
    offset = (index % BLOCK_EDGE) @ _STEPS
    begins = np.r_[True, (owner[1:] != owner[:-1]).any(axis=1)]  # of runs of one block's cells
    names = names_of(owner[begins].astype(np.int32))
    row_of: dict[bytes, int] = {}
    rows = np.array([row_of.setdefault(name, len(row_of)) for name in names])
    bits = np.zeros((len(row_of), CELLS), bool)
    bits[rows[np.cumsum(begins) - 1], offset] = True
    packed = np.packbits(bits, axis=1)
    return {name: packed[row].tobytes() for name, row in row_of.items()}


def _unpacked(packed: Iterable[bytes]) -> NDArray[np.bool_]:
    rows = np.frombuffer(b"".join(packed), np.uint8).reshape(-1, CELLS // 8)
    return np.unpackbits(rows, axis=1).astype(bool)


NS = 1e9

_CELL = [
    ("x", "<f4"),
    ("y", "<f4"),
    ("z", "<f4"),
    ("probability", "<f4"),
    ("age_s", "<f4"),
    ("count", "<u4"),
]
_CHANGED_CELL = [*_CELL, ("occupied", "u1")]
_RETURN = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1")]
_POINT = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]


def map_rows(cells: Cells, stamp_ns: int) -> NDArray[np.void]:
    """Points of cells; `age_s` counts from the block's last change, `count` is 0 if unknown."""
    return _rows(cells, _CELL, stamp_ns)


def map_cloud(rows: NDArray[np.void], frame: str, stamp_ns: int) -> PointCloud:
    """Point cloud of `map_rows`."""
    return cloud(rows, frame, stamp_ns)


def changes_cloud(
    cells: Cells, gone_m: NDArray[np.float64], frame: str, stamp_ns: int
) -> PointCloud:
    """Point cloud of occupied cells and of the centres (N, 3) of cells that became free."""
    here = _rows(cells, _CHANGED_CELL, stamp_ns)
    here["occupied"] = 1
    gone = np.zeros(len(gone_m), _CHANGED_CELL)
    _place(gone, gone_m)
    return cloud(np.concatenate([here, gone]), frame, stamp_ns)


def returns_cloud(returns: ReturnsMessage, map_frame: str, sonar_frame: str) -> PointCloud:
    """Point cloud of one ping's returns, in the map frame if the sonar's pose is known."""
    rows = _points(returns.points, 3, _RETURN)
    rows["intensity"] = np.frombuffer(returns.intensities, np.uint8)
    where, how = returns.sonar_position_m, returns.sonar_orientation_xyzw
    if where is None or how is None:
        return cloud(rows, sonar_frame, returns.stamp_ns)
    return cloud(rows, map_frame, returns.stamp_ns, pose(where, how))


def scan_cloud(localization: LocalizationMessage, frame: str, stamp_ns: int) -> PointCloud:
    """Point cloud of the newest scan that localization weighted."""
    return cloud(_points(localization.scan, 3, _POINT), frame, stamp_ns)


def _rows(cells: Cells, kind: list[tuple[str, str]], stamp_ns: int) -> NDArray[np.void]:
    rows = np.zeros(len(cells), kind)
    _place(rows, cells.centres_m)
    rows["probability"] = cells.probability
    rows["age_s"] = np.maximum(stamp_ns - cells.changed_ns, 0) / NS
    rows["count"] = cells.count
    return rows


def _points(data: bytes, columns: int, kind: list[tuple[str, str]]) -> NDArray[np.void]:
    table = np.frombuffer(data, "<f4").reshape(-1, columns)
    rows = np.zeros(len(table), kind)
    _place(rows, table)
    return rows


def _place(rows: NDArray[np.void], xyz: NDArray[np.float64] | NDArray[np.float32]) -> None:
    rows["x"], rows["y"], rows["z"] = xyz.T


POINT_BYTES = 24
SLICE = 4096
"""Blocks read in one call, about 50 ms; other channels are published in between."""


@dataclass(frozen=True, slots=True)
class PublishPace:
    """How often the whole map is published while it changes.

    Attributes:
        shortest_s: minimum time between two messages of a channel.
        bytes_per_s: mean rate of whole maps.
        share: publish after this many changed cells, relative to the cells of the whole map.
        longest_s: publish after this time regardless of `share`.
    """

    shortest_s: float = 1.0
    bytes_per_s: float = math.inf
    share: float = 0.0
    longest_s: float = math.inf


LIVE = PublishPace(bytes_per_s=8e6)
"""For viewers, which show only the newest cloud of a channel."""

RECORDING = PublishPace(share=1.0, longest_s=60.0)
"""For files: at most twice the size of the changes, and a whole map near every seek position."""


@dataclass(slots=True)
class _Whole:
    """A whole map that is being read.

    Attributes:
        keys: (N, 3) of blocks still to read.
        rows: points of the blocks read so far.
        stamp_ns: time that `age_s` is counted from.
    """

    keys: NDArray[np.int32]
    stamp_ns: int
    rows: list[NDArray[np.void]] = field(default_factory=list)


class MapPublisher:
    """The channels `/map` and `/map_changes`.

    Args:
        pace: rate limits of the whole map.
    """

    def __init__(self, pace: PublishPace) -> None:
        self._pace = pace
        self._sent = SentCells()
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
        """Schedule changed blocks."""
        self._changed.update(names_of(change.keys))
        self._stamp_ns = change.stamp_ns or self._stamp_ns
        self._changed_since = True

    def renew(self) -> None:
        """Publish the whole map next."""
        self._whole_due = True

    def reset(self) -> None:
        """Start again with another map."""
        self._changed.clear()
        self._stamp_ns = 0
        self._begun = None
        self._whole_due = True

    def due(
        self, mirror: MapMirror, now_s: float, stamp_ns: int, *, last: bool = False
    ) -> Iterator[ChannelMessage]:
        """Yield the messages to publish now; a large map is read over several calls.

        Args:
            mirror: the map, with all noted changes.
            now_s: monotonic.
            stamp_ns: the daemon's time, for a map that was never published.
            last: this is the last call: yield the whole map if it changed.
        """
        stamp_ns = self._stamp_ns or stamp_ns
        due = self._whole_due or (last and self._changed_since) or self._whole_soon(now_s)
        if due and (self._begun is None or (last and self._changed_since)):
            self._begin(mirror, stamp_ns)
        if self._begun is not None:
            yield from self._read_slice(mirror, self._begun, now_s, last=last)
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
        """Start reading; later changes are published after the whole map."""
        self._begun = _Whole(mirror.keys(), stamp_ns)
        self._sent.clear()
        self._changed.clear()
        self._changed_since = False

    def _read_slice(
        self, mirror: MapMirror, whole: _Whole, now_s: float, *, last: bool
    ) -> Iterator[ChannelMessage]:
        count = len(whole.keys) if last else SLICE
        keys, whole.keys = whole.keys[:count], whole.keys[count:]
        cells = mirror.cells(keys=keys)
        self._sent.replace(names_of(keys), cells, mirror.cell_m)
        whole.rows.append(map_rows(cells, whole.stamp_ns))
        if not len(whole.keys):
            self._begun = None
            rows = np.concatenate(whole.rows)
            self._whole_due = False
            self._whole_s = self._changes_s = now_s
            self._whole_cells, self._cells_since = len(rows), 0
            message = map_cloud(rows, mirror.info.frame, whole.stamp_ns)
            yield ChannelMessage("/map", message, whole.stamp_ns)

    def _changes(self, mirror: MapMirror, now_s: float, stamp_ns: int) -> Iterator[ChannelMessage]:
        cells = mirror.cells(keys=keys_of(self._changed))
        gone_m = self._sent.replace(self._changed, cells, mirror.cell_m)
        self._changed.clear()
        self._changes_s = now_s
        self._cells_since += len(cells) + len(gone_m)
        if len(cells) or len(gone_m):
            message = changes_cloud(cells, gone_m, mirror.info.frame, stamp_ns)
            yield ChannelMessage("/map_changes", message, stamp_ns)
