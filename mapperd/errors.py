"""The errors of mapperd, by who is at fault, and rejects of input.

MapperdError
 +-- ConfigError      our user's settings: place in them, what is allowed
 +-- LiveError        a link cannot be opened
 +-- ReplayError      the recording cannot become a map with the options given
 +-- MapError         the map cannot hold or give what was asked
 +-- StoreError       the map's file cannot be used
 +-- CheckpointError  a saved state cannot be gone on from
 +-- ExportError      a result cannot be written
"""

from dataclasses import dataclass

__all__ = [
    "CheckpointError",
    "ConfigError",
    "ExportError",
    "LiveError",
    "MapError",
    "MapperdError",
    "Reject",
    "ReplayError",
    "StoreError",
]


class MapperdError(Exception):
    """Root of all errors of this package; its text is one line for a person."""

    def __reduce__(self) -> tuple[object, ...]:
        """For other processes: whatever the constructor of a kind wants besides the text."""
        return _again, (type(self), self.args), self.__dict__


def _again(kind: type[MapperdError], args: tuple[object, ...]) -> MapperdError:
    return kind.__new__(kind, *args)


class ConfigError(MapperdError):
    """A setting is wrong.

    Attributes:
        path: place in the tree, `$.octree.voxel_resolution`; `$` for the whole document.
    """

    def __init__(self, message: str, path: str = "$") -> None:
        super().__init__(message)
        self.path = path


class LiveError(MapperdError):
    """A link cannot be opened."""


class ReplayError(MapperdError):
    """The recording cannot become a map with the options given."""


class MapError(MapperdError):
    """The map cannot do what was asked.

    Attributes:
        reason: short and stable: the name of a counter.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class StoreError(MapperdError):
    """The map's file cannot be used; what it holds is as it was at the last save.

    Attributes:
        reason: short and stable: `other_parameters`, `in_use`, `not_a_store`, `newer_version`,
            `damaged`, `disk_full`, `read_only`, `cannot_open`, `busy`, `io_error`, `closed`, or
            `out_of_step`: the map was changed and nobody said up to where.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class CheckpointError(MapperdError):
    """A saved state of the estimators cannot be gone on from: damaged, or of another program."""


class ExportError(MapperdError):
    """A file of results cannot be written."""


@dataclass(frozen=True, slots=True)
class Reject:
    """Bytes, a record or a ping that was not taken, as a value: bad input is data.

    Attributes:
        reason: short and stable: the name of a counter.
        detail: one sentence for a person.
    """

    reason: str
    detail: str
