"""A place where single precision was chosen, and what that costs."""

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Measured", "Place"]


@dataclass(frozen=True, slots=True)
class Measured:
    """What was found.

    Attributes:
        worst: largest error against double precision or better, with its unit.
        so: what that means for who uses the numbers.
    """

    worst: str
    so: str


@dataclass(frozen=True, slots=True)
class Place:
    """One of them.

    Attributes:
        where: for people.
        files: patterns of the sources that hold it; together with those of all others they are
            every source with single precision in it.
        what: is single precision there.
        measure: gives the error and its consequence.
        enough: why it does, and what it saves.
    """

    where: str
    files: tuple[str, ...]
    what: str
    measure: Callable[[], Measured]
    enough: str
