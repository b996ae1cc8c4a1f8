"""What a dive's pings become between planning and mapping.

Records one after the other, and rows with the place of each, its time, and which part of
the map it may change.
"""

import io
import math
import struct
import zlib
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np
import zstandard
from numpy.typing import NDArray

from mapper_survey.request import Transform
from mapperd.config.tree import Config
from mapperd.errors import MapperdError
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import PingStats, SonarMap

__all__ = [
    "NO_TIME",
    "ROW",
    "Frame",
    "Record",
    "RecordReader",
    "RecordWriter",
    "RowFile",
    "Rows",
    "SpoolMap",
]


Floats = NDArray[np.float64]


class Frame:
    """The way from a dive's map frame into the survey's; without one nothing is computed.

    Args:
        transform: of the dive; None leaves poses as they are, to the bit.
    """

    def __init__(self, transform: Transform | None) -> None:
        self._survey_T_dive = None if transform is None else transform.matrix()

    def pose(self, dive_T_sonar: Floats) -> Floats:  # noqa: N803 frames are named
        """(4, 4) `survey_T_sonar`."""
        if self._survey_T_dive is None:
            return dive_T_sonar
        return self._survey_T_dive @ dive_T_sonar

    def motion(self, motion: PingMotion | None) -> PingMotion | None:
        """The same motion; its velocity is in the map's frame, its turning in the sonar's."""
        if self._survey_T_dive is None or motion is None:
            return motion
        return PingMotion(
            linear_mps=self._survey_T_dive[:3, :3] @ motion.linear_mps,
            angular_radps=motion.angular_radps,
            valid_s=motion.valid_s,
            speed_of_sound_mps=motion.speed_of_sound_mps,
        )


Record = tuple[PingImage, Floats, PingMotion | None]

HEAD = struct.Struct("<BBHIId16d8d")
"""Bytes a sample, whether it moves, table of bearings, rows, beams, metres a row, pose, motion."""

CRC = struct.Struct("<I")
"""Before the rest, of which it is."""

LEVEL = -1
"""Of zstd: 1 makes the records smaller by a tenth and takes twice as long."""

STILL = (0.0,) * 8


class RecordWriter:
    """Packs pings; tables of bearings are kept once each.

    Args:
        threshold: `filtering.intensity_threshold`: only what lies above it is kept.

    Attributes:
        bearings: the tables so far, as bytes of float64 in radians.
    """

    def __init__(self, threshold: float) -> None:
        self.bearings: list[bytes] = []
        self._threshold = _rounded_down(threshold)
        self._whole_threshold = math.floor(threshold)
        self._numbers: dict[bytes, int] = {}
        self._compressor = zstandard.ZstdCompressor(level=LEVEL)

    def pack(self, echo: PingImage, map_T_sonar: Floats, motion: PingMotion | None) -> bytes:  # noqa: N803 frames are named
        """One ping's bytes."""
        samples = self._samples(echo.intensity)
        rows, beams = samples.shape
        head = HEAD.pack(
            samples.itemsize,
            motion is not None,
            self._number(echo.bearings_rad.tobytes()),
            rows,
            beams,
            echo.range_resolution_m,
            *map_T_sonar.ravel().tolist(),
            *(STILL if motion is None else _numbers_of(motion)),
        )
        record = head + self._compressor.compress(samples.data)
        return CRC.pack(zlib.crc32(record)) + record

    def _samples(self, intensity: NDArray[np.float32]) -> NDArray[np.uint8] | NDArray[np.float32]:
        """As bytes where that loses nothing."""
        small = intensity.astype(np.uint8)
        if (small == intensity).all():
            return small * (small > self._whole_threshold)
        kept = intensity * (intensity > self._threshold)
        return np.ascontiguousarray(kept, dtype="<f4")

    def _number(self, table: bytes) -> int:
        number = self._numbers.setdefault(table, len(self.bearings))
        if number == len(self.bearings):
            self.bearings.append(table)
        return number


class RecordReader:
    """Unpacks pings of one dive.

    Args:
        bearings: the tables of the writer.
    """

    def __init__(self, bearings: Sequence[bytes]) -> None:
        self._bearings = [np.frombuffer(table, dtype="<f8") for table in bearings]
        self._decompressor = zstandard.ZstdDecompressor()

    def unpack(self, record: bytes) -> Record:
        """What `RecordWriter.pack` packed.

        Raises:
            MapperdError: the bytes are no such record.
        """
        try:
            (crc,) = CRC.unpack_from(record)
            record = record[CRC.size :]
            if zlib.crc32(record) != crc:
                raise ValueError("wrong checksum")  # noqa: TRY301 one text for all damage
            size, moves, table, rows, beams, resolution_m, *numbers = HEAD.unpack_from(record)
            data = self._decompressor.decompress(
                record[HEAD.size :], max_output_size=rows * beams * size
            )
            samples = np.frombuffer(data, dtype=np.uint8 if size == 1 else "<f4")
            intensity = samples.reshape(rows, beams).astype(np.float32)
            echo = PingImage(intensity, self._bearings[table], resolution_m)
        except (struct.error, ValueError, IndexError, zstandard.ZstdError) as error:
            raise MapperdError(f"the spool is damaged: {error}") from error
        pose, motion = np.array(numbers[:16]).reshape(4, 4), numbers[16:]
        return echo, pose, _motion_of(motion) if moves else None


def _rounded_down(threshold: float) -> np.float32:
    """A float32 lies above it just if it lies above the threshold, as which the map compares."""
    near = np.float32(threshold)
    return near if float(near) <= threshold else np.nextafter(near, np.float32(-np.inf))


def _numbers_of(motion: PingMotion) -> list[float]:
    return [
        *np.asarray(motion.linear_mps).tolist(),
        *np.asarray(motion.angular_radps).tolist(),
        motion.valid_s,
        motion.speed_of_sound_mps,
    ]


def _motion_of(numbers: Sequence[float]) -> PingMotion:
    return PingMotion(np.array(numbers[:3]), np.array(numbers[3:6]), numbers[6], numbers[7])


ROW = np.dtype(
    [("t_ns", "<i8"), ("offset", "<i8"), ("size", "<i4"), ("first", "<i4", 3), ("last", "<i4", 3)]
)
"""Of a ping: time, place of its record, and the box of blocks that it may change, both with."""

PACKED = struct.Struct("<qqi3i3i")
"""The same."""

NO_TIME = np.iinfo(np.int64).min
NO_BOX = ((1, 1, 1), (0, 0, 0))
"""A ping that observes nothing."""

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
        """Write the number of records."""
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
        rows: file of their index.
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
