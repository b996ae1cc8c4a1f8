"""What clients wish to be told of the map, and what it is when they begin to be."""

from dataclasses import dataclass

import numpy as np

from mapperd.wire.framing import StreamError
from mapperd.wire.messages import Interest, MapFacts, Resume

__all__ = ["Beginning", "Wish", "checked"]


@dataclass(frozen=True, slots=True)
class Wish:
    """A part of the map that is to be told; None is no map."""

    interest: Interest | None
    resume: Resume | None = None


@dataclass(frozen=True, slots=True)
class Beginning:
    """The map when a client begins to be told of it, as `Welcome` says it."""

    facts: MapFacts
    revision: int
    session: str


def checked(interest: Interest) -> Interest:
    """The interest, if it is one.

    Raises:
        StreamError: its numbers are none.
    """
    box = interest.box
    numbers = [interest.radius_m, *(() if box is None else (*box.low_m, *box.high_m))]
    if not np.isfinite(numbers).all():
        raise StreamError("an interest with numbers that are none", "bad_interest")
    if box is not None and any(a > b for a, b in zip(box.low_m, box.high_m, strict=True)):
        raise StreamError("a box that ends before it begins", "bad_interest")
    return interest
