"""Read compressed chunks piece by piece: what is there before a cut, never more than is asked."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

_PIECE: Final = 1 << 16
_MAX_WINDOW: Final = 1 << 26
"""Memory that a zstd frame may ask for."""


class ByteSource(Protocol):
    """Bytes that come once, in order."""

    def read(self, size: int, /) -> bytes:
        """Return up to `size` bytes; fewer only at the end."""
        ...


class Inflated:
    """The decompressed bytes of one chunk; ends early, and says why, where the data do.

    Attributes:
        fault: what is wrong with the compressed data, or None.
        size: bytes decompressed so far.
    """

    def __init__(self, compression: str, source: ByteSource) -> None:
        self.fault: str | None = None
        self.size = 0
        try:
            self._some: Callable[[int], bytes] = _OPENERS[compression](source)
        except KeyError:
            self._fail(f"compression {compression[:16]!r} is not known")
        except ImportError as error:
            self._fail(f"compression {compression} needs the Python package {error.name}")

    def read(self, size: int, /) -> bytes:
        """Return `size` bytes, fewer only at the end or where the data are damaged."""
        parts: list[bytes] = []
        left = size
        while left and self.fault is None:
            try:
                part = self._some(min(left, _PIECE))
            except Exception as error:  # noqa: BLE001 - each decompressor has its own errors
                self._fail(f"cannot decompress: {error}")
                break
            if not part:
                break
            parts.append(part)
            left -= len(part)
        self.size += size - left
        return b"".join(parts)

    def _fail(self, text: str) -> None:
        self.fault = text


def _open_zstd(source: ByteSource) -> Callable[[int], bytes]:
    decompressor = import_module("zstandard").ZstdDecompressor(max_window_size=_MAX_WINDOW)
    stream = decompressor.stream_reader(source, read_size=_PIECE, read_across_frames=True)

    def some(size: int) -> bytes:
        return bytes(stream.read(size))

    return some


def _open_lz4(source: ByteSource) -> Callable[[int], bytes]:
    decompressor = import_module("lz4.frame").LZ4FrameDecompressor()

    def some(size: int) -> bytes:
        part = b""
        while not part and not decompressor.eof:
            piece = source.read(_PIECE) if decompressor.needs_input else b""
            part = decompressor.decompress(piece, max_length=size)
            if not part and not piece:
                break
        return bytes(part)

    return some


_OPENERS: Final[dict[str, Callable[[ByteSource], Callable[[int], bytes]]]] = {
    "zstd": _open_zstd,
    "lz4": _open_lz4,
}
