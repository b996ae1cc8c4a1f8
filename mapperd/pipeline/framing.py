"""Frames the bytes of a link, or adopts the messages that the sonar's driver found in them.

A live session must map what a replay of its recording maps, and the replay frames the recorded
bytes. The driver frames the same bytes with the same parser. So its messages are adopted while
both parsers are in the same state. They are not after a gap: the driver takes a new connection for
the start of a message, where a replay resynchronises, and it does not know which bytes are skipped.
Then the bytes are framed here until both parsers have come to the same state again.
"""

from dataclasses import replace

from oculus_driver.stream import (
    Framing,
    Message,
    StreamCounters,
    StreamParser,
    StreamParserState,
)

__all__ = ["LinkParser"]

MAX_PIECES = 4096
"""Maximum number of unparsed pieces; more are parsed, since each needs memory of its own."""


class LinkParser:
    """A `StreamParser` that parses late, or not at all; its messages and states are the same.

    Args:
        confirm: as of `StreamParser`; then no messages are adopted.
    """

    def __init__(self, *, confirm: bool = False) -> None:
        self._parser = StreamParser(confirm=confirm)
        self._confirm = confirm
        self._unparsed: list[tuple[bytes, int | None]] = []  # no message ends in them
        self._unparsed_bytes = 0
        # Offset of the driver's next bytes; None: its parser may be in another state.
        self._next: int | None = None
        self._shift = 0  # from the driver's offsets to those of this parser

    @property
    def counters(self) -> StreamCounters:
        """Counters of all bytes so far."""
        self._catch_up()
        return self._parser.counters

    def state(self) -> StreamParserState:
        """Return the state of a `StreamParser` that was fed all bytes."""
        self._catch_up()
        return self._parser.state()

    def restore(self, state: StreamParserState) -> None:
        """Continue as the parser of which `state` was taken, before the first bytes."""
        self._parser.restore(state)

    def feed(
        self,
        data: bytes,
        arrival_ns: int | None,
        *,
        gap_before: bool = False,
        framing: Framing | None = None,
    ) -> list[Message]:
        """Return the messages that the next bytes complete.

        Args:
            data: the next bytes.
            arrival_ns: their arrival time.
            gap_before: bytes in front of them are missing.
            framing: what the driver found in them; None if they did not come from it.
        """
        if framing is not None and self._next == framing.begin and not gap_before:
            messages = self._adopt(data, arrival_ns, framing)
            if messages is not None:
                self._next += len(data)
                return messages
        messages = self._catch_up()
        messages += self._parser.feed(data, arrival_ns, gap_before=gap_before)
        self._next = None
        if framing is not None and self._agrees(framing, len(data)):
            self._next = framing.begin + len(data)
            self._shift = self._parser.counters.bytes_total - self._next
        return messages

    def finish(self) -> list[Message]:
        """Return the pending messages at the end of the stream."""
        self._next = None
        return self._catch_up() + self._parser.finish()

    def _agrees(self, framing: Framing, size: int) -> bool:
        """Return whether the driver's parser is in the same state after these bytes.

        A synchronised parser depends on its pending bytes alone. They are the same if they are as
        many, and all of these last bytes.
        """
        parser, end = self._parser, framing.bounds.end
        return (
            not self._confirm
            and end >= 0
            and parser.pending_bytes == size - end
            and parser.synchronised
            and framing.synchronised
            and parser.source_id == framing.source_id
        )

    def _adopt(self, data: bytes, arrival_ns: int | None, framing: Framing) -> list[Message] | None:
        """Return what the driver found in the next bytes; None: they must be parsed here.

        Both parsers were in the same state before these bytes, so they are afterwards. A connection
        that ended without a gap here is no exception: the driver has forgotten the pending bytes,
        so with any the sizes do not fit.
        """
        end = framing.bounds.end
        parsed = self._parser.pending_bytes + self._unparsed_bytes + end
        if not framing.synchronised or (parsed and end < 0) or len(self._unparsed) >= MAX_PIECES:
            return None
        if not parsed:
            self._unparsed.append((data, arrival_ns))
            self._unparsed_bytes += len(data)
            return []
        pieces = [(len(piece), at_ns) for piece, at_ns in self._unparsed]
        if not self._parser.adopt([*pieces, (end, arrival_ns)], framing.messages):
            return None
        self._unparsed = [(data[end:], arrival_ns)] if end < len(data) else []
        self._unparsed_bytes = len(data) - end
        return [self._shifted(one) for one in framing.messages]

    def _shifted(self, message: Message) -> Message:
        return replace(message, offset=message.offset + self._shift) if self._shift else message

    def _catch_up(self) -> list[Message]:
        """Parse all bytes so far; no message ends in them."""
        pieces, self._unparsed, self._unparsed_bytes = self._unparsed, [], 0
        return [one for piece, at_ns in pieces for one in self._parser.feed(piece, at_ns)]
