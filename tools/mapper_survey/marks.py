"""What is done already: a small file beside each result says what it was made of and what it took.

It is written after the result, so that a stop in between only has the result made again.
"""

import zlib
from typing import BinaryIO, TypeVar

import msgspec

from mapper_survey.folder import Folder

__all__ = ["crc_of", "mark", "marked"]

PIECE = 1 << 20
"""Bytes of a file in memory at a time."""

T = TypeVar("T", bound=msgspec.Struct)


def mark(folder: Folder, name: str, told: msgspec.Struct) -> None:
    """Say that a result is there."""
    folder.write(name, msgspec.json.format(msgspec.json.encode(told), indent=2))


def marked(folder: Folder, name: str, kind: type[T]) -> T | None:
    """What was said of a result; None where nothing was, or nothing of this version."""
    data = folder.read(name)
    if data is None:
        return None
    try:
        return msgspec.json.decode(data, type=kind)
    except msgspec.DecodeError:
        return None


def crc_of(file: BinaryIO) -> int:
    """CRC-32 of the rest of a file."""
    crc = 0
    while piece := file.read(PIECE):
        crc = zlib.crc32(piece, crc)
    return crc
