"""Recordings on the disk: which there are, which belong together, and their tails."""

import contextlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

from mapperd.session_log import DECISIONS, SESSION, Session, decision_of
from mapperd.store.position import RecordingOffset
from oculus_driver.errors import RecordingError
from oculus_driver.recording import Chunk, DamagedPart, Recording, open_recording

__all__ = ["DamagedData", "RecordedSession", "Tail", "files_in", "files_of", "sessions_of"]

SUFFIX = ".mcap"
SIGNATURE_BYTES = 8
"""An MCAP file begins with them."""


@dataclass(slots=True)
class DamagedData:
    """What damage of recordings costs. Reading a file again counts once.

    Attributes:
        allowed: whether data that fail their checksum are mapped all the same.
        bytes: number of bytes that fail it, by file.
        parts: the first 1000 parts that fail it, by file.
        losses: the first other damage that may have cost data, by file; no missing end.
    """

    allowed: bool = False
    bytes: dict[Path, int] = field(default_factory=dict)
    parts: dict[Path, tuple[DamagedPart, ...]] = field(default_factory=dict)
    losses: dict[Path, str] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return what is damaged, with the first places; empty without damage."""
        found = [f"{path.name}: {damage}" for path, damage in self.losses.items()][:1]
        if self.bytes:
            path, parts = next(iter(self.parts.items()))
            count = sum(map(len, self.parts.values()))
            mapped = "mapped all the same" if self.allowed else "not mapped"
            found.append(
                f"{sum(self.bytes.values())} bytes in {count} parts fail their checksum and were "
                f"{mapped}; the first part is at byte {parts[0].offset} of {path.name}"
            )
        return "; ".join(found)

    @property
    def data_lost(self) -> bool:
        """Whether data are missing in a map of the recordings."""
        return bool(self.losses) or (bool(self.bytes) and not self.allowed)

    def read(self, recording: Recording) -> Iterator[Chunk]:
        """Yield the chunks of a file; damaged ones count as good if they are allowed."""
        try:
            for chunk in recording:
                yield replace(chunk, damaged=False) if self.allowed and chunk.damaged else chunk
        finally:
            self._add(recording)

    def _add(self, recording: Recording) -> None:
        """Add what reading a file has found so far."""
        path = recording.path
        if recording.damaged_bytes > self.bytes.get(path, 0):
            self.bytes[path], self.parts[path] = recording.damaged_bytes, recording.damaged_parts
        if recording.data_lost:
            self.losses.setdefault(path, recording.damage or "")


@dataclass(slots=True)
class _Seen:
    """What reading has shown so far."""

    bytes_read: int = 0
    truncated: bool = False
    damage: str | None = None
    read_error: OSError | None = None


class RecordedSession:
    """Files in order, read as one recording; only one is open at a time.

    Args:
        paths: of the files.
        session: as the attribute.
        damaged: as the attribute; by default such data are not used.

    Attributes:
        paths: of the files.
        session: id of the daemon's session; None where they are no recordings of a session.
        format: of the first file.
        size_bytes: of all files.
        damaged: what damage costs.
    """

    def __init__(
        self, paths: Sequence[Path], session: str | None, damaged: DamagedData | None = None
    ) -> None:
        self.paths = tuple(paths)
        self.session = session
        self.damaged = damaged or DamagedData()
        self._seen = _Seen()
        self.size_bytes = 0
        with open_recording(self.paths[0]) as recording:
            self.format = recording.format
        for path in self.paths:
            with open_recording(path) as recording:
                self.size_bytes += recording.size_bytes

    @property
    def bytes_read(self) -> int:
        """How far iteration has come."""
        return self._seen.bytes_read

    @property
    def truncated(self) -> bool:
        """Whether a file was found to end before its content does."""
        return self._seen.truncated

    @property
    def damage(self) -> str | None:
        """The first thing found wrong, for a person."""
        return self._seen.damage

    @property
    def read_error(self) -> OSError | None:
        """Error of the disk that prevented reading a file; a later attempt may succeed."""
        return self._seen.read_error

    def __iter__(self) -> Iterator[Chunk]:
        """Read from the front; raises `RecordingError` where a file cannot be opened any more."""
        self._seen = seen = _Seen()
        for path in self.paths:
            before = seen.bytes_read
            with open_recording(path) as recording:
                for chunk in self.damaged.read(recording):
                    seen.bytes_read = before + recording.bytes_read
                    yield chunk
                seen.bytes_read = before + recording.bytes_read
                seen.truncated = seen.truncated or recording.truncated
                seen.read_error = seen.read_error or recording.read_error
                if recording.damage is not None and seen.damage is None:
                    name = f"{path.name}: " if len(self.paths) > 1 else ""
                    seen.damage = f"{name}{recording.damage}"

    def beginning(self) -> Session | None:
        """How the session began; None where that is not in the files."""
        for chunk in self:
            if chunk.encoding == DECISIONS:
                decision = decision_of(chunk)
                return decision if isinstance(decision, Session) else None
        return None


def files_in(paths: Iterable[Path], *, begun: bool = False) -> list[Path]:
    """Replace folders by the recordings in them, in the order in which they were written.

    Args:
        paths: of files and folders.
        begun: pass those in folders over with nothing in them, as a kill leaves them.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob(f"*{SUFFIX}"), key=_numbered)
            found += [one for one in inside if not begun or _begins(one)]
        else:
            found.append(path)
    return found


