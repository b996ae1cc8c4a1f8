"""An MCAP file that grows by whole chunks: a kill at any moment leaves a file that can be read."""

import io
import os
from pathlib import Path

from mapperd.errors import ExportError

__all__ = ["ChunkFile"]


class ChunkFile:
    """What the SDK writes into, and what brings it to the disk.

    The SDK writes a chunk's head first and comes back to fill it in. All is held in memory until
    the chunk is whole; the file itself is only ever added to.

    Args:
        path: of a file that is not there yet.

    Attributes:
        bytes: that are in the file.

    Raises:
        ExportError: it cannot be made, or is there.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.bytes = 0
        self._held = io.BytesIO()
        try:
            self._file = path.open("xb", buffering=0)
        except FileExistsError as error:
            raise ExportError(f"{path}: is there already, and is left as it is") from error
        except OSError as error:
            raise ExportError(f"{path}: cannot be written: {error.strerror}") from error

    @property
    def held(self) -> int:
        """Bytes that are not in the file yet."""
        return self._held.getbuffer().nbytes

    def write(self, data: bytes | bytearray) -> int:
        """For the SDK."""
        return self._held.write(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """For the SDK; never before what is in the file."""
        if whence == os.SEEK_SET:
            offset -= self.bytes
        return self.bytes + self._held.seek(offset, whence)

    def flush(self) -> None:
        """For the SDK, which says so in the midst of chunks too."""

    def bring(self) -> None:
        """Add all that is held to the file; it ends with a whole chunk.

        Raises:
            ExportError: it cannot be written; the file ends as before.
        """
        held, self._held = self._held.getvalue(), io.BytesIO()
        try:
            at = 0
            while at < len(held):
                at += self._file.write(memoryview(held)[at:])
        except OSError as error:
            self._file.truncate(self.bytes)
            raise ExportError(f"{self._path}: cannot be written: {error.strerror}") from error
        self.bytes += at

    def close(self) -> None:
        """Nothing follows."""
        self._file.close()
