"""The trajectory of the mapped pings: a line of TUM and of CSV for each."""

import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd.config.daemon import FramesConfig
from mapperd.errors import ExportError
from mapperd.geometry.frames import Pose
from mapperd.io import atomic_file, remove

__all__ = ["TRAJECTORY_CSV", "TRAJECTORY_TUM", "TrajectoryWriter"]

TRAJECTORY_TUM, TRAJECTORY_CSV = "trajectory.tum", "trajectory.csv"

CSV_HEADER = "time_s,x_m,y_m,z_m,qx,qy,qz,qw,frame,child_frame\n"

ROW = np.dtype([("t_ns", "<i8"), ("xyz_m", "<f8", 3), ("wxyz", "<f8", 4)])
ROWS_AT_ONCE = 4096


class TrajectoryWriter:
    """Collects poses in an unnamed file, because a session may last for weeks.

    `add` only appends to memory and never waits for the disk; `flush` moves what was added to the
    file, from another thread if that must not wait.

    Args:
        folder: where the unnamed file and the results lie; it exists.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._added = bytearray()
        self._adding, self._flushing = threading.Lock(), threading.Lock()
        self._file: BinaryIO | None = None
        self._problem = ""

    def add(self, t_ns: int | None, pose: Pose) -> None:
        """Add the pose of a mapped ping.

        Args:
            t_ns: Unix time of the middle of the image; without it the pose is left out.
            pose: base in the map.
        """
        if t_ns is None:
            return
        row = np.array((t_ns, pose.position_m, pose.map_q_base), dtype=ROW)
        with self._adding:
            self._added += row.tobytes()

    def flush(self) -> None:
        """Move what was added to the file; an error is reported by `write`."""
        with self._flushing:
            with self._adding:
                rows, self._added = self._added, bytearray()
            if not rows or self._problem:
                return
            try:
                if self._file is None:
                    self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 see close
                self._file.write(rows)
            except OSError as error:
                self._problem = error.strerror or str(error)

    def write(self, frames: FramesConfig) -> None:
        """Write `trajectory.tum` and `trajectory.csv`; without a pose remove them.

        Args:
            frames: names of the map's frame and of the vehicle's.

        Raises:
            ExportError: a file cannot be written, or poses were lost.
        """
        self.flush()
        tum, csv = self._folder / TRAJECTORY_TUM, self._folder / TRAJECTORY_CSV
        if self._problem:
            raise ExportError(f"{tum}: not written: {self._problem}")
        if self._file is None:
            remove(tum)
            remove(csv)
            return
        with atomic_file(tum) as text:
            text.write(b"# timestamp tx ty tz qx qy qz qw\n")
            for line in self._lines(" "):
                text.write(f"{line}\n".encode())
        names = f",{frames.map},{frames.base}\n"
        with atomic_file(csv) as text:
            text.write(CSV_HEADER.encode())
            for line in self._lines(","):
                text.write(f"{line}{names}".encode())

    def close(self) -> None:
        """Remove the unnamed file."""
        if self._file is not None:
            self._file.close()

    def _lines(self, mark: str) -> Iterator[str]:
        for rows in self._rows():
            for t_ns, xyz_m, (w, x, y, z) in rows.tolist():
                time = f"{t_ns // 10**9}.{t_ns % 10**9:09}"
                numbers = [f"{number:.6f}" for number in xyz_m]
                turn = [f"{number:.9f}" for number in (x, y, z, w)]
                yield mark.join((time, *numbers, *turn))

    def _rows(self) -> Iterator[NDArray[np.void]]:
        if self._file is None:
            return
        self._file.seek(0)
        while data := self._file.read(ROWS_AT_ONCE * ROW.itemsize):
            yield np.frombuffer(data, dtype=ROW)
