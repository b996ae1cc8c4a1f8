"""Opens recordings of any known format. The content determines the format, not the file name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, Self

from oculus_driver.errors import RecordingError, RecordingMissingError
from oculus_driver.framing import header_fault, read_header
from oculus_driver.recording.chunk import OCULUS, Chunk, DamagedPart, Progress
from oculus_driver.recording.mcap_reader import read_mcap
from oculus_driver.recording.mcap_records import HEAD, MAGIC, header, read_summary, strings
from oculus_driver.recording.network_capture import read_network_capture
from oculus_driver.recording.oculus_log import (
    CONVERTED_MAGIC,
    FILE_MAGIC,
    is_encrypted,
    read_oculus_log,
)
from oculus_driver.recording.pcap_files import PCAP_MAGICS, PCAPNG_MAGIC
from oculus_driver.recording.viewpoint_log import is_ros_bag, read_viewpoint_log
from oculus_driver.recording.writer import LIBRARY
from oculus_driver.stream import StreamParser
from oculus_driver.wire import HEADER, MAX_MESSAGE_SIZE, PAYLOAD_LIMITS

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator
    from types import TracebackType


MCAP: Final = "mcap"
OCULUS_RAW: Final = "oculus-raw"
OCULUS_LOG: Final = "oculus-log"
VIEWPOINT_LOG: Final = "viewpoint-log"
PCAP: Final = "pcap"
PCAPNG: Final = "pcapng"

READERS: Final[dict[str, Callable[[BinaryIO, int, Progress], Iterator[Chunk]]]] = {
    MCAP: read_mcap,
    OCULUS_RAW: lambda file, _, progress: read_raw(file, progress),
    OCULUS_LOG: read_oculus_log,
    VIEWPOINT_LOG: read_viewpoint_log,
    PCAP: read_network_capture,
    PCAPNG: read_network_capture,
}
"""Readers by format: yield the chunks of an open file of a given size and update `Progress`."""

_PROBE: Final = 1 << 16
_MIN_MAGIC: Final = 6
_MAX_HEADER: Final = 1 << 10

_MAGICS: Final = {
    FILE_MAGIC.to_bytes(4, "little"): OCULUS_LOG,
    CONVERTED_MAGIC.to_bytes(4, "little"): OCULUS_LOG,
    b"SQLite format 3\0": VIEWPOINT_LOG,
    **dict.fromkeys(PCAP_MAGICS, PCAP),
    PCAPNG_MAGIC: PCAPNG,
}

_ROS_BAG: Final = (
    "it holds ROS messages, not the bytes of the sonar; `mapperd --replay` maps the sonar messages "
    "in it, of ROS 2 best by the bag's folder"
)

_FOREIGN: Final = {
    b"#ROSBAG": f"a ROS 1 bag: {_ROS_BAG}",
    b"\x1f\x8b": "compressed with gzip",
    b"\x28\xb5\x2f\xfd": "compressed with zstd",
    b"PK\x03\x04": "a zip archive",
}


def detect_format(path: Path, file: BinaryIO, size: int) -> str:
    """Return the format of an open file by its content. Moves the file position.

    Raises:
        RecordingError: the file is not a recording, or it is encrypted.
    """
    if size == 0:
        raise RecordingError(f"{path}: file is empty; nothing was recorded")
    file.seek(0)
    probe = file.read(_PROBE)
    alike = sum(a == b for a, b in zip(probe, MAGIC, strict=False))
    if alike >= min(_MIN_MAGIC, size) or probe.startswith(header(LIBRARY), len(MAGIC)):
        if _is_ros_mcap(file, probe, size):
            raise RecordingError(f"{path}: unsupported file: a ROS bag: {_ROS_BAG}")
        return MCAP
    for magic, kind in _MAGICS.items():
        if probe.startswith(magic):
            if kind == OCULUS_LOG and is_encrypted(probe):
                raise RecordingError(f"{path}: file is encrypted; export it without encryption")
            if kind == VIEWPOINT_LOG and is_ros_bag(path):
                raise RecordingError(f"{path}: unsupported file: a ROS 2 bag: {_ROS_BAG}")
            return kind
    if is_raw_stream(file):
        return OCULUS_RAW
    raise RecordingError(
        f"{path}: {_description(probe)}; expected MCAP, a raw Oculus stream, an .oculus log, "
        "or a pcap or pcapng capture"
    )


def _is_ros_mcap(file: BinaryIO, probe: bytes, size: int) -> bool:
    """Return whether an MCAP file is a ROS bag without any link of a sonar. Moves the position."""
    start = len(MAGIC) + HEAD.size
    profile = next(iter(strings(probe[:_MAX_HEADER], start)), "")
    encodings = {encoding for _, encoding in read_summary(file, size).channels.values()}
    return profile.startswith("ros") and bool(encodings) and OCULUS not in encodings


def _description(probe: bytes) -> str:
    for magic, name in _FOREIGN.items():
        if probe.startswith(magic):
            return f"unsupported file: {name}"
    if not any(probe):
        return "file contains only zeros"
    printable = sum(byte >= 0x20 or byte in b"\t\n\r\f" for byte in probe)  # noqa: PLR2004 - space
    if printable == len(probe):
        return "is a text file"
    return "file contains no sonar messages"


class Recording:
    """A recording that can be read from front to back, repeatedly, by one reader at a time.

    Iteration yields `Chunk`s in recorded order and never raises because of the file's content.
    `truncated` and `damage` report problems; they are complete after the iteration.

    Attributes:
        path: of the file.
        format: one of the format names of this module.
        size_bytes: of the file.
        has_time: whether chunks have arrival stamps.
    """

    def __init__(self, path: Path, kind: str, file: BinaryIO, size_bytes: int) -> None:
        self.path = path
        self.format = kind
        self.size_bytes = size_bytes
        self._file = file
        self._span_ns: tuple[int | None, int | None] = (None, None)
        self._progress = Progress()
        if kind != OCULUS_RAW:
            self._look_ahead()
        self.has_time = self._span_ns[0] is not None

    def __iter__(self) -> Iterator[Chunk]:
        self._progress = Progress()
        return self._chunks(self._progress)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def start_ns(self) -> int | None:
        """Earliest stamp, nanoseconds since 1970; in a damaged file the first one."""
        return self._span_ns[0]

    @property
    def end_ns(self) -> int | None:
        """Latest stamp; for a file that was not closed it is known only after the iteration."""
        return self._span_ns[1] if self._span_ns[1] is not None else self._progress.last_ns

    @property
    def bytes_read(self) -> int:
        """Progress of the iteration in the file."""
        return self._progress.bytes_read

    @property
    def truncated(self) -> bool:
        """Whether the file ends before its content does."""
        return self._progress.truncated

    @property
    def damage(self) -> str | None:
        """The first problem of the file, human-readable."""
        return self._progress.damage

    @property
    def read_error(self) -> OSError | None:
        """Error of the disk if the file could not be read to its end."""
        return self._progress.read_error

    @property
    def faults(self) -> int:
        """Number of problems of the file."""
        return self._progress.faults

    @property
    def damaged_parts(self) -> tuple[DamagedPart, ...]:
        """The first 1000 parts of the file whose checksum fails; their chunks are damaged."""
        return tuple(self._progress.damaged_parts)

    @property
    def damaged_bytes(self) -> int:
        """Size of all parts whose checksum fails."""
        return self._progress.damaged_bytes

    @property
    def link_losses(self) -> int:
        """Number of gaps that the recorder marked, as after a lost connection; no damage."""
        return self._progress.link_losses

    @property
    def data_lost(self) -> bool:
        """Whether damage of an MCAP file, other than a missing end, may have cost data."""
        return self.format == MCAP and self._progress.data_lost

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata written by the recorder, such as format_version."""
        return dict(self._progress.metadata)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _chunks(self, progress: Progress) -> Iterator[Chunk]:
        try:
            self._file.seek(0)
            yield from READERS[self.format](self._file, self.size_bytes, progress)
        except OSError as error:
            progress.read_error = error
            progress.data_lost = True
            progress.report_truncation(f"read error: {error.strerror or error}")

    def _look_ahead(self) -> None:
        """Read the time span from the index if there is one, else from the first chunk."""
        glimpse = Progress()
        first = next(self._chunks(glimpse), None)
        self._progress.metadata = glimpse.metadata
        start_ns = None if first is None else first.arrival_ns
        indexed = read_summary(self._file, self.size_bytes).span_ns if self.format == MCAP else None
        self._span_ns = indexed or (start_ns, None)


