"""Write formats that hold whole messages of one sonar: raw streams and Oculus Viewer logs."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO, Final, Protocol

from oculus_driver.recording.chunk import OCULUS, Chunk
from oculus_driver.recording.oculus_log_records import (
    FILE_HEADER,
    ITEM_HEADER,
    MESSAGE_ITEM,
    NS_PER_S,
    STAMP,
    STAMP_ITEM,
)
from oculus_driver.stream import Message, StreamParser

if TYPE_CHECKING:
    from collections import Counter

_SONAR_ITEM_VERSION: Final = 0
_OTHER_ITEM_VERSION: Final = 2


class MessageFormat(Protocol):
    """How one message is written."""

    def write(self, file: BinaryIO, message: Message) -> None:
        """Write a message behind those before it."""
        ...

    def finish(self, file: BinaryIO) -> None:
        """Write what belongs to a file without any message."""
        ...


class MessageSink:
    """Takes the chunks of a recording and writes the messages of its first sonar.

    Bytes that belong to no message are left out, and so are all other links.

    Attributes:
        messages: written so far.
    """

    def __init__(self, file: BinaryIO, left_out: Counter[str], form: MessageFormat) -> None:
        self.messages = 0
        self._file = file
        self._left_out = left_out
        self._form = form
        self._parser = StreamParser(confirm=True)
        self._link: str | None = None

    def put(self, chunk: Chunk) -> None:
        """Write the messages that a chunk completes."""
        if chunk.encoding == OCULUS and self._link in (None, chunk.link):
            self._link = chunk.link
            gap = chunk.gap_before
            self._write(self._parser.feed(chunk.data, chunk.arrival_ns, gap_before=gap))
        else:
            self._left_out["other_link"] += len(chunk.data)

    def finish(self) -> None:
        """Write the last message."""
        self._write(self._parser.finish())
        self._form.finish(self._file)
        if self._parser.counters.bytes_rejected:
            self._left_out["no_message"] += self._parser.counters.bytes_rejected

    def _write(self, messages: list[Message]) -> None:
        for message in messages:
            self._form.write(self._file, message)
        self.messages += len(messages)


class RawFormat:
    """Messages back to back, without stamps."""

    def write(self, file: BinaryIO, message: Message) -> None:
        """Write the message's bytes."""
        file.write(message.data)

    def finish(self, file: BinaryIO) -> None:
        """Write nothing: an empty stream is an empty file."""


class LogFormat:
    """An `.oculus` log of version 1: vendor's items, each with ENSTA's stamp item behind it.

    The stamp items keep nanoseconds; readers that do not know them skip them by their size.
    """

    def __init__(self) -> None:
        self._begun = False

    def write(self, file: BinaryIO, message: Message) -> None:
        """Write the message and, if it has one, its stamp."""
        stamp_ns = message.arrival_ns or 0
        self._begin(file, stamp_ns)
        self._item(file, MESSAGE_ITEM, _SONAR_ITEM_VERSION, stamp_ns, message.data)
        if stamp_ns:
            seconds, rest_ns = divmod(stamp_ns, NS_PER_S)
            stamp = STAMP.pack({"s": seconds, "ns": rest_ns})
            self._item(file, STAMP_ITEM, _OTHER_ITEM_VERSION, stamp_ns, stamp)

    def finish(self, file: BinaryIO) -> None:
        """Write the header if no message did."""
        self._begin(file, 0)

    def _begin(self, file: BinaryIO, stamp_ns: int) -> None:
        if not self._begun:
            self._begun = True
            created_s = round(stamp_ns / NS_PER_S, 3)
            file.write(FILE_HEADER.pack({"created_unix_s": created_s}))

    def _item(self, file: BinaryIO, kind: int, version: int, stamp_ns: int, payload: bytes) -> None:
        head = ITEM_HEADER.pack(
            {
                "kind": kind,
                "version": version,
                "unix_s": stamp_ns / NS_PER_S,
                "original_size": len(payload),
                "payload_size": len(payload),
            }
        )
        file.write(head + payload)
