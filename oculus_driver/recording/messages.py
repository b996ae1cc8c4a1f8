"""The messages in a recording's chunks, each link read as the stream that it is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from oculus_driver.stream import Message, StreamParser

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from oculus_driver.recording import Chunk

_MAX_LINKS: Final = 64


def messages_of(chunks: Iterable[Chunk]) -> Iterator[Message]:
    """Yield the messages of all sonars in a recording; links beyond the 64th are passed over."""
    from oculus_driver.recording import OCULUS  # noqa: PLC0415 - needs more than numpy

    parsers: dict[str, StreamParser] = {}
    for chunk in chunks:
        if chunk.encoding != OCULUS:
            continue
        if chunk.link not in parsers and len(parsers) < _MAX_LINKS:
            parsers[chunk.link] = StreamParser(confirm=True)
        parser = parsers.get(chunk.link)
        if parser is not None:
            yield from parser.feed(chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before)
    for parser in parsers.values():
        yield from parser.finish()
