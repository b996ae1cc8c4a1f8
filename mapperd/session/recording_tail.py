"""A session's recordings from a place on."""

import re
from collections.abc import Iterator
from pathlib import Path

from mapperd.session.recordings import files_in
from mapperd.session_log import SESSION
from mapperd.store.position import Place
from oculus_driver.errors import RecordingError
from oculus_driver.recording import Chunk, open_recording

__all__ = ["Tail", "files_of"]

NUMBER = re.compile(r"_(\d{6,})_\d{8}T\d{6}Z\.mcap$")


def files_of(folder: Path, session: str) -> dict[int, Path]:
    """A session's recordings by the numbers in their names, in order; what is no recording is not.

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

    Attributes:
        place: behind the chunk that was read last.
    """

    def __init__(self, files: dict[int, Path], start: Place) -> None:
        self._files = {number: path for number, path in files.items() if number >= start.file}
        self._start = start
        self.place = start

    def __iter__(self) -> Iterator[Chunk]:
        for number, path in self._files.items():
            with open_recording(path) as recording:
                for count, chunk in enumerate(recording, 1):
                    if Place(number, count) > self._start:
                        self.place = Place(number, count)
                        yield chunk

    @property
    def newest(self) -> int:
        """All that is read is written."""
        return 0

    @property
    def number(self) -> int:
        """The place as one number."""
        return self.place.file << 40 | self.place.chunks

    def place_of(self, number: int) -> Place:
        """The place that a number means."""
        return Place(number >> 40, number & ((1 << 40) - 1))

    def wait_for(self, number: int, timeout_s: float) -> bool:  # noqa: ARG002
        """Nothing is to be waited for."""
        return True