def sessions_of(paths: Iterable[Path], damaged: DamagedData | None = None) -> list[RecordedSession]:
    """Put files together that follow each other in one session.

    Args:
        paths: of the files, in order.
        damaged: of all sessions; by default each has its own, and such data are not used.

    Raises:
        RecordingError: one cannot be read, or is not a recording.
    """
    return [
        RecordedSession(list(group), session, damaged)
        for session, group in groupby(paths, key=_session_of)
    ]


def _begins(path: Path) -> bool:
    """Whether the first chunk can be read, or the reason why not is worth reporting."""
    try:
        with open_recording(path) as recording:
            return next(iter(recording), None) is not None or not recording.truncated
    except RecordingError:
        return path.stat().st_size >= SIGNATURE_BYTES


def _session_of(path: Path) -> str | None:
    with open_recording(path) as recording:
        return recording.metadata.get(SESSION)


def _numbered(path: Path) -> list[tuple[int, str]]:
    """Numbers in names count as such: 999999 comes before 1000000."""
    return [
        (int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", path.name)
    ]


NUMBER = re.compile(r"_(\d{6,})_\d{8}T\d{6}Z\.mcap$")


def files_of(folder: Path, session: str) -> dict[int, Path]:
    """Return a session's recordings, ordered by the numbers in their names.

    Args:
        folder: of the recordings; need not be there.
        session: id.
    """
    found = {}
    for path in files_in([folder]) if folder.is_dir() else []:
        number = NUMBER.search(path.name)
        if number is None:
            continue
        try:
            with open_recording(path) as recording:
                mine = recording.metadata.get(SESSION) == session
        except RecordingError:
            continue
        if mine:
            found[int(number[1])] = path
    return found


class Tail:
    """The chunks of a session from a place on, and where the reader is; knows pieces by places.

    Args:
        files: of `files_of`.
        start: where to begin.
        damaged: data that fail their checksum; by default they are not used.

    Attributes:
        place: behind the chunk that was read last.
    """

    def __init__(
        self,
        files: dict[int, Path],
        start: RecordingOffset,
        damaged: DamagedData | None = None,
    ) -> None:
        self._files = {number: path for number, path in files.items() if number >= start.file}
        self._start = start
        self._damaged = damaged or DamagedData()
        self.place = start
        self._unflushed = list(self._files.values())

    def __iter__(self) -> Iterator[Chunk]:
        for number, path in self._files.items():
            with open_recording(path) as recording:
                for count, chunk in enumerate(self._damaged.read(recording), 1):
                    if RecordingOffset(number, count) > self._start:
                        self.place = RecordingOffset(number, count)
                        yield chunk

    @property
    def missing(self) -> str:
        """Return the empty string: all that is read is recorded."""
        return ""

    @property
    def newest(self) -> int:
        """All that is read is written."""
        return 0

    @property
    def number(self) -> int:
        """The place as one number."""
        return self.place.file << 40 | self.place.chunks

    def place_of(self, number: int) -> RecordingOffset:
        """The place that a number means."""
        return RecordingOffset(number >> 40, number & ((1 << 40) - 1))

    def wait_for(self, number: int, timeout_s: float) -> bool:  # noqa: ARG002
        """Flush the files to the disk: a killed daemon may have left data that are not there."""
        while self._unflushed:
            with contextlib.suppress(OSError):  # such as a file system that cannot flush
                handle = os.open(self._unflushed[-1], os.O_RDONLY | os.O_CLOEXEC)
                try:
                    os.fdatasync(handle)
                finally:
                    os.close(handle)
            self._unflushed.pop()
        return True
