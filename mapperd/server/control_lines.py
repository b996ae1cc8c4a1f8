"""Lines out of a stream of bytes, none of them longer than allowed."""

__all__ = ["LineBuffer", "LineTooLongError"]


class LineTooLongError(ValueError):
    """A line is longer than allowed; where the next one begins is not known."""


class LineBuffer:
    """Holds what came until it is a line.

    Args:
        limit: bytes of the longest line, without its end.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._bytes = bytearray()
        self._searched = 0

    def __len__(self) -> int:
        return len(self._bytes)

    def feed(self, data: bytes) -> None:
        """Add what came."""
        self._bytes += data

    def next_line(self) -> bytes | None:
        """The next whole line without its end; None where there is none.

        Raises:
            LineTooLongError: there are more bytes than a line may have.
        """
        end = self._bytes.find(b"\n", self._searched)
        if end > self._limit or (end < 0 and len(self._bytes) > self._limit):
            raise LineTooLongError(f"a line is longer than {self._limit} bytes")
        if end < 0:
            self._searched = len(self._bytes)
            return None
        line = bytes(self._bytes[:end])
        del self._bytes[: end + 1]
        self._searched = 0
        return line.removesuffix(b"\r")
