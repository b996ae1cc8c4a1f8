"""The survey's folder: on this machine's disk, or on storage that fsspec supports.

Files appear atomically: they are written elsewhere, then moved.
"""

import contextlib
import hashlib
import os
import shutil
import socket
import tempfile
import time
import uuid
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, TypeVar, cast

import msgspec

from mapper_survey.errors import SurveyError
from mapperd.io import lock_file

__all__ = ["LOCK", "Folder", "crc_of", "held", "mark", "marked", "scratch", "this_system"]


def this_system() -> str:
    """Return the name of this machine since its last boot, and within a container."""
    started = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    return f"{started} {Path('/proc/self/ns/pid').readlink()}"


PREFIX = ".mapper-survey-scratch."
"""Prefix of scratch folders, followed by this machine since its last boot: other machines may share
the parent folder and do not see the locks."""

YOUNG_S = 60.0
"""Age below which a folder may exist but not be locked yet."""


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """Provide a scratch folder in `TMPDIR`; remove those of killed processes."""
    base = Path(tempfile.gettempdir())
    machine = hashlib.blake2b(this_system().encode(), digest_size=8).hexdigest()
    prefix = f"{PREFIX}{machine}."
    _sweep(base, prefix)
    with tempfile.TemporaryDirectory(prefix=prefix, dir=base) as temporary:
        handle = lock_file(Path(temporary), os.O_RDONLY, wait=True)
        try:
            yield Path(temporary)
        finally:
            os.close(handle)


def _sweep(base: Path, prefix: str) -> None:
    """Remove folders whose owner has ended: locks end with their process."""
    for path in base.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # of another user, or removed meanwhile
            if path.stat().st_mtime > time.time() - YOUNG_S:
                continue
            handle = lock_file(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                shutil.rmtree(path)
            finally:
                os.close(handle)


WORK = ".work"


class Folder:
    """Files by name, such as `plan/dive-01.spool`.

    Args:
        url: a path, or a URL of fsspec such as `s3://bucket/survey`.

    Raises:
        SurveyError: fsspec does not support it.

    Attributes:
        url: as given.
        local: the folder on the disk; None for other storage.
    """

    def __init__(self, url: str) -> None:
        import fsspec  # noqa: PLC0415 of an extra, which --help does not need

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
        """Return whether a file exists."""
        return bool(self._fs.exists(self._at(name)))

    def read(self, name: str) -> bytes | None:
        """Read a file; None if it does not exist."""
        try:
            return bytes(self._fs.cat_file(self._at(name)))
        except FileNotFoundError:
            return None

    def write(self, name: str, data: bytes) -> None:
        """Write a small file."""
        with self.workspace() as work:
            path = work / "file"
            path.write_bytes(data)
            self.put(path, name)

    def put(self, path: Path, name: str) -> None:
        """Move a finished file into the folder, durably.

        It is copied if it is on another disk.
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
        """Provide a file on the disk, read-only."""
        if self.local is not None:
            yield Path(self._at(name))
            return
        with scratch() as temporary:
            path = temporary / "file"
            self._fs.get_file(self._at(name), str(path))
            yield path

    @contextlib.contextmanager
    def workspace(self) -> Iterator[Path]:
        """Provide a scratch folder near the destination of its files; not for SQLite."""
        if self.local is None:
            with scratch() as temporary:
                yield temporary
            return
        base = self.local / WORK
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=base) as temporary:
            yield Path(temporary)

    def forget_workspaces(self) -> None:
        """Remove files of killed processes; no other process may be active."""
        if self.local is not None:
            shutil.rmtree(self.local / WORK, ignore_errors=True)

    def names(self, prefix: str) -> set[str]:
        """Return the names of files directly in a part of the folder, with the part's name."""
        return set(self.sizes(prefix))

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the sizes of files directly in a part of the folder, by name."""
        try:
            found = self._fs.ls(self._at(prefix), detail=True)
        except FileNotFoundError:
            return {}
        return {
            f"{prefix}/{each['name'].rstrip('/').rpartition('/')[2]}": int(each["size"] or 0)
            for each in found
        }

    def remove(self, name: str) -> None:
        """Remove a file if it exists."""
        with contextlib.suppress(FileNotFoundError):
            self._fs.rm_file(self._at(name))

    def size_of(self, name: str) -> int:
        """Return the size of a file."""
        return int(self._fs.size(self._at(name)))

    def _at(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}"


def _sync(path: Path) -> None:
    """Sync a file, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


PIECE = 1 << 20
"""Bytes of a file read at once."""

T = TypeVar("T", bound=msgspec.Struct)


def mark(folder: Folder, name: str, record: msgspec.Struct) -> None:
    """Write the record of a result."""
    folder.write(name, msgspec.json.format(msgspec.json.encode(record), indent=2))


def marked(folder: Folder, name: str, kind: type[T]) -> T | None:
    """Read the record of a result; None if it does not exist in this version."""
    data = folder.read(name)
    if data is None:
        return None
    try:
        return msgspec.json.decode(data, type=kind)
    except msgspec.DecodeError:
        return None


def crc_of(file: BinaryIO) -> int:
    """Return the CRC-32 of the rest of a file."""
    crc = 0
    while piece := file.read(PIECE):
        crc = zlib.crc32(piece, crc)
    return crc


LOCK = "lock.json"


class Holder(msgspec.Struct, frozen=True):
    """A process that works in a folder.

    Attributes:
        host: name of its machine, for people.
        system: the boot of the system that its process id belongs to.
        pid: its process id.
        token: unique token.
    """

    host: str
    system: str
    pid: int
    token: str


@contextlib.contextmanager
def held(folder: Folder) -> Iterator[None]:
    """Mark the folder as in use by this process.

    Two processes that start at the same time may not notice each other.

    Raises:
        SurveyError: another process uses it, or was killed and left its lock.
    """
    _refuse_another(folder)
    me = Holder(socket.gethostname(), this_system(), os.getpid(), uuid.uuid4().hex)
    folder.write(LOCK, msgspec.json.encode(me))
    if _holder(folder) != me:
        _refuse_another(folder)
    try:
        yield
    finally:
        if _holder(folder) == me:
            folder.remove(LOCK)


def _refuse_another(folder: Folder) -> None:
    holder = _holder(folder)
    if holder is None or _is_gone(holder):
        return
    raise SurveyError(
        f"{folder.url}: another mapper-survey is at work, process {holder.pid} of {holder.host}; "
        f"allowed: wait for it, or, if it was killed, remove {folder.url.rstrip('/')}/{LOCK}"
    )


def _holder(folder: Folder) -> Holder | None:
    data = folder.read(LOCK)
    if data is None:
        return None
    try:
        return msgspec.json.decode(data, type=Holder)
    except msgspec.DecodeError:
        return Holder("an unknown machine", "", 0, "")


def _is_gone(holder: Holder) -> bool:
    """Known only for processes of the same system."""
    return holder.system == this_system() and not Path(f"/proc/{holder.pid}").exists()
