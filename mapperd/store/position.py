"""Position up to which a map is complete: place in the recordings and state of the estimators."""

import zlib
from typing import Any, Protocol

import msgspec
from msgspec import Struct

from mapperd.errors import StoreError

__all__ = ["Position", "RecordingOffset", "RecordingOffsets", "position_in", "with_incomplete"]


class RecordingOffset(Struct, frozen=True, order=True):
    """A position between two chunks of a session's recordings.

    Attributes:
        file: number in the file's name; 0 is the first file of the session.
        chunks: number of chunks of that file before it.
    """

    file: int = 0
    chunks: int = 0


class RecordingOffsets(Protocol):
    """Returns positions of pieces in a recording."""

    @property
    def missing(self) -> str:
        """Why the recording is incomplete; empty if it is complete."""

    @property
    def newest(self) -> int:
        """Number of the newest piece."""

    @property
    def end(self) -> RecordingOffset | None:
        """End of the recording after the newest piece; None until that is written."""

    def place_of(self, number: int) -> RecordingOffset | None:
        """Return the position after a piece; None until that is written."""

    def wait_for(self, number: int, timeout_s: float) -> bool:
        """Wait until a piece is on the disk and survives a power failure."""


class Position(Struct, frozen=True):
    """Position of a map: it holds all before a checkpoint and `done` pieces of work after it.

    Attributes:
        session: id of the last session of the map.
        whole: nothing of the session is missing; the fields after `crc` then do not matter.
        sessions: ids of all sessions since the map was empty, this one included.
        emptied: ids of sessions that a reset removed from the map.
        incomplete: reasons by session of which the map lacks a part.
        unrecorded: ids of sessions whose recordings lack a part of the map.
        ends: end of the recordings by session at completion; earlier files lack it.
        crc: CRC-32 of all encoded bytes before it; the last field, None in earlier files.
        place: position of the checkpoint.
        done: number of pieces of work in the map since then.
        config: the settings at the checkpoint, as plain values.
        fixed: the vehicle stood still.
        checkpoint: state of the estimators.
        localization: state of localization at the checkpoint; empty if the map does not depend on
            it.
        surface: state of the estimated level of surfaces at the checkpoint; empty by IWLO.
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
    surface: bytes = b""
    emptied: tuple[str, ...] = ()
    incomplete: dict[str, str] = {}
    unrecorded: tuple[str, ...] = ()
    ends: dict[str, RecordingOffset] = {}
    crc: int | None = None

    def encoded(self) -> bytes:
        """Return the bytes for the map's file."""
        data = msgspec.msgpack.encode(msgspec.structs.replace(self, crc=MAX_CRC))
        return data[:-CRC_BYTES] + zlib.crc32(data[:-CRC_BYTES]).to_bytes(CRC_BYTES, "big")

    @property
    def states_all(self) -> bool:
        """Whether the last session is in the map as a whole, or stated to be incomplete."""
        return self.whole or self.session in self.incomplete


CRC_BYTES = 4
MAX_CRC = (1 << 32) - 1
CRC_TAG = b"\xa3crc\xce"
"""MessagePack of the key, and the type of its value."""

KEYS = (b"\xa8sessions", b"\xa5whole")
"""Keys of a position; damage of one byte leaves one of them."""

_DECODER = msgspec.msgpack.Decoder(Position)


def with_incomplete(position: Position | None, session: str, why: str) -> Position | None:
    """Return the position with the reason why a session of the map is incomplete in it."""
    if position is None or session not in position.sessions:
        return position
    return msgspec.structs.replace(position, incomplete={**position.incomplete, session: why})


def position_in(data: bytes) -> Position | None:
    """Read the position in a map file; None if it is absent or of another program.

    Raises:
        StoreError: it is damaged.
    """
    try:
        position = _DECODER.decode(data)
    except ValueError as error:  # malformed, or not UTF-8
        if any(name in data for name in KEYS):
            text = f"the position in the map file is damaged: {error}"
            raise StoreError(text, "damaged") from error
        return None
    content, crc = data[:-CRC_BYTES], int.from_bytes(data[-CRC_BYTES:], "big")
    if content.endswith(CRC_TAG) and zlib.crc32(content) != crc:
        raise StoreError("the position in the map file is damaged", "damaged")
    return position
