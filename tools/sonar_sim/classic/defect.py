"""One thing that the published pipeline gets wrong, measured on it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Defect:
    """A defect.

    Attributes:
        number: as in the documentation's table.
        title: what is wrong.
        measured: what the pipeline gives, in words.
        right: what it should give.
        numbers: behind the words.
    """

    number: int
    title: str
    measured: str
    right: str
    numbers: tuple[float, ...]
