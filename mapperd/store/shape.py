"""How values are written: everything but None, numbers, text and bytes is a list with a tag."""

from collections.abc import Iterator
from enum import StrEnum
from typing import Any

__all__ = ["FORMAT", "Tag", "attributes_of"]

FORMAT = 1
"""Another way of writing, or of reading what is written, is another number."""


class Tag(StrEnum):
    """First element of a list."""

    LIST = "l"
    TUPLE = "t"
    SET = "s"
    FROZENSET = "f"
    DEQUE = "q"
    DICT = "d"
    COUNTER = "c"
    BYTEARRAY = "y"
    BIG = "i"
    ENUM = "e"
    STRUCT = "u"
    ARRAY = "a"
    SCALAR = "n"
    OBJECT = "o"
    AGAIN = "r"
    KEPT = "k"
    ROWS = "w"


def attributes_of(value: object) -> Iterator[tuple[str, Any]]:
    """Names and values of all that an object holds, in a fixed order."""
    for kind in type(value).__mro__:
        slots = kind.__dict__.get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if name not in ("__weakref__", "__dict__") and hasattr(value, name):
                yield name, getattr(value, name)
    yield from getattr(value, "__dict__", {}).items()
