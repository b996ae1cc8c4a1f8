"""The map stream written as MCAP, in whole chunks: readable after a crash."""

import io
import os
from pathlib import Path

import foxglove
from foxglove.mcap import MCAPWriteOptions

from mapperd.client.changes import ClientChange
from mapperd.errors import ExportError
from mapperd.foxglove.bridge import Relay
from mapperd.foxglove.channels import Channels
from mapperd.foxglove.map_publisher import RECORDING
from mapperd.foxglove.messages import Follows

__all__ = ["ChunkFile", "McapRecorder"]


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


CHUNK_BYTES = 1 << 20
KEEP_S = 1.0


class McapRecorder:
    """Writes one file; of the thread of the client.

    Args:
        client: whose changes are recorded.
        path: of a file that is not there yet.

    Raises:
        ExportError: it cannot be made.
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
        self._relay = Relay(client, self._channels, RECORDING)
        self._kept_s = 0.0

    @property
    def bytes(self) -> int:
        """Of the file, with what is about to be written."""
        return self._file.bytes + self._file.held

    @property
    def messages(self) -> int:
        """Written so far."""
        return self._channels.messages

    def take(self, change: ClientChange, now_s: float) -> None:
        """Write of a change.

        Raises:
            ExportError: the disk takes no more; the file is whole up to here.
        """
        self._relay.take(change)
        self._relay.tick(now_s)
        if self._file.held >= CHUNK_BYTES:
            self._keep(now_s)

    def tick(self, now_s: float) -> None:
        """Write what may not be written at once, and bring it to the disk once a second.

        Raises:
            ExportError: as `take`.
        """
        self._relay.tick(now_s)
        if now_s - self._kept_s >= KEEP_S:
            self._keep(now_s)

    def end(self, now_s: float) -> None:
        """Write the map as it is at last, and the file's index.

        Raises:
            ExportError: as `take`.
        """
        self._relay.tick(now_s, last=True)
        self._writer.close()
        try:
            self._file.bring()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Write no more; the file is whole up to what was brought to the disk."""
        self._writer.close()
        self._file.close()

    def _keep(self, now_s: float) -> None:
        self._kept_s = now_s
        self._writer.flush()
        self._file.bring()
