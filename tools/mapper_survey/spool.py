"""What a dive's pings become between planning and mapping.

Records one after the other, and rows that say of each where it is, when it was, and which part of
the map it may change.
"""

import io
import struct
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapper_survey.frame import Frame
from mapper_survey.records import RecordWriter
from mapperd.config.tree import Config
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import PingStats, SonarMap

__all__ = ["NO_TIME", "ROW", "RowFile", "Rows", "SpoolMap"]

ROW = np.dtype(
    [("t_ns", "<i8"), ("offset", "<i8"), ("size", "<i4"), ("first", "<i4", 3), ("last", "<i4", 3)]
)
"""Of a ping: time, place of its record, and the box of blocks that it may change, both with."""

PACKED = struct.Struct("<qqi3i3i")
"""The same."""

NO_TIME = np.iinfo(np.int64).min
NO_BOX = ((1, 1, 1), (0, 0, 0))
"""A ping that says nothing."""

Rows = NDArray[np.void]


class RowFile:
    """An array of `ROW` in a file of numpy's, written row by row, however many there are.

    Args:
        out: to be written; its beginning again at the end.

    Attributes:
        count: of the rows so far.
    """

    def __init__(self, out: BinaryIO) -> None:
        self.count = 0
        self._out = out
        out.write(self._head())

    def add(self, row: tuple[int, ...]) -> None:
        """One more, its numbers one after the other."""
        self._out.write(PACKED.pack(*row))
        self.count += 1

    def close(self) -> None:
        """Say how many there are."""
        self._out.seek(0)
        self._out.write(self._head())
        self._out.flush()

    def _head(self) -> bytes:
        """As long for any count: numpy leaves room in it for an array that grows."""
        head = io.BytesIO()
        about = {"descr": ROW.descr, "fortran_order": False, "shape": (self.count,)}
        np.lib.format.write_array_header_1_0(head, about)
        return head.getvalue()


class SpoolMap(SonarMap):
    """Takes pings as a map does and refuses the same ones, but keeps them for a map to come.

    Args:
        config: the settings.
        out: where the records go.
        rows: where what is said of them goes.
        frame: of the dive.

    Attributes:
        t_ns: of the ping that comes next; None where nobody knows.
        first_ns, last_ns: the least and the greatest time so far; None without any.
    """

    def __init__(self, config: Config, out: BinaryIO, rows: RowFile, frame: Frame) -> None:
        super().__init__(config)
        self.t_ns: int | None = None
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self._out = out
        self._rows = rows
        self._frame = frame
        self._writer = RecordWriter(config.filtering.intensity_threshold)
        self._offset = 0

    @property
    def bearings(self) -> list[bytes]:
        """Tables that the records refer to."""
        return self._writer.bearings

    @property
    def size_bytes(self) -> int:
        """Of all records."""
        return self._offset

    def integrate(
        self,
        echo: PingImage,
        map_T_sonar: NDArray[np.float64],  # noqa: N803 frames are named
        motion: PingMotion | None = None,
    ) -> PingStats:
        """Keep a ping. Raises as a map would."""
        placed, moved = self._frame.pose(map_T_sonar), self._frame.motion(motion)
        first, last = self.blocks_of(echo, placed, moved) or NO_BOX
        record = self._writer.pack(echo, placed, moved)
        self._out.write(record)
        t_ns = NO_TIME if self.t_ns is None else self.t_ns
        self._rows.add((t_ns, self._offset, len(record), *first, *last))
        self._offset += len(record)
        self._note_time()
        return PingStats()

    def _note_time(self) -> None:
        if self.t_ns is not None:
            self.first_ns = self.t_ns if self.first_ns is None else min(self.first_ns, self.t_ns)
            self.last_ns = self.t_ns if self.last_ns is None else max(self.last_ns, self.t_ns)
