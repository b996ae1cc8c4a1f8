"""All that one run of the benchmark measured."""

from pathlib import Path

import msgspec
from accuracy import Accuracy
from measured import Measured

Water = dict[str, float]
"""Milliseconds a ping by range in metres."""


class Machine(msgspec.Struct, frozen=True):
    """Where, and from what, the figures were measured.

    Attributes:
        load: mean number of running processes in the minute before.
        bytes_a_second: of streaming read-modify-write, one thread, read and written bytes counted.
    """

    cpu: str
    cores: int
    compiler: str
    commit: str
    load: float
    bytes_a_second: float


class CaseResult(msgspec.Struct, frozen=True):
    """One look, range and voxel size.

    Attributes:
        loud_share: of the pixels, those above the map's intensity threshold.
        runs: by name of the contender.
        accuracy: of `rays` and the default, by what they were given, then by name.
    """

    name: str
    look: str
    range_m: float
    resolution_m: float
    loud_share: float
    runs: dict[str, Measured]
    accuracy: dict[str, dict[str, Accuracy]]

    @property
    def size(self) -> str:
        """Range and voxel size, as people say them."""
        return f"{self.range_m:g} m, {100 * self.resolution_m:g} cm"


class Results(msgspec.Struct, frozen=True):
    """A whole run."""

    command: str
    pings: int
    seed: int
    error_bound: float
    machine: Machine
    cases: list[CaseResult]
    open_water: dict[str, Water]

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_bytes(msgspec.json.format(msgspec.json.encode(self), indent=1))


def read_results(path: Path) -> Results:
    """Read what `Results.save` wrote."""
    return msgspec.json.decode(path.read_bytes(), type=Results)
