"""Errors of a client of the map stream."""

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
"""Reasons for which reconnecting does not help."""


class AskError(MapperdError):
    """The daemon did not carry out a request.

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
    """The daemon ended or refused the connection, or this client cannot use it."""

    @property
    def is_final(self) -> bool:
        """Whether reconnecting does not help."""
        return self.reason in FINAL
