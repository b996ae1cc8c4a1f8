"""Errors of `mapperctl`, with their exit codes."""

from enum import IntEnum

from mapperd.errors import MapperdError
from mapperd.wire.framing import StreamError

__all__ = ["CtlError", "CtlExit", "plain", "refused"]


class CtlExit(IntEnum):
    """Exit codes; those above 64 follow sysexits.h."""

    OK = 0
    REFUSED = 1
    USAGE = 2
    UNAVAILABLE = 69
    CANNOT_WRITE = 73
    TRY_AGAIN = 75
    PROTOCOL = 76
    NO_PERMISSION = 77
    BAD_CONFIG = 78
    INTERRUPTED = 130


class CtlError(MapperdError):
    """A command failed; the text is one line for people.

    Attributes:
        code: exit code.
    """

    def __init__(self, message: str, code: CtlExit) -> None:
        super().__init__(plain(message))
        self.code = code


def plain(text: object) -> str:
    """Replace unprintable characters, such as a terminal's escape sequences."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(text))


NO_PERMISSION = frozenset({"wrong_token", "needs_token", "no_permission", "not_trusted"})


def refused(error: StreamError) -> CtlError:
    """Convert an error of the stream to an error with an exit code."""
    code = CtlExit.NO_PERMISSION if error.reason in NO_PERMISSION else CtlExit.PROTOCOL
    return CtlError(str(error), code)
