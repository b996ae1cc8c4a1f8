"""Writes the map stream as MCAP in whole chunks, so that files are readable after a crash."""

import io
import os
from pathlib import Path

import foxglove
from foxglove.mcap import MCAPWriteOptions

from mapperd.client.changes import ClientChange
from mapperd.errors import ExportError, os_reason
from mapperd.foxglove.bridge import FoxgloveRelay
from mapperd.foxglove.channels import Channels
from mapperd.foxglove.map_publisher import RECORDING
from mapperd.foxglove.messages import Follows

__all__ = ["ChunkFile", "McapRecorder"]


class ChunkFile:
    """A file for the SDK that appends whole chunks only.

    The SDK writes a chunk's header first and fills it in later. This class holds a chunk in memory
    until it is complete, and only appends to the file.

    Args:
        path: a new file.

    Attributes:
        bytes: size of the file.

    Raises:
        ExportError: the file exists or cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.bytes = 0
        self._held = io.BytesIO()
        try:
            self._file = path.open("xb", buffering=0)
        except FileExistsError as error:
            raise ExportError(f"{path}: file exists; choose another name") from error
        except OSError as error:
            raise ExportError(f"{path}: cannot be written: {os_reason(error)}") from error

    @property
    def held(self) -> int:
        """Bytes not yet in the file."""
        return self._held.getbuffer().nbytes

    def write(self, data: bytes | bytearray) -> int:
        """Write as a binary file does."""
        return self._held.write(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Seek as a binary file does, within the bytes not yet in the file."""
        if whence == os.SEEK_SET:
            offset -= self.bytes
        return self.bytes + self._held.seek(offset, whence)

    def flush(self) -> None:
        """Do nothing: the SDK flushes within chunks."""

    def append_held(self) -> None:
        """Append the held bytes to the file, which then ends with a whole chunk.

        Raises:
            ExportError: writing failed; the file is as before.
        """
        held, self._held = self._held.getvalue(), io.BytesIO()
        try:
            at = 0
            while at < len(held):
                at += self._file.write(memoryview(held)[at:])
        except OSError as error:
            self._file.truncate(self.bytes)
            raise ExportError(f"{self._path}: cannot be written: {os_reason(error)}") from error
        self.bytes += at

    def close(self) -> None:
        """Close the file."""
        self._file.close()


CHUNK_BYTES = 1 << 20
KEEP_S = 1.0


class McapRecorder:
    """Writes one file, in the thread of the client.

    Args:
        client: source of the changes.
        path: a new file.

    Raises:
        ExportError: the file cannot be created.
    """

    def __init__(self, client: Follows, path: Path) -> None:
        self._file = ChunkFile(path)
        context = foxglove.Context()
        self._writer = foxglove.open_mcap(
            self._file,
            context=context,
            writer_options=MCAPWriteOptions(chunk_size=CHUNK_BYTES, compression_threads=0),
        )
        self._channels = Channels(context)
        self._relay = FoxgloveRelay(client, self._channels, RECORDING)
        self._kept_s = 0.0

    @property
    def bytes(self) -> int:
        """Size of the file with the bytes still held."""
        return self._file.bytes + self._file.held

    @property
    def messages(self) -> int:
        """Number written so far."""
        return self._channels.messages

    def take(self, change: ClientChange, now_s: float) -> None:
        """Record a change.

        Raises:
            ExportError: writing failed; the file is valid up to that point.
        """
        self._relay.take(change)
        self._relay.tick(now_s)
        if self._file.held >= CHUNK_BYTES:
            self._keep(now_s)

    def tick(self, now_s: float) -> None:
        """Write what is rate-limited, and flush to disk once a second.

        Raises:
            ExportError: as `take`.
        """
        self._relay.tick(now_s)
        if now_s - self._kept_s >= KEEP_S:
            self._keep(now_s)

    def end(self, now_s: float) -> None:
        """Write the final map and the file's index.

        Raises:
            ExportError: as `take`.
        """
        self._relay.tick(now_s, last=True)
        self._writer.close()
        try:
            self._file.append_held()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Stop without an index; the file is valid up to the last flush."""
        self._writer.close()
        self._file.close()

    def _keep(self, now_s: float) -> None:
        self._kept_s = now_s
        self._writer.flush()
        self._file.append_held()
