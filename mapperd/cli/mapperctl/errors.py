"""What goes wrong for `mapperctl`, with the exit code that says so."""

from enum import IntEnum

from mapperd.errors import MapperdError

__all__ = ["CtlError", "Exit", "plain"]


class Exit(IntEnum):
    """Exit codes; those above 64 are of sysexits.h."""

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
    """A command is not done; the text is one line for a person.

    Attributes:
        code: of the exit.
    """

    def __init__(self, message: str, code: Exit) -> None:
        super().__init__(plain(message))
        self.code = code


def plain(text: object) -> str:
    """Text of a daemon without anything that would move a terminal's cursor."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(text))
