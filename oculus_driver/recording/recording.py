"""Open a recording of any known kind; its content says which, never its name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, Self

from oculus_driver.errors import RecordingError
from oculus_driver.recording.chunk import Chunk, Progress
from oculus_driver.recording.mcap_reader import read_mcap
from oculus_driver.recording.mcap_records import MAGIC
from oculus_driver.recording.raw import is_raw_stream, read_raw
from oculus_driver.recording.summary import read_summary

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator
    from types import TracebackType

MCAP: Final = "mcap"
OCULUS_RAW: Final = "oculus-raw"

_PROBE: Final = 1 << 16
_LEAST_MAGIC: Final = 6

_FOREIGN: Final = {
    b"SQLite format 3\0": "a ViewPoint log (SQLite)",
    b"\x44\x33\x22\x11": "an Oculus Viewer log",
    b"\xf5\x07\x00\x00": "a broken conversion of an Oculus Viewer log",
    b"\xd4\xc3\xb2\xa1": "a pcap network capture",
    b"\x4d\x3c\xb2\xa1": "a pcap network capture",
    b"\x0a\x0d\x0d\x0a": "a pcapng network capture",
    b"#ROSBAG": "a ROS 1 bag",
    b"\x1f\x8b": "compressed with gzip",
    b"\x28\xb5\x2f\xfd": "compressed with zstd",
    b"PK\x03\x04": "a zip archive",
}


class Recording:
    """A recording that can be read from front to back, again and again, once at a time.

    Iteration yields `Chunk`s in recorded order and never raises because of what the file holds;
    `truncated` and `damage` say what was wrong, completely so after iteration.

    Attributes:
        path: of the file.
        format: "mcap" or "oculus-raw".
        size_bytes: of the file.
        has_time: whether chunks carry arrival stamps.
    """

    def __init__(self, path: Path, kind: str, file: BinaryIO, size_bytes: int) -> None:
        self.path = path
        self.format = kind
        self.size_bytes = size_bytes
        self._file = file
        self._span_ns: tuple[int | None, int | None] = (None, None)
        self._progress = Progress()
        if kind == MCAP:
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
        """Earliest stamp, nanoseconds since 1970; of a damaged file the first one."""
        return self._span_ns[0]

    @property
    def end_ns(self) -> int | None:
        """Latest stamp; of a file that was not closed known only after iteration."""
        return self._span_ns[1] if self._span_ns[1] is not None else self._progress.last_ns

    @property
    def bytes_read(self) -> int:
        """How far iteration has come in the file."""
        return self._progress.bytes_read

    @property
    def truncated(self) -> bool:
        """Whether the file was found to end before its content does."""
        return self._progress.truncated

    @property
    def damage(self) -> str | None:
        """The first thing found wrong with the file, for a person."""
        return self._progress.damage

    @property
    def faults(self) -> int:
        """How many things were found wrong with the file."""
        return self._progress.faults

    @property
    def metadata(self) -> dict[str, str]:
        """What the recorder noted about the recording, such as format_version."""
        return dict(self._progress.metadata)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _chunks(self, progress: Progress) -> Iterator[Chunk]:
        try:
            self._file.seek(0)
            if self.format == MCAP:
                yield from read_mcap(self._file, self.size_bytes, progress)
            else:
                yield from read_raw(self._file, progress)
        except OSError as error:
            progress.cut(f"cannot be read on: {error.strerror or error}")

    def _look_ahead(self) -> None:
        """Learn the time span: from the index if there is one, else from the first chunk."""
        glimpse = Progress()
        first = next(self._chunks(glimpse), None)
        self._progress.metadata = glimpse.metadata
        start_ns = None if first is None else first.arrival_ns
        summary = read_summary(self._file, self.size_bytes)
        self._span_ns = summary.span_ns or (start_ns, None)


def open_recording(path: str | os.PathLike[str]) -> Recording:
    """Return the recording in a file.

    Raises:
        RecordingError: there is no such file, it cannot be read, or it holds no recording.
    """
    where = Path(path)
    file = _open(where)
    try:
        size = file.seek(0, 2)
        return Recording(where, _kind(where, file, size), file, size)
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
                raise RecordingError(f"{path}: is a directory; name a file in it")
            if path.exists():
                raise RecordingError(f"{path}: is no plain file; copy the bytes into one")
            raise RecordingError(f"{path}: no such file; check the name")
        return path.open("rb")
    except PermissionError as error:
        raise RecordingError(f"{path}: may not be read; check its access rights") from error
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be opened: {error}") from error


def _kind(path: Path, file: BinaryIO, size: int) -> str:
    """Return the format, told by content."""
    if size == 0:
        raise RecordingError(f"{path}: is empty; nothing was recorded")
    file.seek(0)
    probe = file.read(_PROBE)
    head = probe[: len(MAGIC)]
    alike = sum(a == b for a, b in zip(head, MAGIC, strict=False))
    if alike >= min(_LEAST_MAGIC, size):
        return MCAP
    if is_raw_stream(file):
        return OCULUS_RAW
    raise RecordingError(f"{path}: {_description(probe)}; expected MCAP or a raw Oculus stream")


def _description(probe: bytes) -> str:
    for magic, name in _FOREIGN.items():
        if probe.startswith(magic):
            return f"is {name}, which cannot be read"
    if not any(probe):
        return "holds only zeros"
    printable = sum(byte >= 0x20 or byte in b"\t\n\r\f" for byte in probe)  # noqa: PLR2004 - space
    if printable == len(probe):
        return "is a text file"
    return "holds no sonar messages"
