"""Spools of a dive's pings between planning and mapping.

A spool has records one after the other, and an index of rows: position of each record, its time,
and the part of the map that it may change.
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

from mapper_survey.request import DiveTransform
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
    """Converts from a dive's map frame to the survey's.

    Args:
        transform: transform of the dive; None leaves poses bit-exact.
    """

    def __init__(self, transform: DiveTransform | None) -> None:
        self._survey_T_dive = None if transform is None else transform.matrix()

    def pose(self, dive_T_sonar: Floats) -> Floats:  # noqa: N803 frames are named
        """(4, 4) `survey_T_sonar`."""
        if self._survey_T_dive is None:
            return dive_T_sonar
        return self._survey_T_dive @ dive_T_sonar

    def motion(self, motion: PingMotion | None) -> PingMotion | None:
        """Return the motion with its velocity in the survey's frame; the turn rate stays."""
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
"""Bytes per sample, whether it moves, bearing table, rows, beams, metres per row, pose, motion."""

CRC = struct.Struct("<I")
"""Checksum before the data."""

LEVEL = -1
"""Level of zstd; level 1 makes records 10 % smaller and takes twice as long."""

STILL = (0.0,) * 8


class RecordWriter:
    """Packs pings; each bearing table is stored once.

    Args:
        threshold: `filtering.intensity_threshold`; only samples above it are kept.

    Attributes:
        bearings: tables so far, as bytes of float64 in radians.
    """

    def __init__(self, threshold: float) -> None:
        self.bearings: list[bytes] = []
        self._threshold = _rounded_down(threshold)
        self._whole_threshold = math.floor(threshold)
        self._numbers: dict[bytes, int] = {}
        self._compressor = zstandard.ZstdCompressor(level=LEVEL)

    def pack(self, image: PingImage, map_T_sonar: Floats, motion: PingMotion | None) -> bytes:  # noqa: N803 frames are named
        """Return the bytes of one ping."""
        samples = self._samples(image.intensity)
        rows, beams = samples.shape
        head = HEAD.pack(
            samples.itemsize,
            motion is not None,
            self._number(image.bearings_rad.tobytes()),
            rows,
            beams,
            image.range_resolution_m,
            *map_T_sonar.ravel().tolist(),
            *(STILL if motion is None else _numbers_of(motion)),
        )
        record = head + self._compressor.compress(samples.data)
        return CRC.pack(zlib.crc32(record)) + record

    def _samples(self, intensity: NDArray[np.float32]) -> NDArray[np.uint8] | NDArray[np.float32]:
        """Return samples as bytes if that is lossless."""
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
        bearings: tables of the writer.
    """

    def __init__(self, bearings: Sequence[bytes]) -> None:
        self._bearings = [np.frombuffer(table, dtype="<f8") for table in bearings]
        self._decompressor = zstandard.ZstdDecompressor()

    def unpack(self, record: bytes) -> Record:
        """Unpack a record of `RecordWriter.pack`.

        Raises:
            MapperdError: the record is invalid.
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
            image = PingImage(intensity, self._bearings[table], resolution_m)
        except (struct.error, ValueError, IndexError, zstandard.ZstdError) as error:
            raise MapperdError(f"the spool is damaged: {error}") from error
        pose, motion = np.array(numbers[:16]).reshape(4, 4), numbers[16:]
        return image, pose, _motion_of(motion) if moves else None


def _rounded_down(threshold: float) -> np.float32:
    """Return the largest float32 not above the threshold; float32 comparisons then agree."""
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
"""Row of a ping: time, position of its record, and inclusive box of blocks that it may change."""

PACKED = struct.Struct("<qqi3i3i")
"""The same as a struct."""

NO_TIME = np.iinfo(np.int64).min
NO_BOX = ((1, 1, 1), (0, 0, 0))
"""Box of a ping that observes nothing."""

Rows = NDArray[np.void]


class RowFile:
    """An array of `ROW` in numpy's file format, written row by row.

    Args:
        out: the file; its header is rewritten at the end.

    Attributes:
        count: number of rows so far.
    """

    def __init__(self, out: BinaryIO) -> None:
        self.count = 0
        self._out = out
        out.write(self._head())

    def add(self, row: tuple[int, ...]) -> None:
        """Append a row, given its numbers."""
        self._out.write(PACKED.pack(*row))
        self.count += 1

    def close(self) -> None:
        """Write the number of records."""
        self._out.seek(0)
        self._out.write(self._head())
        self._out.flush()

    def _head(self) -> bytes:
        """Return the header; its length does not depend on the count."""
        head = io.BytesIO()
        about = {"descr": ROW.descr, "fortran_order": False, "shape": (self.count,)}
        np.lib.format.write_array_header_1_0(head, about)
        return head.getvalue()


class SpoolMap(SonarMap):
    """Accepts and refuses pings like a map, but spools them.

    Args:
        config: the settings.
        out: file of the records.
        rows: file of their index.
        frame: conversion to the survey's frame.

    Attributes:
        t_ns: time of the next ping; None if unknown.
        first_ns, last_ns: minimum and maximum time so far; None without any.
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
        """Bearing tables of the records."""
        return self._writer.bearings

    @property
    def size_bytes(self) -> int:
        """Bytes of all records."""
        return self._offset

    def integrate(
        self,
        image: PingImage,
        map_T_sonar: NDArray[np.float64],  # noqa: N803 frames are named
        motion: PingMotion | None = None,
    ) -> PingStats:
        """Spool a ping; raises like a map."""
        placed, moved = self._frame.pose(map_T_sonar), self._frame.motion(motion)
        first, last = self.blocks_of(image, placed, moved) or NO_BOX
        record = self._writer.pack(image, placed, moved)
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
