"""The survey's folder: on this machine's disk, or wherever fsspec reaches.

Files come into it whole or not at all: they are written elsewhere, then put.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, cast

import fsspec

from mapper_survey.errors import SurveyError
from mapper_survey.scratch import scratch

__all__ = ["Folder"]

WORK = ".work"


class Folder:
    """Files by their names, `plan/dive-01.spool`.

    Args:
        url: a path, or what fsspec takes: `s3://bucket/survey`.

    Raises:
        SurveyError: fsspec does not know it.

    Attributes:
        url: as given.
        local: the folder on the disk; None elsewhere.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        try:
            self._fs, self._root = fsspec.core.url_to_fs(url)
        except (ImportError, ValueError) as error:
            raise SurveyError(f"{url}: cannot be reached: {error}") from error
        protocols = self._fs.protocol
        here = protocols if isinstance(protocols, tuple) else (protocols,)
        self.local = Path(self._root) if "file" in here else None

    def open(self, name: str) -> BinaryIO:
        """Read a part of a file."""
        return cast("BinaryIO", self._fs.open(self._at(name), "rb"))

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        return bool(self._fs.exists(self._at(name)))

    def read(self, name: str) -> bytes | None:
        """All of a file; None where there is none."""
        try:
            return bytes(self._fs.cat_file(self._at(name)))
        except FileNotFoundError:
            return None

    def write(self, name: str, data: bytes) -> None:
        """Put a small file."""
        with self.workspace() as work:
            path = work / "file"
            path.write_bytes(data)
            self.put(path, name)

    def put(self, path: Path, name: str) -> None:
        """Give a finished file its place; a power cut does not take it away.

        It is moved: a copy where it lies on another disk.
        """
        at = self._at(name)
        if self.local is None:
            self._fs.put_file(str(path), at)
            return
        Path(at).parent.mkdir(parents=True, exist_ok=True)
        with self.workspace() as work:
            near = work / "file"
            shutil.move(path, near, copy_function=shutil.copyfile)
            _sync(near)
            near.replace(at)
        _sync(Path(at).parent)

    @contextlib.contextmanager
    def fetched(self, name: str) -> Iterator[Path]:
        """A file as one on the disk, to be read only."""
        if self.local is not None:
            yield Path(self._at(name))
            return
        with scratch() as temporary:
            path = temporary / "file"
            self._fs.get_file(self._at(name), str(path))
            yield path

    @contextlib.contextmanager
    def workspace(self) -> Iterator[Path]:
        """A folder of its own, near where files of it are put; not for SQLite."""
        if self.local is None:
            with scratch() as temporary:
                yield temporary
            return
        base = self.local / WORK
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=base) as temporary:
            yield Path(temporary)

    def forget_workspaces(self) -> None:
        """Remove what somebody who was killed has left; nobody else is at work."""
        if self.local is not None:
            shutil.rmtree(self.local / WORK, ignore_errors=True)

    def names(self, prefix: str) -> set[str]:
        """Of the files directly in a part of the folder, with that part's name."""
        return set(self.sizes(prefix))

    def sizes(self, prefix: str) -> dict[str, int]:
        """Bytes of the files directly in a part of the folder, by name."""
        try:
            found = self._fs.ls(self._at(prefix), detail=True)
        except FileNotFoundError:
            return {}
        return {
            f"{prefix}/{each['name'].rstrip('/').rpartition('/')[2]}": int(each["size"] or 0)
            for each in found
        }

    def remove(self, name: str) -> None:
        """Remove a file if it is there."""
        with contextlib.suppress(FileNotFoundError):
            self._fs.rm_file(self._at(name))

    def size_of(self, name: str) -> int:
        """Bytes of a file."""
        return int(self._fs.size(self._at(name)))

    def _at(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}"


def _sync(path: Path) -> None:
    """Have the disk itself hold a file, or the names in a folder."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
