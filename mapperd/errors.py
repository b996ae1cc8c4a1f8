"""The errors of mapperd, and rejects of input.

MapperdError
 +-- ConfigError      a setting is invalid: where, and what is allowed
 +-- LiveError        a link cannot be opened
 +-- ReplayError      the recording cannot be mapped with the given options
 +-- MapError         the map cannot hold or return the requested data
 +-- StoreError       the map's file cannot be used
 +-- CheckpointError  a saved state cannot be resumed
 +-- ExportError      a result cannot be written
      +-- ExportExtraError  a library is missing that an extra installs
"""

import errno
from dataclasses import dataclass

from oculus_driver.errors import missing_extra

__all__ = [
    "CheckpointError",
    "ConfigError",
    "ExportError",
    "ExportExtraError",
    "LiveError",
    "MapError",
    "MapperdError",
    "Reject",
    "ReplayError",
    "StoreError",
    "missing_extra",
    "os_reason",
]


class MapperdError(Exception):
    """Root of all errors of this package; its text is one line for people."""

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without calling the constructor, whose arguments differ by class."""
        return _rebuild, (type(self), self.args), self.__dict__


def _rebuild(kind: type[MapperdError], args: tuple[object, ...]) -> MapperdError:
    return kind.__new__(kind, *args)


class ConfigError(MapperdError):
    """A setting is invalid.

    Attributes:
        path: path of the setting, `$.octree.voxel_resolution`; `$` for the whole document.
    """

    def __init__(self, message: str, path: str = "$") -> None:
        super().__init__(message)
        self.path = path


class LiveError(MapperdError):
    """A link cannot be opened."""


class ReplayError(MapperdError):
    """The recording cannot be mapped with the given options."""


class MapError(MapperdError):
    """The map cannot carry out a request.

    Attributes:
        reason: short and stable: the name of a counter.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class StoreError(MapperdError):
    """The map's file cannot be used; it holds the last saved state.

    Attributes:
        reason: short and stable: `other_parameters`, `in_use`, `not_a_store`, `newer_version`,
            `damaged`, `disk_full`, `read_only`, `cannot_open`, `busy`, `io_error`, `closed`, or
            `out_of_step`: the map changed without a record of its progress.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class CheckpointError(MapperdError):
    """A saved state of the estimators cannot be resumed: damaged, or of another program."""


class ExportError(MapperdError):
    """A file of results cannot be written."""


class ExportExtraError(ExportError):
    """A format needs a library that an extra installs."""


@dataclass(frozen=True, slots=True)
class Reject:
    """Reason why bytes, a record or a ping were not used. A value, not an exception.

    Attributes:
        reason: short and stable: the name of a counter.
        detail: one sentence for people.
    """

    reason: str
    detail: str


OS_REMEDIES = {
    errno.EACCES: "check its owner and permissions, or choose another",
    errno.EPERM: "check its owner and permissions, or choose another",
    errno.ENOSPC: "free some space, or choose another disk",
    errno.EADDRINUSE: "stop the program that has it, or choose another port",
    errno.EADDRNOTAVAIL: "choose an address of this computer, see `ip address`",
}


def os_reason(error: OSError) -> str:
    """Return why the system refused something and what to do about it, for people."""
    text = error.strerror or str(error) or type(error).__name__
    remedy = OS_REMEDIES.get(error.errno or 0)
    return f"{text}; {remedy}" if remedy else text
