"""Odometry from separate files, merged into a recording by time.

A replay decodes and fuses it like recorded odometry.
"""

import hashlib
import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol

import msgspec

from mapperd.config.odometry import (
    FIXED,
    NOBODY,
    SONAR,
    OwnersConfig,
    SonarOdometryConfig,
    WorldInitConfig,
)
from mapperd.config.tree import Config
from mapperd.odometry.bridge import ENCODING_PREFIX
from mapperd.odometry.ros_bag import RosPoses, is_ros_bag
from mapperd.odometry.trajectory_files import POSES_LINK, CsvFile, TumFile
from mapperd.odometry.vehicle_logs import (
    ArduPilotLog,
    CaptureFile,
    RecordedOdometry,
    TelemetryLog,
)
from oculus_driver.errors import RecordingError
from oculus_driver.recording import Chunk

__all__ = [
    "OdometryFile",
    "OdometryFiles",
    "OdometryMerge",
    "OdometryOptions",
    "captured_odometry",
    "content_files",
    "read_odometry",
]

NS = 10**9
LEAD_NS = 60 * NS
"""Poses further than this before the recording are skipped."""

REST_NS = 10 * NS
"""Odometry further than this after the end of the recording is skipped."""

ID_BYTES = 1 << 20
PROBE = 1 << 12
CAPTURES = (
    b"\xd4\xc3\xb2\xa1",
    b"\xa1\xb2\xc3\xd4",
    b"\x4d\x3c\xb2\xa1",
    b"\xa1\xb2\x3c\x4d",
    b"\x0a\x0d\x0d\x0a",
)
"""First bytes of pcap in either byte order, and of pcapng."""

DATAFLASH = b"\xa3\x95\x80"
MCAP_MAGIC = b"\x89MCAP0\r\n"


class OdometryFile(Protocol):
    """Odometry in a file."""

    @property
    def path(self) -> Path:
        """Path of the file or folder."""

    @property
    def kind(self) -> str:
        """Name of the format, for people."""

    @property
    def is_finished(self) -> bool:
        """Whether it holds finished poses, not the bytes of a vehicle."""

    @property
    def expected(self) -> str:
        """The content that is read, for people."""

    def chunks(self) -> Iterator[Chunk]:
        """Yield the odometry in order of time; every chunk has an arrival stamp.

        Raises:
            RecordingError: the content is malformed; one line with file, position and remedy.
            ConfigError: the format needs a library that is not installed.
        """


@dataclass(frozen=True, slots=True)
class OdometryOptions:
    """Which odometry to read.

    Attributes:
        paths: files, and folders of ROS bags.
        offset_s: added to all times of the files.
        topic: of ROS bags; None selects the only one with poses, else the transforms.
        frames: fixed frame and body frame of transforms in ROS bags; None selects the odometry's
            or the map's frame, and the vehicle's.
    """

    paths: tuple[Path, ...]
    offset_s: float = 0.0
    topic: str | None = None
    frames: tuple[str, str] | None = None


def read_odometry(options: OdometryOptions, config: Config) -> "OdometryFiles":
    """Read all files once, to check them.

    Args:
        options: the files.
        config: the sources, whose formats apply to captures and logs.

    Raises:
        RecordingError: a file has no odometry, is malformed, or empty.
        ConfigError: a format needs a library that is not installed.
    """
    offset_ns = round(options.offset_s * NS)
    return _checked(
        [_opened(path, offset_ns, options, config) for path in options.paths], offset_ns
    )


def _checked(files: Sequence[OdometryFile], offset_ns: int) -> "OdometryFiles":
    spans = [_span(file) for file in files]
    links = frozenset[str]().union(*(links for _, _, links in spans))
    first_ns, last_ns = min(first for first, _, _ in spans), max(last for _, last, _ in spans)
    return OdometryFiles(tuple(files), offset_ns, first_ns, last_ns, links)


def captured_odometry(paths: Sequence[Path], config: Config) -> "OdometryFiles | None":
    """Return the odometry in the captures of the sonar's data; None without any.

    Args:
        paths: of the captures.
        config: the sources, whose ports select the datagrams.
    """
    files = [CaptureFile(path, 0, config) for path in paths]
    held = [file for file in files if next(file.chunks(), None) is not None]
    return _checked(held, 0) if held else None


def _opened(path: Path, offset_ns: int, options: OdometryOptions, config: Config) -> OdometryFile:
    """Return the reader of a file, by its content."""
    try:
        if is_ros_bag(path):
            return RosPoses(path, offset_ns, options.topic, options.frames, config)
        if path.is_dir():
            raise RecordingError(f"{path}: no ROS bag in this folder; name a file of odometry")
        with path.open("rb") as file:
            probe = file.read(PROBE)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    log = _log_of(path, probe)
    if log is not None:
        return log(path, offset_ns, config)
    if probe.startswith(MCAP_MAGIC):
        return RecordedOdometry(path, offset_ns)
    line = _first_line(probe)
    words = line.split()
    if len(words) == len(TumFile.COLUMNS) and all(map(_is_number, words)):
        return TumFile(path, offset_ns)
    if any(mark in line for mark in ",;\t") and any(map(str.isalpha, line)):
        return CsvFile(path, offset_ns)
    raise RecordingError(
        f"{path}: not a file of odometry; known are TUM, CSV with a header, ROS bags, ArduPilot "
        ".tlog and .BIN, captures (pcap), recordings (MCAP)"
    )


def _log_of(path: Path, probe: bytes) -> Callable[[Path, int, Config], OdometryFile] | None:
    if probe.startswith(CAPTURES):
        return CaptureFile
    if probe.startswith(DATAFLASH):
        return ArduPilotLog
    return TelemetryLog if path.suffix.lower() == ".tlog" else None


