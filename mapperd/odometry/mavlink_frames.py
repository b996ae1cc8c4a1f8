"""MAVLink 1 and 2 frames out of any bytes. Packets' checks and layouts are pymavlink's business.

A frame whose check fails may only have begun at a wrong byte, so the search goes on one byte
later: a garbled length costs one frame, not those behind it. These may come late, by what the
wrong length made us wait for: 280 bytes at most, none of a datagram.
"""

from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import common

from mapperd.reject import Reject

__all__ = ["MavlinkFrames"]

V1, V2 = 0xFE, 0xFD
V1_OVERHEAD, V2_OVERHEAD, SIGNATURE = 8, 12, 13
SIGNED = 0x01
"""The one incompatibility flag there is; a frame with another cannot be understood."""

MAX_FRAME_BYTES = 255 + V2_OVERHEAD + SIGNATURE


class MavlinkFrames:
    """Cuts a stream, or datagrams, into messages.

    Attributes:
        skipped: bytes so far that belong to no frame.

    Args:
        datagrams: no frame goes on into the next piece.
    """

    def __init__(self, *, datagrams: bool) -> None:
        self.skipped = 0
        self._datagrams = datagrams
        self._buffer = bytearray()
        self._in_sync = True
        self._codec: Any = common.MAVLink(None)

    def restart(self) -> None:
        """Forget what is half received."""
        self.skipped += len(self._buffer)
        self._buffer.clear()

    def feed(self, data: bytes) -> Iterator[Any]:
        """Messages, and one Reject for each time that bytes belonged to none."""
        self._buffer += data
        place = 0
        while (end := self._frame_end(place)) is not None:
            result = self._decoded(place, end)
            if result is None:
                self.skipped += 1
                place += 1
                if self._in_sync:
                    self._in_sync = False
                    yield Reject("not_a_frame", "bytes that are no MAVLink frame with a good check")
            else:
                place, self._in_sync = end, True
                yield result
        del self._buffer[:place]

    def _frame_end(self, place: int) -> int | None:
        """End of what would be a frame at `place`; `place` itself for none; None to wait."""
        buffer = self._buffer
        size = _frame_size(buffer, place)
        if place < len(buffer) and (size is None or place + size > len(buffer)):
            return place if self._datagrams else None
        return None if size is None else place + size

    def _decoded(self, place: int, end: int) -> Any:  # noqa: ANN401 pymavlink's messages
        """The message, a Reject for a good one that cannot be understood, None for no frame."""
        message = self._parsed(place, end)
        if isinstance(message, common.MAVLink_unknown) and not self._is_likely(place, end):
            return None
        if message is not None and self._buffer[place] == V2 and self._buffer[place + 2] & ~SIGNED:
            return Reject("incompatible", f"incompatibility flags {self._buffer[place + 2]:#04x}")
        return message

    def _parsed(self, place: int, end: int) -> Any:  # noqa: ANN401
        if place == end:
            return None
        try:
            return self._codec.decode(self._buffer[place:end])
        except common.MAVError:
            return None

    def _is_likely(self, place: int, end: int) -> bool:
        """Whether this is a frame of another dialect: their checks cannot be told.

        It stands between others, and no frame of ours begins within it.
        """
        buffer = self._buffer
        if not self._in_sync or (end < len(buffer) and buffer[end] not in (V1, V2)):
            return False
        for inner in range(place + 1, end):
            size = _frame_size(buffer, inner) or 0
            if size and inner + size <= len(buffer):
                message = self._parsed(inner, inner + size)
                if not (message is None or isinstance(message, common.MAVLink_unknown)):
                    return False
        return True


def _frame_size(buffer: bytearray, place: int) -> int | None:
    """Bytes of the frame that begins at `place`, 0 where none can; None: too few to tell."""
    if place >= len(buffer):
        return None
    if buffer[place] not in (V1, V2):
        return 0
    if place + 2 >= len(buffer):
        return None
    if buffer[place] == V1:
        return buffer[place + 1] + V1_OVERHEAD
    return buffer[place + 1] + V2_OVERHEAD + (SIGNATURE if buffer[place + 2] & SIGNED else 0)
