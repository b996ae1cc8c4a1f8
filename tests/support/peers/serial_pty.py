"""A serial line without hardware: a pseudo terminal whose other end the test holds."""

import os
import tty
from types import TracebackType
from typing import Self


class SerialPty:
    """A line that can be opened by its path, unplugged, and plugged in again.

    Attributes:
        path: of the end to open; another one after each `plug`.
    """

    def __init__(self) -> None:
        self.path = ""
        self._ours = -1
        self._theirs = -1

    def __enter__(self) -> Self:
        self.plug()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.unplug()

    def plug(self) -> None:
        """Create the line in raw mode, which changes no byte."""
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.path = os.ttyname(self._theirs)

    def unplug(self) -> None:
        """Remove the line: its reader gets an end of file or an error."""
        for end in (self._ours, self._theirs):
            if end >= 0:
                os.close(end)
        self._ours = self._theirs = -1

    def send(self, data: bytes) -> None:
        """Write data to the reader of the path; return when all of it is written."""
        while data:
            data = data[os.write(self._ours, data) :]

    def heard(self, max_bytes: int = 4096) -> bytes:
        """Return what was written to the path; wait for at least one byte."""
        return os.read(self._ours, max_bytes)