def _first_line(probe: bytes) -> str:
    """Return the first line that is not a comment; of binary data nothing."""
    text = probe.decode("utf-8-sig", errors="replace")
    if "\0" in text or "\ufffd" in text[: PROBE // 2]:
        return ""
    lines = [line.strip() for line in text.splitlines()]
    return next((line for line in lines if line and not line.startswith("# ")), "")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _span(file: OdometryFile) -> tuple[int, int, set[str]]:
    """Return first and last time, and the links."""
    first_ns = last_ns = None
    links: set[str] = set()
    for chunk in file.chunks():
        stamp_ns = chunk.arrival_ns or 0
        first_ns = stamp_ns if first_ns is None else min(first_ns, stamp_ns)
        last_ns = stamp_ns if last_ns is None else max(last_ns, stamp_ns)
        links.add(chunk.link)
    if first_ns is None or last_ns is None:
        raise RecordingError(f"{file.path}: has no {file.expected}")
    return first_ns, last_ns, links


def content_files(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield files, and those in the folders of bags."""
    for path in paths:
        if path.is_dir():
            yield from sorted(one for one in path.iterdir() if one.is_file())
        else:
            yield path


@dataclass(frozen=True, slots=True)
class OdometryFiles:
    """The odometry of all files, checked.

    Attributes:
        files: in the order given.
        offset_ns: added to their times.
        first_ns, last_ns: its span, Unix time.
        links: names of its chunks' links.
    """

    files: tuple[OdometryFile, ...]
    offset_ns: int
    first_ns: int
    last_ns: int
    links: frozenset[str]

    def __str__(self) -> str:
        """Return the files and their formats."""
        return ", ".join(f"{file.path} ({file.kind})" for file in self.files)

    def merge(self) -> "OdometryMerge":
        """Return an object that merges the odometry into one session."""
        streams = [file.chunks() for file in self.files]
        return OdometryMerge(heapq.merge(*streams, key=attrgetter("arrival_ns")))

    def settings(self, config: Config) -> Config:
        """Return the settings for the poses.

        Owners are links of the files. Finished poses are used unchanged: without levelling,
        continuation at jumps, sonar odometry, or a confidence gate.
        """
        replace = msgspec.structs.replace
        if all(file.is_finished for file in self.files):
            return replace(
                config,
                odometry=replace(
                    config.odometry,
                    owners=OwnersConfig(),
                    at_jump="follow",
                    sonar=SonarOdometryConfig(),
                ),
                slam_quality=replace(config.slam_quality, fail_mode="open"),
                world_init=WorldInitConfig(),
            )
        owners, kept = config.odometry.owners, {"", NOBODY, FIXED, *self.links}
        if config.odometry.sonar.enabled:
            kept.add(SONAR)
        others = {key: "" for key in owners.__struct_fields__ if getattr(owners, key) not in kept}
        return replace(config, odometry=replace(config.odometry, owners=replace(owners, **others)))

    def identity(self) -> bytes:
        """Return an id that is equal for equal files with equal offsets, in any folder."""
        digest = hashlib.sha256(str(self.offset_ns).encode())
        for path in content_files(file.path for file in self.files):
            digest.update(path.stat().st_size.to_bytes(8, "little"))
            with path.open("rb") as content:
                digest.update(content.read(ID_BYTES))
        return digest.digest()

    def summary(self) -> dict[str, Any]:
        """Return facts about the files for the results."""
        return {
            "files": [str(file.path) for file in self.files],
            "formats": [file.kind for file in self.files],
            "offset_s": self.offset_ns / NS,
            "first_s": self.first_ns / NS,
            "last_s": self.last_ns / NS,
        }


class OdometryMerge:
    """Replaces the recorded odometry of one session by odometry from files.

    Args:
        odometry: in order of time; every chunk has an arrival stamp.
    """

    def __init__(self, odometry: Iterator[Chunk]) -> None:
        self._odometry = odometry
        self._next = next(odometry, None)
        self._last_ns: int | None = None

    def into(self, chunks: Iterable[Chunk], *, is_last: bool) -> Iterator[Chunk]:
        """Yield the chunks of the session's next file with the odometry between them.

        Args:
            chunks: of the file.
            is_last: no file of the session follows.
        """
        held: Chunk | None = None
        for chunk in chunks:
            if chunk.encoding.startswith(ENCODING_PREFIX):
                continue
            if held is not None:
                yield from self._before(held, chunk)
                yield held
            held = chunk
        if held is not None:
            yield from self._before(held, held)
            yield held
        if is_last and self._last_ns is not None:
            yield from self._until(self._last_ns + REST_NS)

    def _before(self, chunk: Chunk, following: Chunk) -> Iterator[Chunk]:
        """Yield the odometry before a chunk; a single stamp far ahead is an error."""
        if chunk.arrival_ns is None or chunk.damaged:
            return
        t_ns = chunk.arrival_ns
        if following.arrival_ns is not None and not following.damaged:
            t_ns = min(t_ns, following.arrival_ns)
        if self._last_ns is None:
            while self._is_long_before(t_ns):
                self._next = next(self._odometry, None)
        self._last_ns = t_ns if self._last_ns is None else max(t_ns, self._last_ns)
        yield from self._until(t_ns)

    def _is_long_before(self, t_ns: int) -> bool:
        """Return whether the next chunk is a pose that no ping needs; logs are read entirely."""
        chunk = self._next
        if chunk is None or chunk.arrival_ns is None or chunk.link != POSES_LINK:
            return False
        return chunk.arrival_ns < t_ns - LEAD_NS

    def _until(self, t_ns: int) -> Iterator[Chunk]:
        while self._next is not None and (self._next.arrival_ns or 0) <= t_ns:
            yield self._next
            self._next = next(self._odometry, None)