def open_recording(path: str | os.PathLike[str]) -> Recording:
    """Return the recording in a file.

    Raises:
        RecordingError: the file does not exist, cannot be read, or is not a recording.
    """
    where = Path(path)
    file = _open(where)
    try:
        size = file.seek(0, 2)
        return Recording(where, detect_format(where, file, size), file, size)
    except OSError as error:
        file.close()
        raise RecordingError(f"{where}: cannot be read: {error.strerror or error}") from error
    except BaseException:
        file.close()
        raise


def _open(path: Path) -> BinaryIO:
    try:
        if not path.is_file():
            if path.is_dir():
                raise RecordingError(f"{path}: path is a directory; name a file in it")
            if path.exists():
                raise RecordingError(f"{path}: not a regular file; copy the bytes into one")
            raise RecordingMissingError(f"{path}: no such file; check the name")
        return path.open("rb")
    except PermissionError as error:
        text = f"{path}: permission denied; check the file permissions"
        raise RecordingMissingError(text) from error
    except (OSError, ValueError) as error:
        raise RecordingMissingError(f"{path}: cannot be opened: {error}") from error


RAW_LINK: Final = "sonar"
BLOCK: Final = 1 << 16
_SEARCHED: Final = 2 * MAX_MESSAGE_SIZE
"""A raw stream must contain a message within this many bytes: two of the largest."""


def is_raw_stream(file: BinaryIO) -> bool:
    """Return whether a file is an Oculus stream, even one with a damaged start."""
    file.seek(0)
    parser = StreamParser()
    first = file.read(BLOCK)
    if len(first) >= HEADER.size and header_fault(read_header(first, 0), strict=True) is None:
        return True
    block = first
    while block and parser.counters.bytes_total < _SEARCHED:
        parser.feed(block)
        if _has_known(parser):
            return True
        block = file.read(BLOCK)
    parser.finish()
    return _has_known(parser)


def _has_known(parser: StreamParser) -> bool:
    return any(number in PAYLOAD_LIMITS for number in parser.counters.messages)


def read_raw(file: BinaryIO, progress: Progress) -> Iterator[Chunk]:
    """Yield the bytes of a raw stream in blocks; report bytes outside messages in `progress`."""
    file.seek(0)
    parser = StreamParser(confirm=True)
    while block := file.read(BLOCK):
        progress.bytes_read += len(block)
        parser.feed(block)
        yield Chunk(RAW_LINK, OCULUS, None, block)
    parser.finish()
    rejected = parser.counters.bytes_rejected
    if parser.counters.rejects["truncated"]:
        progress.report_truncation(
            f"the file ends inside a message; {rejected} bytes outside messages"
        )
    elif rejected:
        progress.report(f"{rejected} bytes outside messages")
