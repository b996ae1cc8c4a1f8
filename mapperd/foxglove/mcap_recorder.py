"""What a client of the map stream is told, written as MCAP."""

from pathlib import Path

import foxglove
from foxglove.mcap import MCAPWriteOptions

from mapperd.client.changes import ClientChange
from mapperd.foxglove.bridge import Relay
from mapperd.foxglove.channels import Channels
from mapperd.foxglove.map_publisher import RECORDING
from mapperd.foxglove.mcap_file import ChunkFile
from mapperd.foxglove.messages import Follows

__all__ = ["McapRecorder"]

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
