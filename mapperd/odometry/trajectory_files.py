"""Trajectories in text files: TUM, and CSV with a header.

Each pose becomes a chunk with a native record, like recorded odometry. Position fixes are CSV, too.
"""

import csv
import math
from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TextIO

from mapperd.config.tree import Config
from mapperd.geometry.frames import Body, World, compass_quaternion, rotation_from_rpy
from mapperd.geometry.geodesy import Origin
from mapperd.odometry.native import NativeRecord, encode_native
from mapperd.odometry.records import MAX_DISTANCE_M, bad_numbers, bad_quaternion
from oculus_driver.errors import RecordingError
from oculus_driver.recording import ODOMETRY_NATIVE, Chunk

__all__ = ["FINISHED", "POSES_LINK", "CsvFile", "FixFile", "TumFile", "pose_chunk"]

POSES_LINK = "file:poses"
"""Link of finished poses; no configured source can have this name."""

FINISHED = {"poses": "finished"}
"""Metadata of a recording whose native records are finished poses, used as they are."""

NS = 10**9
MAX_TIME_S = 10**11
"""Larger times are not in seconds."""

MAX_DIGITS = 12
"""Maximum digits of whole seconds."""

MAX_ANGLE_DEG = 720.0
MAX_LINE = 1 << 16
NAME_CHARACTERS = 30


def pose_chunk(
    stamp_ns: int,
    position_m: Sequence[float] | None,
    wxyz: Sequence[float] | None,
    *,
    world: World = "enu",
    body: Body = "flu",
    covariance: Sequence[float] | None = None,
) -> Chunk:
    """Return a pose as a recorded chunk; its decoder rejects invalid poses.

    Args:
        stamp_ns: Unix time.
        position_m: (3,) of the body in the world; None if unknown.
        wxyz: (4,) orientation of the body in the world; None if unknown.
        world: its axes.
        body: its axes.
        covariance: upper triangle of 21, x y z then rotations about world axes; m and rad.
    """
    record = NativeRecord(
        v=1,
        clk="unix",
        w=world,
        b=body,
        t=max(stamp_ns, 0),
        p=None if position_m is None else tuple(position_m),
        q=None if wxyz is None else tuple(wxyz),
        pc=None if covariance is None else tuple(covariance),
    )
    return Chunk(POSES_LINK, ODOMETRY_NATIVE, stamp_ns, encode_native(record))


def _bad_pose(position_m: Sequence[float], wxyz: Sequence[float]) -> str | None:
    """Return why these numbers are not a pose, or None."""
    reject = (
        bad_numbers("position", position_m, MAX_DISTANCE_M)
        or bad_numbers("quaternion", wxyz, 1e3)
        or bad_quaternion(wxyz)
    )
    return None if reject is None else reject.detail


Row = tuple[int, int, list[float], list[float]]
"""Line number, Unix time in ns, position and quaternion (w, x, y, z)."""


class _TextPoses:
    """Poses in lines of text; times must not decrease.

    Args:
        path: the file.
        offset_ns: added to all times.

    Attributes:
        path: as given.
    """

    is_finished = True
    expected = "poses"

    def __init__(self, path: Path, offset_ns: int = 0) -> None:
        self.path = path
        self._offset_ns = offset_ns

    def chunks(self) -> Iterator[Chunk]:
        """Yield the poses in order of time; for equal times the first one.

        Raises:
            RecordingError: a line is malformed.
        """
        last_ns: int | None = None
        try:
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                for line, stamp_ns, position_m, wxyz in self._rows(file):
                    if problem := _bad_pose(position_m, wxyz):
                        raise self._bad(line, problem)
                    if last_ns is not None and stamp_ns < last_ns:
                        back_s = (last_ns - stamp_ns) / NS
                        text = f"time goes back by {back_s:g} s; sort the file by time"
                        raise self._bad(line, text)
                    if stamp_ns != last_ns:
                        yield pose_chunk(stamp_ns + self._offset_ns, position_m, wxyz)
                    last_ns = stamp_ns
        except UnicodeDecodeError as error:
            raise RecordingError(f"{self.path}: not UTF-8 text (byte {error.start})") from error
        except OSError as error:
            raise RecordingError(
                f"{self.path}: cannot be read: {error.strerror or error}"
            ) from error

    def _rows(self, file: TextIO) -> Iterator[Row]:
        """Yield the poses of an open file."""
        raise NotImplementedError

    def _bad(self, line: int, problem: str) -> RecordingError:
        return RecordingError(f"{self.path}: line {line}: {problem}")

    def _time_ns(self, line: int, text: str, column: str) -> int:
        stamp_ns = _nanoseconds(text)
        if stamp_ns is None:
            raise self._bad(line, f"{column} {text[:NAME_CHARACTERS]!r} is not a time in seconds")
        return stamp_ns

    def _number(self, line: int, text: str, column: str) -> float:
        try:
            return float(text)
        except ValueError:
            name = f"{column} {text[:NAME_CHARACTERS]!r}"
            raise self._bad(line, f"{name} is not a number") from None


