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
        where: for people, and the sources of `studies.numerics.sources`.
        what: is single precision there.
        measure: gives the error and its consequence.
        enough: why it does, and what it saves.
        numpy: why the same arithmetic is measured in numpy, where it is not the product's own.
    """

    where: str
    what: str
    measure: Callable[[], Measured]
    enough: str
    numpy: str = ""
