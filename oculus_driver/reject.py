"""Why a message could not be used."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Reject:
    """A message that was not decoded.

    Attributes:
        reason: a name to count by: not_a_ping, unknown_version, short_message, empty,
            out_of_bounds, size_mismatch, bad_resolution, bad_data_size.
        detail: a sentence for a person.
        offset: position of the message in its stream.
        ping_id: of the ping, None where it cannot be read. Such a ping came; it is not lost.
    """

    reason: str
    detail: str
    offset: int
    ping_id: int | None = None