class TumFile(_TextPoses):
    """Lines of `timestamp tx ty tz qx qy qz qw`; `#` begins a comment."""

    kind = "TUM"
    COLUMNS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")

    def _rows(self, file: TextIO) -> Iterator[Row]:
        for line, text in enumerate(file, 1):
            words = text[:MAX_LINE].partition("#")[0].split()
            if not words:
                continue
            if len(words) != len(self.COLUMNS):
                columns = " ".join(self.COLUMNS)
                raise self._bad(line, f"{len(words)} columns; 8 are needed: {columns}")
            stamp_ns = self._time_ns(line, words[0], "timestamp")
            named = zip(words[1:], self.COLUMNS[1:], strict=True)
            numbers = [self._number(line, word, name) for word, name in named]
            x, y, z, w = numbers[3:]
            yield line, stamp_ns, numbers[:3], [w, x, y, z]


SECONDS = ("time_s", "timestamp", "time", "stamp", "t")
NANOSECONDS = ("time_ns", "timestamp_ns")
TIMES = tuple((name,) for name in (*SECONDS, *NANOSECONDS))
NED = ("north_m", "east_m", "down_m")
POSITIONS = (
    ("x_m", "y_m", "z_m"),
    ("x", "y", "z"),
    ("tx", "ty", "tz"),
    ("east_m", "north_m", "up_m"),
    NED,
)
QUATERNION = ("qx", "qy", "qz", "qw")
COMPASS = ("roll_deg", "pitch_deg", "heading_deg")
ORIENTATIONS = (QUATERNION, ("roll_deg", "pitch_deg", "yaw_deg"), COMPASS)


class CsvFile(_TextPoses):
    """Rows under a header that names the columns; unknown columns are ignored.

    Positions are east, north, up unless the columns are north_m, east_m, down_m. Angles are those
    of `rotation_from_rpy`, with heading_deg those of `compass_quaternion`.
    """

    kind = "CSV"

    def _rows(self, file: TextIO) -> Iterator[Row]:
        for line, stamp_ns, columns, numbers in self._table(file, (POSITIONS, ORIENTATIONS)):
            (place, turn), (position_m, angles) = columns, numbers
            yield line, stamp_ns, _enu(place, position_m), self._wxyz(line, turn, angles)

    def _table(
        self, file: TextIO, choices: Sequence[Sequence[tuple[str, ...]]]
    ) -> Iterator[tuple[int, int, list[tuple[str, ...]], list[list[float]]]]:
        """Yield line, time, the columns of each choice and their numbers."""
        header, first = file.readline(MAX_LINE), 1
        while header.startswith("# ") or header.isspace():
            header, first = file.readline(MAX_LINE), first + 1
        mark = max(",;\t", key=header.count)
        names = [name.strip().strip("#\"'").strip().lower() for name in header.split(mark)]
        (time,) = self._columns(first, "time", TIMES, names)
        kinds = ("position", "orientation")
        columns = [
            self._columns(first, what, choice, names)
            for what, choice in zip(kinds, choices, strict=False)
        ]
        wanted = {name: names.index(name) for some in ((time,), *columns) for name in some}
        reader = csv.reader(file, delimiter=mark)
        try:
            for row in reader:
                line = reader.line_num + first
                if not any(row):
                    continue
                if len(row) <= max(wanted.values()):
                    raise self._bad(line, f"{len(row)} columns; the header has {len(names)}")
                cells = {name: row[index].strip() for name, index in wanted.items()}
                numbers = [[self._number(line, cells[n], n) for n in some] for some in columns]
                yield line, self._stamp(line, cells[time], time), columns, numbers
        except csv.Error as error:
            raise self._bad(reader.line_num + first, str(error)) from error

    def _columns(
        self, line: int, what: str, choices: Sequence[tuple[str, ...]], names: Sequence[str]
    ) -> tuple[str, ...]:
        for choice in choices:
            if all(name in names for name in choice):
                return choice
        allowed = " or ".join(",".join(choice) for choice in choices)
        raise self._bad(line, f"the header names no {what}; allowed columns: {allowed}")

    def _stamp(self, line: int, text: str, column: str) -> int:
        if column in SECONDS:
            return self._time_ns(line, text, column)
        if not text.isdecimal() or len(text) > MAX_DIGITS + 9:
            name = f"{column} {text[:NAME_CHARACTERS]!r}"
            raise self._bad(line, f"{name} is not a time in nanoseconds")
        return int(text)

    def _wxyz(self, line: int, names: tuple[str, ...], numbers: list[float]) -> list[float]:
        if names == QUATERNION:
            x, y, z, w = numbers
            return [w, x, y, z]
        for name, number in zip(names, numbers, strict=True):
            if not abs(number) <= MAX_ANGLE_DEG:
                raise self._bad(line, f"{name} is {number:g}; from -720 to 720 degrees")
        roll, pitch, third = numbers
        turn = compass_quaternion if names == COMPASS else rotation_from_rpy
        wxyz: list[float] = turn(roll, pitch, third).tolist()
        return wxyz


