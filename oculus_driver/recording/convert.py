"""Write a recording in another format, and say what that format could not hold."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, Protocol

from oculus_driver.errors import RecordingError
from oculus_driver.recording.formats import MCAP, OCULUS_LOG, OCULUS_RAW, PCAP
from oculus_driver.recording.message_sinks import LogFormat, MessageSink, RawFormat
from oculus_driver.recording.pcap_sink import PcapSink
from oculus_driver.recording.recording import open_recording
from oculus_driver.recording.writer import RecordingWriter

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from oculus_driver.recording.chunk import Chunk
    from oculus_driver.recording.recording import Recording

WRITABLE: Final = (MCAP, OCULUS_LOG, OCULUS_RAW, PCAP)
"""Formats that `convert` can write."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """What a conversion did.

    Attributes:
        source_format, target_format: see `oculus_driver.recording.formats`.
        chunks: read from the source.
        size_bytes: of the file written.
        left_out: bytes that the target does not hold, by reason: other_link (a link that the
            format has no place for), no_message (bytes between messages).
        stamps_lost: chunks that had a stamp, where the target has no place for stamps.
        damage: the first thing that is wrong with the source, or None.
    """

    source_format: str
    target_format: str
    chunks: int
    size_bytes: int
    left_out: dict[str, int] = field(default_factory=dict)
    stamps_lost: int = 0
    damage: str | None = None


class _Sink(Protocol):
    def put(self, chunk: Chunk) -> None: ...

    def finish(self) -> None: ...


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    target_format: str = MCAP,
    *,
    overwrite: bool = False,
) -> Conversion:
    """Write the recording in `source` to `target`; the target appears when it is complete.

    MCAP holds everything. The others hold what sonars sent: pcap any number of sonars and their
    statuses; `.oculus` logs and raw streams the whole messages of the first sonar, raw streams
    without stamps.

    Raises:
        RecordingError: the source cannot be read, the target not written, exists and `overwrite`
            is not given, is the source, or the format is not one of `WRITABLE`.
    """
    if target_format not in WRITABLE:
        raise RecordingError(f"cannot write {target_format!r}; choose {', '.join(WRITABLE)}")
    path = Path(target)
    with open_recording(source) as recording:
        _check(recording.path, path, overwrite=overwrite)
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        left_out: Counter[str] = Counter()
        try:
            with _writing(part):
                chunks, stamped = _copy(recording, part, target_format, left_out)
                size = part.stat().st_size
                part.replace(path)
        finally:
            part.unlink(missing_ok=True)
        return Conversion(
            recording.format,
            target_format,
            chunks,
            size,
            dict(left_out),
            stamped if target_format == OCULUS_RAW else 0,
            recording.damage,
        )


def _check(source: Path, target: Path, *, overwrite: bool) -> None:
    if target.exists() and source.samefile(target):
        raise RecordingError(f"{target}: is the recording itself; choose another name")
    if target.is_dir():
        raise RecordingError(f"{target}: is a directory; name a file in it")
    if target.exists() and not overwrite:
        raise RecordingError(f"{target}: exists already; choose another name")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise RecordingError(f"{path}: cannot be written: {reason}; check the disk") from error


def _copy(
    recording: Recording, path: Path, target_format: str, left_out: Counter[str]
) -> tuple[int, int]:
    """Write all chunks; return how many there were, and how many of them had stamps."""
    if target_format == MCAP:
        metadata = recording.metadata | {"converted_from": recording.format}
        with RecordingWriter(path, metadata=metadata, overwrite=True) as writer:
            return _drain(recording, _McapSink(writer))
    with path.open("wb") as file:
        return _drain(recording, _SINKS[target_format](file, left_out))


def _drain(recording: Recording, sink: _Sink) -> tuple[int, int]:
    chunks = stamped = 0
    for chunk in recording:
        sink.put(chunk)
        chunks += 1
        stamped += chunk.arrival_ns is not None
    sink.finish()
    return chunks, stamped


class _McapSink:
    """Keeps links, stamps and gaps as they are."""

    def __init__(self, writer: RecordingWriter) -> None:
        self._writer = writer
        self._links: dict[tuple[str, str], int] = {}

    def put(self, chunk: Chunk) -> None:
        key = chunk.link, chunk.encoding
        if key not in self._links:
            self._links[key] = self._writer.add_link(*key)
        gap = chunk.gap_before
        self._writer.write(self._links[key], chunk.data, chunk.arrival_ns, gap_before=gap)

    def finish(self) -> None:
        """Nothing is held back."""


_SINKS: Final[dict[str, Callable[[BinaryIO, Counter[str]], _Sink]]] = {
    OCULUS_LOG: lambda file, left_out: MessageSink(file, left_out, LogFormat()),
    OCULUS_RAW: lambda file, left_out: MessageSink(file, left_out, RawFormat()),
    PCAP: PcapSink,
}
