"""What a client of the map stream is refused."""

from mapperd.errors import MapperdError
from mapperd.wire.framing import StreamError

__all__ = ["AskError", "EndedError"]

FINAL = frozenset(
    {
        "bad_interest",
        "bad_version",
        "needs_token",
        "no_permission",
        "not_trusted",
        "too_many_blocks",
        "wrong_token",
    }
)
"""Reasons that trying again does not mend."""


class AskError(MapperdError):
    """The daemon did not do what was asked.

    Attributes:
        reason: one of docs/reference/control.md, or of the client itself: `not_connected`,
            `link_lost`, `no_answer`, `too_long`.
        details: plain values.
    """

    def __init__(self, reason: str, message: str, details: dict[str, object] | None = None) -> None:
        super().__init__(message)
        self.reason = reason
        self.details = details or {}


class EndedError(StreamError):
    """The connection was ended in a proper way, or never let come about."""

    @property
    def is_final(self) -> bool:
        """Trying again does not mend it."""
        return self.reason in FINAL
