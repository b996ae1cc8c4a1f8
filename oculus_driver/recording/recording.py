"""Open a recording of any known kind; its content says which, never its name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Self

from oculus_driver.errors import RecordingError
from oculus_driver.recording.chunk import Chunk, Progress
from oculus_driver.recording.formats import MCAP, OCULUS_RAW, READERS, kind_of
from oculus_driver.recording.summary import read_summary

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator
    from types import TracebackType


class Recording:
    """A recording that can be read from front to back, again and again, once at a time.

    Iteration yields `Chunk`s in recorded order and never raises because of what the file holds;
    `truncated` and `damage` say what was wrong, completely so after iteration.

    Attributes:
        path: of the file.
        format: see `oculus_driver.recording.formats`.
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
    def read_error(self) -> OSError | None:
        """What the disk said, where it did not let the file be read to its end."""
        return self._progress.read_error

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
            yield from READERS[self.format](self._file, self.size_bytes, progress)
        except OSError as error:
            progress.read_error = error
            progress.cut(f"cannot be read on: {error.strerror or error}")

    def _look_ahead(self) -> None:
        """Learn the time span: from the index if there is one, else from the first chunk."""
        glimpse = Progress()
        first = next(self._chunks(glimpse), None)
        self._progress.metadata = glimpse.metadata
        start_ns = None if first is None else first.arrival_ns
        indexed = read_summary(self._file, self.size_bytes).span_ns if self.format == MCAP else None
        self._span_ns = indexed or (start_ns, None)


def open_recording(path: str | os.PathLike[str]) -> Recording:
    """Return the recording in a file.

    Raises:
        RecordingError: there is no such file, it cannot be read, or it holds no recording.
    """
    where = Path(path)
    file = _open(where)
    try:
        size = file.seek(0, 2)
        return Recording(where, kind_of(where, file, size), file, size)
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
