"""What a dive's pings become between planning and mapping.

Records one after the other, and rows that say of each where it is, when it was, and which part of
the map it may change.
"""

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd.config import Config
from mapperd.echo import Echo
from mapperd.mapping import PingStats, SonarMap
from mapperd.motion import PingMotion
from survey.frame import Frame
from survey.records import RecordWriter

__all__ = ["NO_TIME", "ROW", "Rows", "SpoolMap"]

ROW = np.dtype(
    [("t_ns", "<i8"), ("offset", "<i8"), ("size", "<i4"), ("first", "<i4", 3), ("last", "<i4", 3)]
)
"""Of a ping: time, place of its record, and the box of blocks that it may change, both with."""

NO_TIME = np.iinfo(np.int64).min
NO_BOX = ((1, 1, 1), (0, 0, 0))
"""A ping that says nothing."""

Rows = NDArray[np.void]


class SpoolMap(SonarMap):
    """Takes pings as a map does and refuses the same ones, but keeps them for a map to come.

    Args:
        config: the settings.
        out: where the records go.
        frame: of the dive.

    Attributes:
        t_ns: of the ping that comes next; None where nobody knows.
    """

    def __init__(self, config: Config, out: BinaryIO, frame: Frame) -> None:
        super().__init__(config)
        self.t_ns: int | None = None
        self._out = out
        self._frame = frame
        self._writer = RecordWriter(config.filtering.intensity_threshold)
        self._rows: list[tuple[object, ...]] = []
        self._offset = 0

    @property
    def bearings(self) -> list[bytes]:
        """Tables that the records refer to."""
        return self._writer.bearings

    @property
    def size_bytes(self) -> int:
        """Of all records."""
        return self._offset

    def rows(self) -> Rows:
        """Of all pings, in the order in which they came."""
        return np.array(self._rows, dtype=ROW)

    def integrate(
        self,
        echo: Echo,
        map_T_sonar: NDArray[np.float64],  # noqa: N803 frames are named
        motion: PingMotion | None = None,
    ) -> PingStats:
        """Keep a ping. Raises as a map would."""
        placed, moved = self._frame.pose(map_T_sonar), self._frame.motion(motion)
        first, last = self.blocks_of(echo, placed, moved) or NO_BOX
        record = self._writer.pack(echo, placed, moved)
        self._out.write(record)
        t_ns = NO_TIME if self.t_ns is None else self.t_ns
        self._rows.append((t_ns, self._offset, len(record), first, last))
        self._offset += len(record)
        return PingStats()
