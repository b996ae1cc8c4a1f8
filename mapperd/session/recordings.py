"""Recordings on the disk: which there are, which belong together, and their tails."""

import contextlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

from mapperd.odometry.odometry_files import OdometryFiles
from mapperd.odometry.ros_bag import is_ros_bag
from mapperd.pipeline.recorder import PREFIX
from mapperd.session.ros_recording import open_source
from mapperd.session_log import DECISIONS, SESSION, Session, decision_of
from mapperd.store.position import RecordingOffset
from oculus_driver.errors import RecordingError
from oculus_driver.recording import Chunk, DamagedPart, Recording, open_recording

__all__ = [
    "DamagedData",
    "RecordedSession",
    "Tail",
    "files_in",
    "files_of",
    "number_of",
    "recorded_in",
    "sessions_of",
]

SUFFIX = ".mcap"
SIGNATURE_BYTES = 8
"""An MCAP file begins with them."""

BLANK_BYTES = 1 << 20
"""A file with as many zeros at its beginning is blank."""


@dataclass(slots=True)
class DamagedData:
    """What damage of recordings costs. Reading a file again counts once.

    Attributes:
        allowed: whether data that fail their checksum are mapped all the same.
        bytes: number of bytes that fail it, by file.
        parts: the first 1000 parts that fail it, by file.
        decisions: number of decisions of the daemon among them, by file.
        losses: the first other damage that may have cost data, by file; no missing end of a
            session's last file.
    """

    allowed: bool = False
    bytes: dict[Path, int] = field(default_factory=dict)
    parts: dict[Path, tuple[DamagedPart, ...]] = field(default_factory=dict)
    losses: dict[Path, str] = field(default_factory=dict)
    decisions: dict[Path, int] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return what is damaged, with the first places; empty without damage."""
        found = [f"{path.name}: {damage}" for path, damage in self.losses.items()]
        if len(found) > 1:
            found[1:] = [f"damage of {len(found) - 1} more files"]
        if self.bytes:
            path, parts = next(iter(self.parts.items()))
            count = sum(map(len, self.parts.values()))
            mapped = "mapped all the same" if self.allowed else "not mapped"
            found.append(
                f"{sum(self.bytes.values())} bytes in {count} parts fail their checksum and were "
                f"{mapped}; the first part is at byte {parts[0].offset} of {path.name}"
            )
            if (decisions := sum(self.decisions.values())) and not self.allowed:
                found.append(
                    f"{decisions} recorded decisions are among them: settings, resets, dropped or "
                    "skipped data"
                )
        return "; ".join(found)

    @property
    def data_lost(self) -> bool:
        """Whether data are missing in a map of the recordings."""
        return bool(self.losses) or (bool(self.bytes) and not self.allowed)

    def of(self, paths: Iterable[Path]) -> "DamagedData":
        """Return the damage of some of the files."""
        mine = set(paths)
        return DamagedData(
            self.allowed,
            {path: size for path, size in self.bytes.items() if path in mine},
            {path: parts for path, parts in self.parts.items() if path in mine},
            {path: loss for path, loss in self.losses.items() if path in mine},
            {path: count for path, count in self.decisions.items() if path in mine},
        )

    def read(self, recording: Recording, *, is_last: bool = True) -> Iterator[Chunk]:
        """Yield the chunks of a file; damaged ones count as good if they are allowed.

        Args:
            recording: the file.
            is_last: nothing follows it in its session; such a file may end anywhere.
        """
        decisions = 0
        try:
            for chunk in recording:
                decisions += chunk.damaged and chunk.encoding == DECISIONS
                yield replace(chunk, damaged=False) if self.allowed and chunk.damaged else chunk
        finally:
            self._add(recording)
            if decisions > self.decisions.get(recording.path, 0):
                self.decisions[recording.path] = decisions
            if not is_last and recording.truncated and SESSION in recording.metadata:
                self.add_loss(recording.path, recording.damage or "it has no end")

    def add_loss(self, path: Path, loss: str) -> None:
        """Add what is missing in a file or before it, unless something is known of it."""
        self.losses.setdefault(path, loss)

    def add_holes(self, files: dict[int, Path], first: int | None = None) -> None:
        """Add the files that are missing between those of a session.

        Args:
            files: by number, in order.
            first: number of the first file; None if `files` begin with it.
        """
        before = None if first is None else first - 1
        for number, path in files.items():
            if before is not None and number != before + 1:
                self.add_loss(path, missing_before(number, before))
            before = number

    def _add(self, recording: Recording) -> None:
        """Add what reading a file has found so far."""
        path = recording.path
        if recording.damaged_bytes > self.bytes.get(path, 0):
            self.bytes[path], self.parts[path] = recording.damaged_bytes, recording.damaged_parts
        if recording.data_lost:
            self.losses.setdefault(path, recording.damage or "")


def missing_before(number: int, before: int) -> str:
    """Describe missing files between two numbers."""
    which = f"file {before + 1}" if number == before + 2 else f"files {before + 1} to {number - 1}"
    return f"{which} before it cannot be found or read"


@dataclass(slots=True)
class _ReadingState:
    """What reading has shown so far."""

    bytes_read: int = 0
    truncated: bool = False
    damage: str | None = None
    read_error: OSError | None = None
    faults: int = 0
    chunks: int = 0


class RecordedSession:
    """Files in order, read as one recording; only one is open at a time.

    Args:
        paths: of the files.
        session: as the attribute.
        damaged: as the attribute; by default such data are not used.
        odometry: as the attribute.

    Attributes:
        paths: of the files.
        session: id of the daemon's session; None where they are no recordings of a session.
        format: of the first file.
        size_bytes: of all files.
        damaged: what damage costs.
        odometry: of other files, read in place of the recorded odometry; None reads that.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        session: str | None,
        damaged: DamagedData | None = None,
        odometry: OdometryFiles | None = None,
    ) -> None:
        self.paths = tuple(paths)
        self.session = session
        self.damaged = damaged or DamagedData()
        self.odometry = odometry
        self._seen = _ReadingState()
        self.size_bytes = 0
        if session is not None:
            self.damaged.add_holes(
                {number: path for path in self.paths if (number := number_of(path)) is not None}
            )
        self.format = ""
        for path in self.paths:
            with open_source(path) as recording:
                self.size_bytes += recording.size_bytes
                self.format = self.format or recording.format

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

    def is_complete(self, last: int, end: RecordingOffset | None) -> bool:
        """Return whether all files were read without a problem up to an end.

        Args:
            last: number of the last file.
            end: of the session; if it is unknown, no file may be truncated.
        """
        seen = self._seen
        if seen.faults or seen.read_error is not None or self.damaged.of(self.paths).losses:
            return False
        return not seen.truncated if end is None else RecordingOffset(last, seen.chunks) >= end

    def __iter__(self) -> Iterator[Chunk]:
        """Read from the front; raises `RecordingError` where a file cannot be opened any more."""
        self._seen = seen = _ReadingState()
        merge = None if self.odometry is None else self.odometry.merge()
        for path in self.paths:
            before, is_last = seen.bytes_read, path is self.paths[-1]
            seen.chunks = 0
            with open_source(path) as recording:
                chunks = self.damaged.read(recording, is_last=is_last)
                for chunk in chunks if merge is None else merge.into(chunks, is_last=is_last):
                    seen.chunks += 1
                    seen.bytes_read = before + recording.bytes_read
                    yield chunk
                seen.bytes_read = before + recording.bytes_read
                may_end = is_last or self.session is None
                seen.faults += recording.faults - (recording.truncated and may_end)
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

    A folder with a ROS bag is one recording.

    Args:
        paths: of files and folders.
        begun: pass those in folders over with nothing in them, as a kill leaves them.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir() and not is_ros_bag(path):
            inside = sorted(path.glob(f"*{SUFFIX}"), key=_numbered)
            found += [one for one in inside if not begun or _begins(one)]
        else:
            found.append(path)
    return found


