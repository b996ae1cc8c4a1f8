"""What is played: the messages of a recording, and how long to wait before each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from oculus_driver.recording.messages import messages_of
from oculus_driver.stream import Message, StreamParser
from oculus_driver.wire import MessageId, ping_layout

if TYPE_CHECKING:
    import os
    from collections.abc import Generator, Iterable, Iterator

TICK_NS: Final = 8
"""Length of a version-1 clock tick, inferred from captures at a known ping rate."""

LONGEST_WAIT_NS: Final = 10_000_000_000
"""Longer pauses of a recording are shortened to this."""

USUAL_WAIT_NS: Final = 100_000_000
"""Between pings whose times nobody knows: the sonar's own normal rate."""

_TICKS_WRAP: Final = 1 << 32


@dataclass(frozen=True, slots=True)
class Step:
    """One message and the wait since the message before it; 0 before the first."""

    message: Message
    wait_ns: int


class Track:
    """The messages that a sonar sent, in order; can be iterated again and again.

    Args:
        source: path of a recording of any kind, or whole messages.
    """

    def __init__(self, source: str | os.PathLike[str] | Sequence[bytes]) -> None:
        self._source = source

    def __iter__(self) -> Generator[Step, None, None]:
        last: Message | None = None
        for message in self._messages():
            if message.message_id == MessageId.FIRE:  # said by a client
                continue
            yield Step(message, 0 if last is None else _wait_ns(last, message))
            last = message

    def _messages(self) -> Iterator[Message]:
        if not isinstance(self._source, Sequence) or isinstance(self._source, str):
            return _recorded(self._source)
        return _parsed(self._source)


def _recorded(path: str | os.PathLike[str]) -> Iterator[Message]:
    from oculus_driver.recording import open_recording  # noqa: PLC0415 - needs more than numpy

    with open_recording(path) as recording:
        yield from messages_of(recording)


def _parsed(pieces: Iterable[bytes]) -> Iterator[Message]:
    parser = StreamParser(confirm=True)
    for data in pieces:
        yield from parser.feed(data)
    yield from parser.finish()


def _wait_ns(before: Message, after: Message) -> int:
    """Return the time between two messages: by arrival, else by the sonar's clock."""
    if before.arrival_ns is not None and after.arrival_ns is not None:
        wait_ns = after.arrival_ns - before.arrival_ns
    else:
        wait_ns = _device_wait_ns(before, after)
    return min(max(wait_ns, 0), LONGEST_WAIT_NS)


def _device_wait_ns(before: Message, after: Message) -> int:
    first, second = _device_time_ns(before), _device_time_ns(after)
    if after.message_id != MessageId.PING_RESULT:
        return 0
    if first is None or second is None or first[1] != second[1]:
        return USUAL_WAIT_NS
    wrap_ns = first[1]
    wait_ns = (second[0] - first[0]) % wrap_ns if wrap_ns else second[0] - first[0]
    return wait_ns if 0 <= wait_ns <= LONGEST_WAIT_NS else USUAL_WAIT_NS


def _device_time_ns(message: Message) -> tuple[int, int] | None:
    """Return the sonar's own time and after how long it wraps, 0 for never."""
    layout = ping_layout(message.version)
    if message.message_id != MessageId.PING_RESULT or layout is None:
        return None
    fields = layout.unpack(message.data)
    if "start_ticks" in fields:
        return fields["start_ticks"] * TICK_NS, _TICKS_WRAP * TICK_NS
    seconds = fields["start_time_s"]
    return (round(seconds * 1e9), 0) if 0.0 <= seconds < 1e9 else None  # noqa: PLR2004 - 30 years
