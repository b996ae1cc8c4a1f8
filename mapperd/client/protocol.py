"""What a client hears and says on its connections: bytes in, bytes out; no sockets, no clocks."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from mapperd.client.errors import AskError
from mapperd.client.line import Line
from mapperd.client.state import Knowledge
from mapperd.wire.framing import StreamError, framed, server_inbox
from mapperd.wire.messages import (
    MAX_FROM_CLIENT,
    VERSION,
    WANTS,
    Answer,
    Ask,
    Bye,
    Change,
    FromServer,
    Hello,
    Interest,
    Resume,
    Status,
    Want,
    Welcome,
)

__all__ = ["Dialogue", "Wishes"]


@dataclasses.dataclass(frozen=True, slots=True)
class Wishes:
    """What a client would like to be told.

    Attributes:
        wants: kinds of messages.
        interest: in the map.
        bytes_per_s: at most; 0 leaves it to the link.
        name: of the program, for people.

    Raises:
        ValueError: nothing of the kind can be told.
    """

    wants: tuple[Want, ...]
    interest: Interest
    bytes_per_s: int = 0
    name: str = ""

    def __post_init__(self) -> None:
        if strange := set(self.wants) - set(WANTS):
            raise ValueError(f"{', '.join(sorted(strange))}: allowed: {', '.join(WANTS)}")
        try:
            server_inbox().feed(framed(self.hello("", None, None)))
        except StreamError as error:
            raise ValueError(str(error)) from error

    def hello(self, proof: str, resume: Resume | None, events_since: int | None) -> Hello:
        """The first message."""
        return Hello(
            version=VERSION,
            proof=proof,
            name=self.name,
            wants=[want for want in WANTS if want in self.wants],
            interest=self.interest,
            bytes_per_s=self.bytes_per_s,
            resume=resume,
            events_since=events_since,
        )


class Dialogue(Line):
    """One client, through all its connections.

    Args:
        wishes: of the first connection.
        knowledge: takes what is told.
        token: that the daemon may ask for.
        answered: is called with each answer.

    Attributes:
        wishes: of now.
    """

    def __init__(
        self,
        wishes: Wishes,
        knowledge: Knowledge,
        token: bytes | None,
        answered: Callable[[Answer], None],
    ) -> None:
        super().__init__(token)
        self.wishes = wishes
        self._knowledge = knowledge
        self._answered = answered
        self.begin()

    def begin(self) -> None:
        """A connection is there; what is known stays until the daemon says otherwise."""
        self._begin_line()
        self._is_second_advised = False
        self._resume: Resume | None = None
        self._knowledge.wants_map = "map" in self.wishes.wants
        self.end()

    def end(self) -> None:
        """The connection is gone; what is known stays."""
        self.is_welcome = False
        self._knowledge.is_complete = False

    @property
    def wants_second(self) -> bool:
        """A second line would bring the map sooner."""
        wants_map = self.is_welcome and "map" in self.wishes.wants
        return wants_map and self._is_second_advised and self._knowledge.ticket != ""

    def receive(self, data: bytes) -> None:
        """Take what came in; changes and answers are told on the way.

        Raises:
            StreamError: it is nothing that a daemon may say; an `EndedError` if it says good-bye.
        """
        super().receive(data)
        if self.is_welcome:
            self._knowledge.used = self._inbox.received

    def ask(self, number: int, do: str, fields: Mapping[str, Any]) -> None:
        """Have something asked by the next `outgoing`.

        Raises:
            AskError: `too_long`, or `bad_request`: that cannot be said.
        """
        try:
            request = msgspec.msgpack.encode({**fields, "do": do, "id": number})
        except (TypeError, OverflowError, RecursionError) as error:
            raise AskError("bad_request", f"that cannot be asked: {error}") from error
        said = framed(Ask(ask=msgspec.Raw(request)))
        if len(said) > MAX_FROM_CLIENT:
            raise AskError("too_long", f"a request of {len(said)} bytes")
        self._outgoing += said

    def change(self, wishes: Wishes) -> None:
        """Wish for something else."""
        before, self.wishes = self.wishes, wishes
        is_other = wishes.interest != before.interest
        self._knowledge.interest = wishes.interest
        if not self.is_welcome or wishes == before:
            return
        self._knowledge.wants_map |= "map" in wishes.wants
        self._knowledge.is_complete &= not is_other
        self._say(
            Change(
                wants=list(wishes.wants) if wishes.wants != before.wants else None,
                interest=wishes.interest if is_other else None,
                bytes_per_s=(
                    wishes.bytes_per_s if wishes.bytes_per_s != before.bytes_per_s else None
                ),
            )
        )

    def _take(self, message: FromServer) -> None:
        if isinstance(message, Bye) and message.reason == "bad_message":
            self._knowledge.forget_ticket()  # a daemon of before knows none
        super()._take(message)

    def _hello(self, proof: str) -> Hello:
        if "map" in self.wishes.wants:
            self._resume = self._knowledge.resume()
        return self.wishes.hello(proof, self._resume, self._knowledge.last_event)

    def _begin(self, welcome: Welcome) -> None:
        self._knowledge.begin(welcome, self._resume)

    def _take_news(self, message: FromServer) -> None:
        if isinstance(message, Answer):
            self._answered(message)
            return
        self._knowledge.take(message)
        if isinstance(message, Status):
            self._is_second_advised = message.link.get("second_line") is True
