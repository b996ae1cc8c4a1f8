"""Searches damaged files for the next valid record."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, BinaryIO, Final

from oculus_driver.recording import mcap_records as mcap
from oculus_driver.recording.mcap_records import Opcode

if TYPE_CHECKING:
    from collections.abc import Container, Iterator
    from typing import BinaryIO


MAX_RECORD: Final = 1 << 26
"""Largest record, in bytes, that is read into memory. Larger ones are skipped."""

_WINDOW: Final = 1 << 20
_NEAR_NS: Final = 3_600_000_000_000
"""Maximum time difference between messages after a damaged place and those before it."""

_HEADS: Final = re.compile(
    rb"\x05(?=.{3}[\x00-\x04]\x00{4})|\x06(?=.{5}\x00{3})|\x07(?=.{4}\x00{4})", re.DOTALL
)
_MAX_HEAD: Final = mcap.HEAD.size + mcap.CHUNK_HEAD.size + 4 + mcap.U64.size
_COMPRESSIONS: Final = {0: b"", 3: b"lz4", 4: b"zstd"}


def find_record(
    file: BinaryIO,
    search_range: tuple[int, int],
    size: int,
    channels: Container[int],
    near_ns: int | None,
) -> int | None:
    """Return the offset of the first chunk, message or message index in `search_range`, or None.

    The three opcodes occur in any image, so a position counts only if its whole head is consistent.
    Reads each byte once, whatever the content.

    Args:
        file: its position is changed.
        search_range: first offset to examine, and the offset to stop at.
        size: of the file.
        channels: valid channel numbers of messages.
        near_ns: a stamp before the damage; None without one.
    """
    start, stop = search_range
    while start < stop:
        file.seek(start)
        span = min(_WINDOW, stop - start)
        window = file.read(span + _MAX_HEAD)
        for found in _HEADS.finditer(window):
            at = found.start()
            if at >= span:
                break
            room = size - start - at
            if (
                _chunk(window, at, room)
                or _message(window, at, room, channels, near_ns)
                or _message_index(window, at, channels)
            ):
                return start + at
        start += span
    return None


def _chunk(window: bytes, at: int, room: int) -> bool:
    """Return whether a complete chunk starts here: its three sizes must agree."""
    if window[at] != Opcode.CHUNK or len(window) - at < _MAX_HEAD:
        return False
    _, length = mcap.HEAD.unpack_from(window, at)
    at += mcap.HEAD.size
    first, last, inflated, _, name_size = mcap.CHUNK_HEAD.unpack_from(window, at)
    at += mcap.CHUNK_HEAD.size
    name = _COMPRESSIONS.get(name_size)
    if name is None or window[at : at + name_size] != name or first > last:
        return False
    (size,) = mcap.U64.unpack_from(window, at + name_size)
    whole = length == mcap.CHUNK_HEAD.size + name_size + mcap.U64.size + size
    return whole and (inflated == size or bool(name)) and mcap.HEAD.size + length <= room


def _message(
    window: bytes, at: int, room: int, channels: Container[int], near_ns: int | None
) -> bool:
    """Return whether a complete message of a known channel with a plausible time starts here."""
    if window[at] != Opcode.MESSAGE or len(window) - at < mcap.HEAD.size + mcap.MESSAGE_HEAD.size:
        return False
    _, length = mcap.HEAD.unpack_from(window, at)
    number, _, stamp, _ = mcap.MESSAGE_HEAD.unpack_from(window, at + mcap.HEAD.size)
    if number not in channels or not mcap.MESSAGE_HEAD.size <= length <= MAX_RECORD:
        return False
    likely = near_ns is not None and abs(stamp - near_ns) <= _NEAR_NS
    return likely and mcap.HEAD.size + length <= room


def _message_index(window: bytes, at: int, channels: Container[int]) -> bool:
    """Return whether the index of a known channel starts here: its two sizes must agree."""
    sizes = mcap.HEAD.size + mcap.U16.size + mcap.U32.size
    if window[at] != Opcode.MESSAGE_INDEX or len(window) - at < sizes:
        return False
    _, length = mcap.HEAD.unpack_from(window, at)
    (number,) = mcap.U16.unpack_from(window, at + mcap.HEAD.size)
    (size,) = mcap.U32.unpack_from(window, at + mcap.HEAD.size + mcap.U16.size)
    whole = length == mcap.U16.size + mcap.U32.size + size
    return whole and size > 0 and size % (2 * mcap.U64.size) == 0 and number in channels


_FIRST_WINDOW: Final = 1 << 10
_MAX_WINDOW: Final = 1 << 20


def windows(file: BinaryIO, start: int, size: int, overlap: int) -> Iterator[tuple[int, bytes]]:
    """Yield offset and bytes of pieces of a file from `start` to its end.

    Pieces double in size up to 1 MiB: the next valid record is usually near, so that many short
    searches cost little. Moves the file position; the caller may move it, too.

    Args:
        file: of `size` bytes.
        start: offset of the first piece.
        size: of the file.
        overlap: number of bytes shared with the next piece, so that a record that starts in a
            piece is complete in it.
    """
    length = _FIRST_WINDOW
    while start < size:
        file.seek(start)
        yield start, file.read(length + overlap)
        start += length
        length = min(2 * length, _MAX_WINDOW)
