"""Is this a message, and where does it end? Pure verdicts on one place of a byte stream.

A ping says its size three times: in the header, as message size in the body, and as end of the
image. Where the three agree it is believed. Where they do not, and for ids that nobody
knows, the bytes after it decide: a message is one that is followed by another good header. With
two sizes to choose from (header and body) the one that leads to a good header wins, so a
damaged size costs one ping and never the pings behind it.

Sizes agree also where bytes are missing inside: then the ping reaches into the next one. So a
ping is refused if no header follows it and another ping, of the same sonar, begins inside it.
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

# Small and frequent: believed at once while synchronised, so that a sign of life is not held back.
_PLAIN_IDS: Final = frozenset(
    {MessageId.FIRE, MessageId.USER_CONFIG, MessageId.LOG, MessageId.DUMMY}
)

CANDIDATE: Final = re.compile(
    rb"SO.{4}[\x15\x22\x23\x55\x80\xff]\x00[\x00-\x02]\x00.{3}[\x00\x01]", re.DOTALL
)
"""Start of a header with a known id, version and a payload below 32 MiB, found at C speed."""

CANDIDATE_SIZE: Final = 14

_ID_OFFSET: Final = 6
_PING_ID: Final = int(MessageId.PING_RESULT)

_MARK_SIZE: Final = 4
"""Magic and source id: how all messages of one sonar begin."""

_STABLE_SIZE: Final = 10
"""Bytes of a header that seldom differ from one message to the next: all before the size."""

_MAX_CHANGED_BYTES: Final = 2
"""Of these, how many may be changed in a header that is still known as one."""


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
        """Bytes of the whole message, as the header claims."""
        return HEADER.size + self.payload_size


@dataclass(frozen=True, slots=True)
class Accept:
    """A message of `size` bytes starts here.

    Attributes:
        header: of the message.
        size: of the message.
        proven: its own sizes agree.
        confirmed: nothing behind it speaks against its end, or nobody asked.
    """

    header: Header
    size: int
    proven: bool
    confirmed: bool = True


@dataclass(frozen=True, slots=True)
class Skip:
    """No message starts here, or none that can be told from noise; go on `skip` bytes later."""

    reason: str
    skip: int = 1


@dataclass(frozen=True, slots=True)
class NeedMore:
    """No check before `size` bytes from here have come."""

    size: int


FrameResult = Accept | Skip | NeedMore


def read_header(buffer: bytes | bytearray, position: int) -> Header:
    """Return the header at `position`; 16 bytes must be there."""
    return Header._make(_HEADER.unpack_from(buffer, position))


def header_fault(header: Header, *, strict: bool) -> str | None:
    """Return why the header is not plausible, or None.

    Args:
        header: what stands there.
        strict: only known ids, versions and sizes, as demanded while resynchronising.
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
    """What is known when a place in the stream is judged.

    Attributes:
        synchronised: the place is where the last message ended.
        source_id: the sonar's id, or None before the first good ping.
        final: no more bytes will come.
        confirm: wait for the header behind a ping whose sizes agree.
    """

    synchronised: bool
    source_id: int | None
    final: bool
    confirm: bool = False

    def check(self, buffer: bytes | bytearray, position: int) -> FrameResult:
        """Return what stands at `position`.

        Takes constant time, whatever the sizes claimed; but for a ping whose sizes agree and
        whose bytes are there, time in proportion to the bytes that its check settles.
        """
        left = len(buffer) - position
        if left < HEADER.size:
            return self._need_more(HEADER.size) if _magic_prefix(buffer, position) else _BAD_MAGIC
        header = read_header(buffer, position)
        fault = header_fault(header, strict=not self.synchronised)
        if fault is not None:
            return Skip(fault)
        if header.message_id == MessageId.PING_RESULT:
            return self._check_ping(buffer, position, header)
        if self.synchronised and header.message_id in _PLAIN_IDS:
            return self._check_plain(buffer, position, header)
        reason = "truncated" if header.message_id in PAYLOAD_LIMITS else "unknown_id"
        return self._check_follower(buffer, position, header, (header.size,), reason)

    def _need_more(self, size: int) -> FrameResult:
        return Skip("truncated") if self.final else NeedMore(size)

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
        """Check a ping whose sizes agree; one that may hold another is not believed at once."""
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
        """Check a ping whose sizes agree, but behind which nothing or no message stands."""
        size = header.size
        last = len(buffer) - position == size
        inside = self._find_inner_ping(buffer, position, size)
        if inside is None:
            return Accept(header, size, proven=True, confirmed=last or not self.confirm)
        if inside < 0:
            return NeedMore(size + PING_RESULT_V2.size)
        if last:
            return Accept(header, size, proven=True, confirmed=False)
        return Skip("bytes_missing", inside - position)

    def _find_inner_ping(self, buffer: bytes | bytearray, position: int, size: int) -> int | None:
        """Return where another ping of this sonar starts in a ping, or None; -1 if yet unknown.

        A last byte alone that could start one tells nothing. It counts only while confirming, as
        otherwise one ping in 256 would have to wait.
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
        """Accept the first of `sizes` (ascending) behind which a good header stands."""
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
        return Skip(reason)

    def _is_good_header(self, follower: Header, source_id: int) -> bool:
        if self.synchronised:
            return header_fault(follower, strict=False) is None
        return header_fault(follower, strict=True) is None and follower.source_id == source_id


_BAD_MAGIC: Final = Skip("bad_magic")


def _magic_prefix(buffer: bytes | bytearray, position: int) -> bool:
    """Tell whether what is there of the next header (perhaps nothing) can begin a message."""
    return MAGIC_BYTES.startswith(bytes(buffer[position : position + len(MAGIC_BYTES)]))


def _followed_by_header(buffer: bytes | bytearray, start: int, end: int) -> bool:
    """Tell whether the bytes behind a message can begin another one, be it damaged.

    A header that resembles the message's own confirms the end too: so a changed byte in a header
    casts no doubt on the message before.
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
    """Tell whether a ping with a strictly good head starts here; None if too few bytes are here."""
    left = len(buffer) - position
    if left < HEADER.size:
        return None
    if buffer[position + _ID_OFFSET] != _PING_ID:  # most often so, and quickly seen
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
    """Return the size that a ping's body states, if table, image and size agree with each other.

    Together with equality to the header's size these are the three size identities.
    """
    fixed, beams_at, sizes_at = _SIZE_OFFSETS[version]
    (beams,) = _U16.unpack_from(buffer, position + beams_at)
    image_offset, image_size, message_size = _SIZES.unpack_from(buffer, position + sizes_at)
    if image_offset + image_size != message_size or image_offset < fixed + 2 * beams:
        return None
    return int(message_size) if message_size <= MAX_MESSAGE_SIZE else None
