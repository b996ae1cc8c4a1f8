"""Message framing: does a message start at a position of the stream, and where does it end? Pure.

A ping states its size three times: in the header, as the message size in the body, and as the end
of the image. If the three agree, the ping is accepted. If they do not agree, or if the message id
is unknown, the bytes after the message decide: a message must be followed by another valid
header. If header and body state different sizes, the size that leads to a valid header wins. So a
damaged size field costs one ping and never the pings after it.

The sizes also agree if bytes are missing inside a ping; then it extends into the next ping. So a
ping is rejected if no header follows it and another ping of the same sonar starts inside it.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Final, NamedTuple

from oculus_driver.wire import (
    HEADER,
    MAGIC,
    MAGIC_BYTES,
    MAX_MESSAGE_SIZE,
    MIN_PING_PAYLOAD,
    PAYLOAD_LIMITS,
    PING_RESULT_V1,
    PING_RESULT_V2,
    UNKNOWN_PAYLOAD_LIMIT,
    MessageId,
    ping_result_layout,
)

_HEADER: Final = struct.Struct("<HHHHHIH")
_SIZES: Final = struct.Struct("<III")
_U16: Final = struct.Struct("<H")

MAX_STRICT_VERSION: Final = 2
MAX_VERSION: Final = 255

# Small and frequent: accepted at once while synchronised, so that no sign of life is delayed.
_PLAIN_IDS: Final = frozenset(
    {MessageId.FIRE, MessageId.USER_CONFIG, MessageId.LOG, MessageId.DUMMY}
)

CANDIDATE: Final = re.compile(
    rb"SO.{4}[\x15\x22\x23\x55\x80\xff]\x00[\x00-\x02]\x00.{3}[\x00\x01]", re.DOTALL
)
"""Start of a header with a known id and version and a payload below 32 MiB; searched at C speed."""

CANDIDATE_SIZE: Final = 14

_ID_OFFSET: Final = 6
_PING_ID: Final = int(MessageId.PING_RESULT)

_MARK_SIZE: Final = 4
"""Bytes of magic and source id: all messages of one sonar start with them."""

_STABLE_SIZE: Final = 10
"""Header bytes in front of the payload size; they rarely change between messages."""

_MAX_CHANGED_BYTES: Final = 2
"""Maximum number of changed bytes among these in a header that still counts as similar."""


class Header(NamedTuple):
    """The first 16 bytes of a message."""

    magic: int
    source_id: int
    destination_id: int
    message_id: int
    version: int
    payload_size: int
    part_number: int

    @property
    def size(self) -> int:
        """Size of the whole message according to the header, bytes."""
        return HEADER.size + self.payload_size


@dataclass(frozen=True, slots=True)
class Accept:
    """A message of `size` bytes starts here.

    Attributes:
        header: header of the message.
        size: size of the message.
        proven: the sizes inside the message agree.
        confirmed: nothing after the message contradicts its end, or no confirmation was requested.
    """

    header: Header
    size: int
    proven: bool
    confirmed: bool = True


@dataclass(frozen=True, slots=True)
class SkipBytes:
    """No recognisable message starts here; continue `skip` bytes later."""

    reason: str
    skip: int = 1


@dataclass(frozen=True, slots=True)
class NeedMore:
    """The decision needs `size` bytes from here."""

    size: int


FrameResult = Accept | SkipBytes | NeedMore


def read_header(buffer: bytes | bytearray, position: int) -> Header:
    """Return the header at `position`. The buffer must hold 16 bytes from there."""
    return Header._make(_HEADER.unpack_from(buffer, position))


def header_fault(header: Header, *, strict: bool) -> str | None:
    """Return why the header is not plausible, or None.

    Args:
        header: the header to check.
        strict: accept only known ids, versions and sizes, as during resynchronisation.
    """
    if header.magic != MAGIC:
        return "bad_magic"
    limit = PAYLOAD_LIMITS.get(header.message_id)
    if limit is None and strict:
        return "unknown_id"
    if header.payload_size > (UNKNOWN_PAYLOAD_LIMIT if limit is None else limit):
        return "oversize"
    if header.version > (MAX_STRICT_VERSION if strict else MAX_VERSION):
        return "unknown_version"
    if (
        strict
        and header.message_id == MessageId.PING_RESULT
        and header.payload_size < MIN_PING_PAYLOAD
    ):
        return "short_message"
    return None


@dataclass(frozen=True, slots=True)
class FrameChecker:
    """Decides what starts at a position of the stream.

    Attributes:
        synchronised: the position is the end of the previous message.
        source_id: the sonar's id, None before the first accepted ping.
        final: no more bytes will arrive.
        confirm: wait for the header after a ping whose sizes agree.
    """

    synchronised: bool
    source_id: int | None
    final: bool
    confirm: bool = False

    def check(self, buffer: bytes | bytearray, position: int) -> FrameResult:
        """Return what starts at `position`.

        Takes constant time for any claimed size, except for a complete ping whose sizes agree: then
        the time is proportional to the bytes of the ping.
        """
        left = len(buffer) - position
        if left < HEADER.size:
            return self._need_more(HEADER.size) if _magic_prefix(buffer, position) else _BAD_MAGIC
        header = read_header(buffer, position)
        fault = header_fault(header, strict=not self.synchronised)
        if fault is not None:
            return SkipBytes(fault)
        if header.message_id == MessageId.PING_RESULT:
            return self._check_ping(buffer, position, header)
        if self.synchronised and header.message_id in _PLAIN_IDS:
            return self._check_plain(buffer, position, header)
        reason = "truncated" if header.message_id in PAYLOAD_LIMITS else "unknown_id"
        return self._check_follower(buffer, position, header, (header.size,), reason)

    def _need_more(self, size: int) -> FrameResult:
        return SkipBytes("truncated") if self.final else NeedMore(size)

    def _check_plain(self, buffer: bytes | bytearray, position: int, header: Header) -> FrameResult:
        if len(buffer) - position < header.size:
            return self._need_more(header.size)
        return Accept(header, header.size, proven=False)

    def _check_ping(self, buffer: bytes | bytearray, position: int, header: Header) -> FrameResult:
        layout = ping_result_layout(header.version)
        if layout is None:
            return self._check_follower(buffer, position, header, (header.size,), "unknown_version")
        reason = "short_message" if header.size < layout.size else "size_mismatch"
        if len(buffer) - position < layout.size:
            if not self.final:
                return NeedMore(layout.size)
            return self._check_follower(buffer, position, header, (header.size,), reason)
        known_source = self.synchronised or self.source_id in (None, header.source_id)
        own = _body_size(buffer, position, header.version)
        if own == header.size and known_source:
            return self._check_proven(buffer, position, header)
        sizes = (header.size,) if own is None else tuple(sorted({own, header.size}))
        return self._check_follower(buffer, position, header, sizes, reason)

    def _check_proven(
        self, buffer: bytes | bytearray, position: int, header: Header
    ) -> FrameResult:
        """Check a ping whose sizes agree. It must wait if it may contain another ping."""
        size, left = header.size, len(buffer) - position
        if left < size:
            return self._need_more(size)
        if not self.confirm and self._find_inner_ping(buffer, position, size) is None:
            return Accept(header, size, proven=True)
        if left < size + HEADER.size and not self.final:
            return NeedMore(size + HEADER.size)
        if left > size and _followed_by_header(buffer, position, position + size):
            return Accept(header, size, proven=True)
        return self._check_unconfirmed(buffer, position, header)

    def _check_unconfirmed(
        self, buffer: bytes | bytearray, position: int, header: Header
    ) -> FrameResult:
        """Check a ping whose sizes agree but which no message follows."""
        size = header.size
        last = len(buffer) - position == size
        inside = self._find_inner_ping(buffer, position, size)
        if inside is None:
            return Accept(header, size, proven=True, confirmed=last or not self.confirm)
        if inside < 0:
            return NeedMore(size + PING_RESULT_V2.size)
        if last:
            return Accept(header, size, proven=True, confirmed=False)
        return SkipBytes("bytes_missing", inside - position)

    def _find_inner_ping(self, buffer: bytes | bytearray, position: int, size: int) -> int | None:
        """Return where another ping of this sonar starts inside a ping, None if nowhere.

        Returns -1 if more bytes are needed to decide. A single last byte that could start a ping
        counts only while confirming; otherwise one ping in 256 would have to wait.
        """
        mark = bytes(buffer[position : position + _MARK_SIZE])
        least = 1 if self.confirm else len(MAGIC_BYTES)
        last = position + size - least
        at = buffer.find(mark, position + 1, last + _MARK_SIZE)
        while at >= 0:
            starts = _ping_starts_at(buffer, at)
            if starts or (starts is None and not self.final):
                return at if starts else -1
            at = buffer.find(mark, at + 1, last + _MARK_SIZE)
        for at in range(max(len(buffer) - _MARK_SIZE + 1, position + 1), last + 1):
            if not self.final and mark.startswith(bytes(buffer[at:])):
                return -1
        return None

    def _check_follower(
        self,
        buffer: bytes | bytearray,
        position: int,
        header: Header,
        sizes: tuple[int, ...],
        reason: str,
    ) -> FrameResult:
        """Accept the first of `sizes` (ascending) that leads to a valid header."""
        left = len(buffer) - position
        for size in sizes:
            if left >= size + HEADER.size:
                if self._is_good_header(read_header(buffer, position + size), header.source_id):
                    return Accept(header, size, proven=False)
            elif not self.final:
                return NeedMore(size + HEADER.size)
            elif left >= size and _magic_prefix(buffer, position + size):
                return Accept(header, size, proven=False)
            elif left < size:
                reason = "truncated"
        return SkipBytes(reason)

    def _is_good_header(self, follower: Header, source_id: int) -> bool:
        if self.synchronised:
            return header_fault(follower, strict=False) is None
        return header_fault(follower, strict=True) is None and follower.source_id == source_id


_BAD_MAGIC: Final = SkipBytes("bad_magic")


def _magic_prefix(buffer: bytes | bytearray, position: int) -> bool:
    """Return whether the available bytes of the next header (maybe none) can start a message."""
    return MAGIC_BYTES.startswith(bytes(buffer[position : position + len(MAGIC_BYTES)]))


def _followed_by_header(buffer: bytes | bytearray, start: int, end: int) -> bool:
    """Return whether the bytes after a message can start another message, even a damaged one.

    A header similar to the message's own header also confirms the end. So a changed byte in a
    header does not make the preceding message unconfirmed.
    """
    if len(buffer) - end < HEADER.size:
        return _magic_prefix(buffer, end)
    if header_fault(read_header(buffer, end), strict=False) is None:
        return True
    own, follower = buffer[start : start + _STABLE_SIZE], buffer[end : end + _STABLE_SIZE]
    return (
        sum(a == b for a, b in zip(own, follower, strict=True)) >= _STABLE_SIZE - _MAX_CHANGED_BYTES
    )


def _ping_starts_at(buffer: bytes | bytearray, position: int) -> bool | None:
    """Return whether a ping with a valid header starts here; None if there are too few bytes."""
    left = len(buffer) - position
    if left < HEADER.size:
        return None
    if buffer[position + _ID_OFFSET] != _PING_ID:  # the common case, tested first
        return False
    header = read_header(buffer, position)
    layout = ping_result_layout(header.version)
    if (
        layout is None
        or header.message_id != _PING_ID
        or header_fault(header, strict=True) is not None
    ):
        return False
    if left < layout.size:
        return None
    return _body_size(buffer, position, header.version) == header.size


_SIZE_OFFSETS: Final = {
    version: (layout.size, layout.offset_of("beams"), layout.offset_of("image_offset"))
    for version, layout in ((0, PING_RESULT_V1), (1, PING_RESULT_V1), (2, PING_RESULT_V2))
}


def _body_size(buffer: bytes | bytearray, position: int, version: int) -> int | None:
    """Return the size stated in a ping's body, None if table, image and message size contradict.

    The body size is consistent and equal to the header's size if all three sizes agree.
    """
    fixed, beams_at, sizes_at = _SIZE_OFFSETS[version]
    (beams,) = _U16.unpack_from(buffer, position + beams_at)
    image_offset, image_size, message_size = _SIZES.unpack_from(buffer, position + sizes_at)
    if image_offset + image_size != message_size or image_offset < fixed + 2 * beams:
        return None
    return int(message_size) if message_size <= MAX_MESSAGE_SIZE else None