GEOGRAPHIC = ("latitude_deg", "longitude_deg")
DEVIATION = "deviation_m"
FIX_POSITIONS = tuple(
    names
    for place in (
        ("x_m", "y_m"),
        ("x", "y"),
        ("east_m", "north_m"),
        ("north_m", "east_m"),
        GEOGRAPHIC,
    )
    for names in ((*place, DEVIATION), place)
)
MIN_DEVIATION_M, DEFAULT_DEVIATION_M = 0.001, 1.0


class FixFile(CsvFile):
    """Known positions of a vehicle, such as by GPS at the surface, as CSV with a header.

    Columns: a time as in other files; `x_m,y_m` (`x,y`, `east_m,north_m` in either order), or
    `latitude_deg,longitude_deg`; `deviation_m`, one standard deviation, 1 m without that column.
    """

    kind = "position fixes"
    expected = "position fixes"

    def fixes(self, config: Config) -> tuple[tuple[int, float, float, float], ...]:
        """Return Unix time (ns), x, y and standard deviation (m) of each fix.

        Args:
            config: whose `odometry.origin` latitudes and longitudes need.

        Raises:
            RecordingError: the file is malformed, or needs an origin.
        """
        found = []
        geo = config.odometry.origin
        origin = None if geo is None else Origin.of_degrees(geo.latitude, geo.longitude)
        try:
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                for line, stamp_ns, (names,), (numbers,) in self._table(file, (FIX_POSITIONS,)):
                    x, y = numbers[:2]
                    deviation_m = numbers[2] if len(names) > 2 else DEFAULT_DEVIATION_M  # noqa: PLR2004
                    if names[0] == "north_m":
                        x, y = y, x
                    if names[:2] == GEOGRAPHIC:
                        x, y = self._east_north(line, x, y, origin)
                    if not (abs(x) <= MAX_DISTANCE_M and abs(y) <= MAX_DISTANCE_M):
                        raise self._bad(line, f"position ({x:g}, {y:g}) m is out of range")
                    if not MIN_DEVIATION_M <= deviation_m <= MAX_DISTANCE_M:
                        text = f"{DEVIATION} is {deviation_m:g}; at least {MIN_DEVIATION_M:g} m"
                        raise self._bad(line, text)
                    found.append((stamp_ns + self._offset_ns, x, y, deviation_m))
        except UnicodeDecodeError as error:
            raise RecordingError(f"{self.path}: not UTF-8 text (byte {error.start})") from error
        except OSError as error:
            raise RecordingError(
                f"{self.path}: cannot be read: {error.strerror or error}"
            ) from error
        if not found:
            raise RecordingError(f"{self.path}: no position fix in it")
        return tuple(found)

    def _east_north(
        self, line: int, latitude_deg: float, longitude_deg: float, origin: Origin | None
    ) -> tuple[float, float]:
        if origin is None:
            raise self._bad(line, "latitudes need an origin: set odometry.origin")
        if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):  # noqa: PLR2004 degrees
            raise self._bad(line, f"{latitude_deg:g}, {longitude_deg:g} is no place on Earth")
        place = (math.radians(latitude_deg), math.radians(longitude_deg))
        east_m, north_m, _ = origin.enu_m(*place, 0.0).tolist()
        return east_m, north_m


def _enu(names: tuple[str, ...], numbers: list[float]) -> list[float]:
    if names == NED:
        north, east, down = numbers
        return [east, north, -down]
    return numbers


def _nanoseconds(text: str) -> int | None:
    """Convert decimal Unix seconds to ns, exactly; None if not a number or too large."""
    whole, _, part = text.partition(".")
    if whole.isdecimal() and len(whole) < MAX_DIGITS and (part.isdecimal() or not part):
        return int(whole) * NS + int(f"{part[:9]:0<9}")
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        return None
    return int(seconds * NS) if seconds.is_finite() and abs(seconds) < MAX_TIME_S else None
