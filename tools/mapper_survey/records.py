"""A ping as the integrators take it, in a few kilobytes.

Samples at or below the intensity threshold tell the integrators nothing: as zeros they compress to
nearly nothing, and the map is the same to the bit.
"""

import math
import struct
import zlib
from collections.abc import Sequence

import numpy as np
import zstandard
from numpy.typing import NDArray

from mapperd.errors import MapperdError
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage

__all__ = ["Record", "RecordReader", "RecordWriter"]

Floats = NDArray[np.float64]
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
