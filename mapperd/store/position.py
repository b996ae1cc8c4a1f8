"""Up to where a map is complete: the place in its recordings, and all that the estimators knew."""

import zlib
from typing import Any, Protocol

import msgspec
from msgspec import Struct

from mapperd.errors import StoreError

__all__ = ["Position", "RecordingOffset", "RecordingOffsets", "position_in"]


class RecordingOffset(Struct, frozen=True, order=True):
    """Between two chunks of a session's recordings.

    Attributes:
        file: number in the file's name; 0 is the first file of the session.
        chunks: of that file that lie before it.
    """

    file: int = 0
    chunks: int = 0


class RecordingOffsets(Protocol):
    """Knows where the pieces of a recording lie."""

    @property
    def missing(self) -> str:
        """Why the recording lacks a part of the session; empty if it does not."""

    @property
    def newest(self) -> int:
        """Number of the newest piece."""

    @property
    def end(self) -> RecordingOffset | None:
        """Where the recording ends behind the newest piece; None while that is not written."""

    def place_of(self, number: int) -> RecordingOffset | None:
        """Where the recording goes on behind a piece; None while that is not written."""

    def wait_for(self, number: int, timeout_s: float) -> bool:
        """Wait until a piece is on the disk, where it survives a power cut."""


class Position(Struct, frozen=True):
    """The map holds the first `done` pieces of work that come after a checkpoint, and all before.

    Attributes:
        session: id of the session that made the map last.
        whole: nothing of the session is missing; then nothing below matters.
        sessions: ids of all sessions since the map was empty, this one included.
        emptied: ids of sessions that a reset has removed from the map.
        incomplete: sessions of which the map lacks a part, and why.
        unrecorded: ids of sessions of which the recordings lack a part that the map has.
        ends: end of the recordings by session when all of it was mapped; earlier files lack it.
        crc: CRC-32 of all encoded bytes before it; the last field, None in earlier files.
        place: of the checkpoint.
        done: pieces of work that are in the map since then.
        config: the settings in force at the checkpoint, as plain values.
        fixed: the vehicle stood still.
        checkpoint: the estimators.
        localization: its state when the work before the checkpoint was done; empty where the map
            does not depend on it.
        origin_deg: latitude and longitude of the map's origin; None if unknown.
    """

    session: str
    whole: bool
    sessions: tuple[str, ...]
    place: RecordingOffset = RecordingOffset()
    done: int = 0
    config: dict[str, Any] | None = None
    fixed: bool = False
    checkpoint: bytes = b""
    origin_deg: tuple[float, float] | None = None
    localization: bytes = b""
    emptied: tuple[str, ...] = ()
    incomplete: dict[str, str] = {}
    unrecorded: tuple[str, ...] = ()
    ends: dict[str, RecordingOffset] = {}
    crc: int | None = None

    def encoded(self) -> bytes:
        """As the map's file holds it."""
        data = msgspec.msgpack.encode(msgspec.structs.replace(self, crc=MAX_CRC))
        return data[:-CRC_BYTES] + zlib.crc32(data[:-CRC_BYTES]).to_bytes(CRC_BYTES, "big")


CRC_BYTES = 4
MAX_CRC = (1 << 32) - 1
CRC_TAG = b"\xa3crc\xce"
"""MessagePack of the key and of the type of the value."""

KEYS = (b"\xa8sessions", b"\xa5whole")
"""Keys of a position; damage of one byte leaves one of them."""

_DECODER = msgspec.msgpack.Decoder(Position)


def position_in(data: bytes) -> Position | None:
    """Read the position in a map file; None if it is absent or of another program.

    Raises:
        StoreError: it is damaged.
    """
    try:
        position = _DECODER.decode(data)
    except ValueError as error:  # malformed, or text that is not UTF-8
        if any(name in data for name in KEYS):
            text = f"the position in the map file is damaged: {error}"
            raise StoreError(text, "damaged") from error
        return None
    content, crc = data[:-CRC_BYTES], int.from_bytes(data[-CRC_BYTES:], "big")
    if content.endswith(CRC_TAG) and zlib.crc32(content) != crc:
        raise StoreError("the position in the map file is damaged", "damaged")
    return position
