"""Messages that wait for the broker: bounded, and what goes first when there are too many."""

from collections import Counter, deque
from dataclasses import dataclass
from enum import IntEnum

__all__ = ["Kind", "Outbox", "QueuedMessage"]


class Kind(IntEnum):
    """What a message is worth; the first is dropped first."""

    TELEMETRY = 0
    """One of many, such as a pose: a newer one comes soon."""
    EVENT = 1
    ANSWER = 2
    """To somebody who waits for it."""
    STATE = 3
    """What is now: a newer one on the same topic takes its place, so they never pile up."""


@dataclass(frozen=True, slots=True)
class QueuedMessage:
    """One message to publish."""

    topic: str
    payload: bytes
    kind: Kind
    qos: int = 0
    retain: bool = False


class Outbox:
    """Holds what is not sent yet; used by one thread.

    Of states only the newest on each topic waits, and topics are few. Of everything else together
    there are at most `limit`; beyond, the oldest goes: of telemetry, where there is any, then of
    events, last of answers.

    Args:
        limit: messages.

    Attributes:
        dropped: kind to messages that were never sent.
        replaced: states that a newer one overtook.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._queues: dict[Kind, deque[QueuedMessage]] = {
            kind: deque() for kind in (Kind.TELEMETRY, Kind.EVENT, Kind.ANSWER)
        }
        self._states: dict[str, QueuedMessage] = {}
        self.dropped: Counter[Kind] = Counter()
        self.replaced = 0

    def __len__(self) -> int:
        return sum(map(len, self._queues.values())) + len(self._states)

    @property
    def room(self) -> int:
        """Events that fit without another one being dropped, even if one in flight comes back."""
        return self._limit - 1 - len(self._queues[Kind.EVENT]) - len(self._queues[Kind.ANSWER])

    def put(self, message: QueuedMessage) -> None:
        """Let a message wait; drops another one where there are too many."""
        if message.kind is Kind.STATE:
            self.replaced += self._states.pop(message.topic, None) is not None
            self._states[message.topic] = message
            return
        self._queues[message.kind].append(message)
        self._keep_bound()

    def put_back(self, message: QueuedMessage) -> None:
        """Let a message wait again that could not be sent, before all others of its kind."""
        if message.kind is Kind.STATE:
            newer = self._states.get(message.topic)
            self.replaced += newer is not None
            self._states = {message.topic: newer or message, **self._states}
            return
        self._queues[message.kind].appendleft(message)
        self._keep_bound()

    def take(self, *kinds: Kind) -> QueuedMessage | None:
        """The next message of the first of these kinds that has one."""
        for kind in kinds:
            if kind is Kind.STATE:
                if self._states:
                    return self._states.pop(next(iter(self._states)))
            elif self._queues[kind]:
                return self._queues[kind].popleft()
        return None

    def forget_what_passes(self) -> None:
        """Drop telemetry and states, which would be stale once a broker is back."""
        self.dropped[Kind.TELEMETRY] += len(self._queues[Kind.TELEMETRY])
        self._queues[Kind.TELEMETRY].clear()
        self._states.clear()

    def _keep_bound(self) -> None:
        while sum(map(len, self._queues.values())) > self._limit:
            kind = next(kind for kind in sorted(self._queues) if self._queues[kind])
            self._queues[kind].popleft()
            self.dropped[kind] += 1
