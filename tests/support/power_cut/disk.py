"""A model of a disk that loses its power: what was not synced may be lost, torn or reordered.

`DiskLog` makes a process log its changes below a folder (disk_log.c). `Disk` holds the changes up
to an instant, and writes what a power cut at that instant may leave:

- A file has at least what was written before its last complete sync. Of later writes any subset
  of pages survives, so the file may have holes of zeros.
- A directory has at least the names of its last complete sync, and of later changes any first
  part. Syncing a file does not sync its name.
"""

import enum
import os
import random
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

__all__ = ["Change", "Disk", "DiskLog", "Survival", "read_changes"]

SOURCE = Path(__file__).with_name("disk_log.c")
RECORD = struct.Struct("=IIQQ")
PAGE, SECTOR = 4096, 512
PAGES = 0.9
"""Part of the writes whose pages survive as a whole or not at all."""

FOLDER_OPENED = 2

OWN_HANDLE = (1 << 32) - 1
"""Of changes that no process logged."""

SHARED_MEMORY = "-shm"
"""End of the names of files that are changed in memory, without a call."""


class What(enum.IntEnum):
    """Kinds of changes, as disk_log.c numbers them."""

    OPEN = 1
    WRITE = 2
    TRUNCATE = 3
    SYNC = 4
    SYNCED = 5
    RENAME = 6
    UNLINK = 7
    MKDIR = 8
    RMDIR = 9
    LINK = 10
    UNKNOWN = 11


