"""Who is at work in a survey's folder where the disk's locks do not reach, as in object storage.

A small file says so. Unlike a lock of the disk it stays when its owner is killed: on the same
machine that is seen, elsewhere a person has to say so.
"""

import contextlib
import os
import socket
import uuid
from collections.abc import Iterator
from pathlib import Path

import msgspec

from mapper_survey.errors import SurveyError
from mapper_survey.folder import Folder
from mapper_survey.this_system import this_system

__all__ = ["LOCK", "held"]

LOCK = "lock.json"


class Holder(msgspec.Struct, frozen=True):
    """A process that works in a folder.

    Attributes:
        host: name of its machine, for a person.
        system: which run of which system counts its process ids.
        pid: of it.
        token: its own, among all.
    """

    host: str
    system: str
    pid: int
    token: str


@contextlib.contextmanager
def held(folder: Folder) -> Iterator[None]:
    """Say that this process works there, as long as it does.

    Two that begin at the same moment may not see each other.

    Raises:
        SurveyError: another one does, or was killed and cannot say that it does not.
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
    """Known only of processes that are counted where this one is."""
    return holder.system == this_system() and not Path(f"/proc/{holder.pid}").exists()
