"""A client's side of the map stream: bytes in, bytes out; no sockets, no clocks."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from mapperd.client.errors import AskError, EndedError
from mapperd.client.state import Knowledge
from mapperd.wire.auth import proof_of
from mapperd.wire.framing import StreamError, client_inbox, framed, server_inbox
from mapperd.wire.messages import (
    MAX_FROM_CLIENT,
    VERSION,
    WANTS,
    Ack,
    Answer,
    Ask,
    Bye,
    Change,
    FromClient,
    FromServer,
    Greeting,
    Hello,
    Interest,
    Resume,
    Status,
    Want,
    Welcome,
)

__all__ = ["Dialogue", "Line", "Wishes"]

STREAM = "map stream"


class Line(ABC):
    """Greeting and hello, welcome, acknowledgements and good-bye.

    Args:
        token: that the daemon may ask for.

    Attributes:
        is_greeted: the daemon has said something on this connection, or on the one that ended.
        is_welcome: the connection has come about.
    """

    def __init__(self, token: bytes | None) -> None:
        self._token = token
        self._begin_line()

    def _begin_line(self) -> None:
        """A connection is there."""
        self._inbox = client_inbox()
        self._acknowledged = 0
        self._outgoing = bytearray()
        self.is_greeted = False
        self.is_welcome = False

    def receive(self, data: bytes) -> None:
        """Take what came in; what it changes is told on the way.

        Raises:
            StreamError: it is nothing that a daemon may say; an `EndedError` if it says good-bye.
        """
        for message in self._inbox.feed(data):
            self._take(message)

    def outgoing(self, *, acknowledge: bool = True) -> bytes:
        """What is to be sent now, once."""
        if acknowledge and self.is_welcome and self._inbox.received > self._acknowledged:
            self._acknowledged = self._inbox.received
            self._say(Ack(bytes=self._acknowledged))
        said = bytes(self._outgoing)
        self._outgoing.clear()
        return said

    @abstractmethod
    def _hello(self, proof: str) -> Hello:
        """The first message of ours."""

    @abstractmethod
    def _begin(self, welcome: Welcome) -> None:
        """The connection has come about."""

    @abstractmethod
    def _take_news(self, message: FromServer) -> None:
        """Take what is told after the welcome."""

    def _say(self, message: FromClient) -> None:
        self._outgoing += framed(message)

    def _take(self, message: FromServer) -> None:
        if isinstance(message, Bye):
            raise EndedError(message.message or message.reason, message.reason)
        if isinstance(message, Greeting):
            self._take_greeting(message)
        elif isinstance(message, Welcome):
            self._take_welcome(message)
        elif not self.is_welcome:
            raise StreamError("news before a welcome", "bad_order")
        else:
            self._take_news(message)

    def _take_greeting(self, greeting: Greeting) -> None:
        if self.is_greeted:
            raise StreamError("a second greeting", "bad_order")
        self.is_greeted = True
        if greeting.mapperd != STREAM:
            raise EndedError(f"this is no {STREAM} but a {greeting.mapperd!r:.50}", "bad_version")
        if VERSION not in greeting.versions:
            spoken = ", ".join(map(str, greeting.versions[:10]))
            raise EndedError(f"the daemon speaks versions {spoken}, not {VERSION}", "bad_version")
        proof = ""
        if greeting.challenge:
            if self._token is None:
                raise EndedError("the daemon wants a token", "needs_token")
            proof = proof_of(self._token, greeting.challenge)
        self._say(self._hello(proof))

    def _take_welcome(self, welcome: Welcome) -> None:
        if not self.is_greeted or self.is_welcome:
            raise StreamError("a welcome out of turn", "bad_order")
        if welcome.version != VERSION:
            raise StreamError(f"a welcome to version {welcome.version}", "bad_version")
        self._begin(welcome)
        self.is_welcome = True


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
