"""Why something that came in was not used."""

from dataclasses import dataclass

__all__ = ["Reject"]


@dataclass(frozen=True, slots=True)
class Reject:
    """Bytes, a record or a ping that was not taken, as a value: bad input is data.

    Attributes:
        reason: short and stable: the name of a counter.
        detail: one sentence for a person.
    """

    reason: str
    detail: str
