"""Search a damaged file piece by piece: small pieces first, as the next sound place is near."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

_FIRST: Final = 1 << 10
_LARGEST: Final = 1 << 20


def windows(file: BinaryIO, start: int, size: int, overlap: int) -> Iterator[tuple[int, bytes]]:
    """Yield the offsets and bytes of pieces of a file from `start` to its end.

    Pieces double in size up to 1 MiB, so that many short searches cost little. Moves the file;
    the caller may move it too.

    Args:
        file: of `size` bytes.
        start: offset of the first piece.
        size: of the file.
        overlap: bytes of the next piece that are at the end of each piece too: what is searched
            and begins in one piece is whole in it.
    """
    length = _FIRST
    while start < size:
        file.seek(start)
        yield start, file.read(length + overlap)
        start += length
        length = min(2 * length, _LARGEST)