class DiskLog:
    """Builds the library that logs the changes of processes.

    Args:
        root: the folder whose files are logged; it exists.
        folder: for the library and the log; outside of `root`.

    Attributes:
        path: the log.

    Raises:
        subprocess.CalledProcessError: there is no C compiler, or it fails.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        library, self.path = folder / "disk_log.so", folder / "disk.log"
        command = ["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE), "-ldl"]
        subprocess.run(command, check=True)  # noqa: S603 our own words
        self.environ = {
            "LD_PRELOAD": str(library),
            "DISK_ROOT": str(root),
            "DISK_LOG": str(self.path),
        }

    def complete(self) -> None:
        """Complete the log after a kill: the last change may lack its record, or a part of it."""
        disk, size = Disk(), 0
        for change in read_changes(self.path):
            disk.apply(change)
            size += RECORD.size + len(change.data)
        os.truncate(self.path, size)
        known, found = disk.contents(), dict(self._contents())
        with self.path.open("ab") as log:
            for change in _differences(known, found):
                log.write(RECORD.pack(*change[:3], len(change.data)) + change.data)

    def _contents(self) -> Iterator[tuple[str, bytes]]:
        root = Path(self.environ["DISK_ROOT"])
        for path in root.rglob("*"):
            if path.is_file() and not path.name.endswith(SHARED_MEMORY):
                yield str(path.relative_to(root)), path.read_bytes()


class Change(NamedTuple):
    """A record of the log."""

    what: int
    handle: int
    offset: int
    data: bytes


def _differences(known: dict[str, bytes], found: dict[str, bytes]) -> Iterator[Change]:
    """Yield changes that make files of known content those that were found."""
    for name in known.keys() - found.keys():
        new = [other for other in found if found[other] == known[name] != known.get(other)]
        end = f"\0{new[0]}" if new else "\0"
        yield Change(
            What.RENAME if new else What.UNLINK, 0, len(name.encode()), f"{name}{end}".encode()
        )
        if new:
            known[new[0]] = known[name]
    for name, content in found.items():
        old = known.get(name)
        if content == old:
            continue
        yield Change(What.OPEN, OWN_HANDLE, 0, name.encode())
        if old is not None and len(old) > len(content):
            yield Change(What.TRUNCATE, OWN_HANDLE, len(content), b"")
        for at in range(0, len(content), PAGE):
            if old is None or content[at : at + PAGE] != old[at : at + PAGE]:
                yield Change(What.WRITE, OWN_HANDLE, at, content[at : at + PAGE])


def read_changes(path: Path) -> Iterator[Change]:
    """Yield the changes of a log in order; a record that was cut by a kill ends it."""
    log = path.read_bytes()
    at = 0
    while at + RECORD.size <= len(log):
        what, handle, offset, size = RECORD.unpack_from(log, at)
        at += RECORD.size
        if at + size > len(log):
            return
        yield Change(what, handle, offset, log[at : at + size])
        at += size


@dataclass
class _File:
    """Writes (offset, data) and truncations (size, None) in order; `durable` of them are synced."""

    changes: list[tuple[int, bytes | None]] = field(default_factory=list)
    durable: int = 0


@dataclass
class _Folder:
    """Changes of names: (number of the change, what, name, other); `durable` of them are synced."""

    changes: list[tuple[int, int, str, "str | _File"]] = field(default_factory=list)
    durable: int = 0


class Disk:
    """The changes of a folder up to an instant."""

    def __init__(self) -> None:
        self._files: dict[str, _File] = {}  # by present name
        self._folders: dict[str, _Folder] = {"": _Folder()}
        self._opened: dict[int, _File | _Folder] = {}
        self._syncing: dict[int, list[int]] = {}
        self._count = 0

    def apply(self, change: Change) -> None:
        """Take the next change.

        Raises:
            ValueError: the model does not cover it.
        """
        self._count += 1
        match change.what:
            case What.OPEN:
                self._open(change)
            case What.WRITE | What.TRUNCATE:
                opened = self._opened[change.handle]
                assert isinstance(opened, _File)
                data = change.data if change.what == What.WRITE else None
                opened.changes.append((change.offset, data))
            case What.SYNC:
                made = len(self._opened[change.handle].changes)
                self._syncing[change.handle].append(made)
            case What.SYNCED:
                opened = self._opened[change.handle]
                opened.durable = max(opened.durable, self._syncing[change.handle].pop(0))
            case What.UNKNOWN:
                raise ValueError(change.data.decode())
            case _:
                self._name(change)

    def contents(self) -> dict[str, bytes]:
        """Return the content of each file, as a process sees it."""
        chance = random.Random(0)  # noqa: S311 nothing is left to it
        return {
            name: _content_left(file, chance, Survival.ALL)
            for name, file in self._files.items()
            if not name.endswith(SHARED_MEMORY)
        }

    def _open(self, change: Change) -> None:
        name = change.data.decode()
        self._syncing[change.handle] = []  # handles of an ended process are used again
        if change.offset == FOLDER_OPENED:
            self._opened[change.handle] = self._folders[name]
            return
        if name not in self._files:
            self._files[name] = _File()
            self._log(What.OPEN, name, self._files[name])
        if change.offset:
            self._files[name].changes.append((0, None))
        self._opened[change.handle] = self._files[name]

    def _name(self, change: Change) -> None:
        one = change.data[: change.offset].decode()
        other = change.data[change.offset + 1 :].decode()
        self._log(What(change.what), other or one, one)
        match change.what:
            case What.RENAME:
                _rename(self._files, one, other)
                _rename(self._folders, one, other)
            case What.LINK:
                self._files[other] = self._files[one]
            case What.MKDIR:
                self._folders[one] = _Folder()
            case What.UNLINK:
                self._files.pop(one, None)  # sockets are not logged
            case What.RMDIR:
                self._folders.pop(one)

    def _log(self, what: What, name: str, other: "str | _File") -> None:
        folder = self._folders[name.rpartition("/")[0]]
        folder.changes.append((self._count, what, name, other))

    def cut(self, chance: random.Random, target: Path, survival: "Survival | None" = None) -> None:
        """Write what a power cut may leave into an empty folder.

        Args:
            chance: decides what survives.
            target: the folder.
            survival: of what was not synced; None: by chance.
        """
        survival = survival or chance.choice(list(Survival))
        files, folders = self._names_left(chance, survival)
        for folder in sorted(folders):
            (target / folder).mkdir(exist_ok=True)
        for name, file in files.items():
            if (target / name).parent.is_dir():
                (target / name).write_bytes(_content_left(file, chance, survival))

    def _names_left(
        self, chance: random.Random, survival: "Survival"
    ) -> tuple[dict[str, _File], set[str]]:
        changes = []
        for folder in self._folders.values():
            made = len(folder.changes)
            kept = chance.randint(folder.durable, made)
            if survival is Survival.SYNCED:
                kept = folder.durable
            elif survival is Survival.ALL:
                kept = made
            changes += folder.changes[:kept]
        files: dict[str, _File] = {}
        folders: dict[str, None] = {}
        for _, what, name, other in sorted(changes, key=lambda change: change[0]):
            if isinstance(other, _File):
                files[name] = other
            elif what is What.RENAME:
                _rename(files, other, name)
                _rename(folders, other, name)
            elif what is What.LINK and other in files:
                files[name] = files[other]
            elif what is What.MKDIR:
                folders[name] = None
            else:
                files.pop(name, None)
                folders.pop(name, None)
        return files, set(folders)


class Survival(enum.Enum):
    """Which of the changes that were not synced survive."""

    SYNCED = enum.auto()
    """None."""

    FIRST = enum.auto()
    """The first ones."""

    ANY = enum.auto()
    """Any: pages of writes, in any order."""

    ALL = enum.auto()
    """All."""


def _rename(names: dict[str, Any], old: str, new: str) -> None:
    for name in [name for name in names if name == old or name.startswith(f"{old}/")]:
        names[new + name[len(old) :]] = names.pop(name)


def _content_left(file: _File, chance: random.Random, survival: Survival) -> bytes:
    made = len(file.changes)
    whole = made if survival is Survival.ALL else file.durable
    if survival is Survival.FIRST:
        whole = chance.randint(file.durable, made)
    content = bytearray()
    for offset, data in file.changes[:whole]:
        _change(content, offset, data)
    rest = file.changes[whole:]
    if survival is Survival.FIRST and rest and rest[0][1] is not None:
        _change(content, rest[0][0], rest[0][1][: chance.randrange(len(rest[0][1]))])  # torn
    elif survival is Survival.ANY:
        rate = chance.choice([0.1, 0.5, 0.9])
        parts = (part for change in rest for part in _parts(change, chance))
        for offset, data in parts:
            if chance.random() < rate:
                _change(content, offset, data)
    return bytes(content)


def _parts(
    change: tuple[int, bytes | None], chance: random.Random
) -> Iterator[tuple[int, bytes | None]]:
    """Split a write into what a disk writes as a whole: pages, now and then sectors."""
    offset, data = change
    if data is None:
        yield change
        return
    step = PAGE if chance.random() < PAGES else SECTOR
    for at in range(offset - offset % step, offset + len(data), step):
        low, high = max(at, offset), min(at + step, offset + len(data))
        yield low, data[low - offset : high - offset]


def _change(content: bytearray, offset: int, data: bytes | None) -> None:
    if data is None:
        del content[offset:]
    if offset > len(content):
        content.extend(bytes(offset - len(content)))
    if data is not None:
        content[offset : offset + len(data)] = data