def sessions_of(
    paths: Iterable[Path],
    damaged: DamagedData | None = None,
    odometry: OdometryFiles | None = None,
) -> list[RecordedSession]:
    """Put files together that follow each other in one session.

    Args:
        paths: of the files, in order.
        damaged: of all sessions; by default each has its own, and such data are not used.
        odometry: of other files, for all sessions; None reads the recorded odometry.

    Raises:
        RecordingError: one cannot be read, or is not a recording.
    """
    return [
        RecordedSession(list(group), session, damaged, odometry)
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
    with open_source(path) as recording:
        return recording.metadata.get(SESSION)


def _numbered(path: Path) -> list[tuple[int, str]]:
    """Numbers in names count as such: 999999 comes before 1000000."""
    return [
        (int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", path.name)
    ]


NUMBER = re.compile(r"_(\d{6,})_\d{8}T\d{6}Z\.mcap$")


def number_of(path: Path) -> int | None:
    """Return the number in the name of a file of a recorder; None for other names."""
    number = NUMBER.search(path.name)
    return None if number is None else int(number[1])


def recorded_in(folder: Path) -> tuple[dict[str, dict[int, Path]], dict[Path, str]]:
    """Return the sessions in the recordings' folder, in order of their first files.

    The first chunk of a session names it, too, and has a checksum.

    Args:
        folder: of the recordings; need not be there.

    Returns:
        the files of each session by their numbers, in order, and the files whose session is
        unknown, with the reason.
    """
    sessions: dict[str, dict[int, Path]] = {}
    unknown: dict[Path, str] = {}
    other_names: dict[Path, str] = {}
    for path in files_in([folder]) if folder.is_dir() else []:
        number = number_of(path)
        try:
            with open_recording(path) as recording:
                first = next(iter(recording), None)
                session = recording.metadata.get(SESSION)
        except RecordingError as error:
            if number is not None and not _is_blank(path):
                unknown[path] = str(error).removeprefix(f"{path}: ")
            continue
        begun = None if first is None or first.damaged else decision_of(first)
        session = begun.id if isinstance(begun, Session) else session
        if session is None:
            if path.name.startswith(f"{PREFIX}_") and number is not None and first is not None:
                unknown[path] = "its session is not readable"
        elif number is None:
            other_names[path] = session
        else:
            sessions.setdefault(session, {})[number] = path
    for path, session in other_names.items():
        if session not in sessions:
            unknown[path] = f"session {session}: its name has no number"
    return sessions, unknown


def _is_blank(path: Path) -> bool:
    """Return whether a file holds nothing, as a power cut leaves it."""
    try:
        with path.open("rb") as file:
            return not any(file.read(BLANK_BYTES))
    except OSError:
        return False


def files_of(folder: Path, session: str) -> dict[int, Path]:
    """Return a session's recordings, ordered by the numbers in their names.

    Args:
        folder: of the recordings; need not be there.
        session: id.
    """
    return recorded_in(folder)[0].get(session, {})


class Tail:
    """The chunks of a session from a place on, and where the reader is; knows pieces by places.

    Args:
        files: of `files_of`.
        start: where to begin.
        damaged: data that fail their checksum; by default they are not used.
        odometry: as of `RecordedSession`; its chunks count in the places.

    Attributes:
        place: behind the chunk that was read last.
    """

    def __init__(
        self,
        files: dict[int, Path],
        start: RecordingOffset,
        damaged: DamagedData | None = None,
        odometry: OdometryFiles | None = None,
    ) -> None:
        self._files = {
            number: path
            for number, path in files.items()
            if number >= start.file or odometry is not None  # which is merged from the front
        }
        self._start = start
        self._odometry = odometry
        self._damaged = damaged or DamagedData()
        self._damaged.add_holes(self._files, None if odometry is not None else start.file or None)
        self.place = start
        self._unflushed = list(self._files.values())

    def __iter__(self) -> Iterator[Chunk]:
        last = max(self._files, default=0)
        merge = None if self._odometry is None else self._odometry.merge()
        for number, path in self._files.items():
            count, is_last = 0, number == last
            with open_source(path) as recording:
                chunks = self._damaged.read(recording, is_last=is_last)
                if merge is not None:
                    chunks = merge.into(chunks, is_last=is_last)
                for count, chunk in enumerate(chunks, 1):
                    if RecordingOffset(number, count) > self._start:
                        self.place = RecordingOffset(number, count)
                        yield chunk
            if number == self._start.file and RecordingOffset(number, count) < self._start:
                self._damaged.add_loss(path, "it ends before the position of the map")

    @property
    def loss(self) -> str:
        """Describe what data are missing in what was read; empty if none are."""
        if not self._damaged.data_lost:
            return ""
        damaged = self._damaged.of(self._files.values())
        return str(damaged) if damaged.data_lost else ""

    @property
    def end(self) -> RecordingOffset:
        """The place: all that is read is written."""
        return self.place

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
