"""The client's side of the protocol: bytes in, bytes out, without sockets and clocks."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from mapperd.client.state import ClientState
from mapperd.client.validation import AskError, EndedError
from mapperd.wire.auth import proof_of
from mapperd.wire.framing import StreamError, client_inbox, framed, server_inbox
from mapperd.wire.messages import (
    MAX_FROM_CLIENT,
    PROTOCOL,
    VERSION,
    WANTS,
    AckMessage,
    AnswerMessage,
    AskMessage,
    ByeMessage,
    ChangeMessage,
    FromClient,
    FromServer,
    GreetingMessage,
    HelloMessage,
    Interest,
    Resume,
    Want,
    WelcomeMessage,
)

__all__ = ["ClientProtocol", "StreamOptions"]


@dataclasses.dataclass(frozen=True, slots=True)
class StreamOptions:
    """What a client requests.

    Attributes:
        wants: kinds of messages.
        interest: part of the map.
        bytes_per_s: limit of the rate; 0 has no limit.
        name: of the program, for people.

    Raises:
        ValueError: a value is not allowed.
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

    def hello(self, proof: str, resume: Resume | None, events_since: int | None) -> HelloMessage:
        """Return the first message."""
        return HelloMessage(
            version=VERSION,
            proof=proof,
            name=self.name,
            wants=[want for want in WANTS if want in self.wants],
            interest=self.interest,
            bytes_per_s=self.bytes_per_s,
            resume=resume,
            events_since=events_since,
        )


class ClientProtocol:
    """The protocol of one client, through all its connections.

    Args:
        options: of the first connection.
        client_state: takes what the daemon sends.
        token: for a daemon that requires one.
        answered: called with each answer.

    Attributes:
        options: the current ones.
        is_greeted: the daemon has sent something on this connection, or on the one that ended.
        is_welcome: the connection is established.
    """

    def __init__(
        self,
        options: StreamOptions,
        client_state: ClientState,
        token: bytes | None,
        answered: Callable[[AnswerMessage], None],
    ) -> None:
        self.options = options
        self._client_state = client_state
        self._token = token
        self._answered = answered
        self.begin()

    def begin(self) -> None:
        """Begin a connection; the state stays until the daemon changes it."""
        self._inbox = client_inbox()
        self._acknowledged = 0
        self._outgoing = bytearray()
        self.is_greeted = False
        self._resume: Resume | None = None
        self._client_state.wants_map = "map" in self.options.wants
        self.end()

    def end(self) -> None:
        """End the connection; the state stays."""
        self.is_welcome = False
        self._client_state.is_complete = False

    def receive(self, data: bytes) -> None:
        """Take received bytes; changes and answers are reported on the way.

        Raises:
            StreamError: the daemon may not send that; an `EndedError` if it ends the connection.
        """
        for message in self._inbox.feed(data):
            self._take(message)
        if self.is_welcome:
            self._client_state.used = self._inbox.received

    def outgoing(self, *, acknowledge: bool = True) -> bytes:
        """Return the bytes to send, and remove them."""
        if acknowledge and self.is_welcome and self._inbox.received > self._acknowledged:
            self._acknowledged = self._inbox.received
            self._send(AckMessage(bytes=self._acknowledged))
        data = bytes(self._outgoing)
        self._outgoing.clear()
        return data

    def ask(self, number: int, do: str, fields: Mapping[str, Any]) -> None:
        """Add a request to the next `outgoing`.

        Raises:
            AskError: `too_long`, or `bad_request`: it cannot be encoded.
        """
        try:
            request = msgspec.msgpack.encode({**fields, "do": do, "id": number})
        except (TypeError, OverflowError, RecursionError) as error:
            raise AskError("bad_request", f"the request cannot be encoded: {error}") from error
        frame = framed(AskMessage(ask=msgspec.Raw(request)))
        if len(frame) > MAX_FROM_CLIENT:
            raise AskError("too_long", f"a request of {len(frame)} bytes")
        self._outgoing += frame

    def change(self, options: StreamOptions) -> None:
        """Change the options."""
        before, self.options = self.options, options
        is_other = options.interest != before.interest
        self._client_state.interest = options.interest
        if not self.is_welcome or options == before:
            return
        self._client_state.wants_map |= "map" in options.wants
        self._client_state.is_complete &= not is_other
        self._send(
            ChangeMessage(
                wants=list(options.wants) if options.wants != before.wants else None,
                interest=options.interest if is_other else None,
                bytes_per_s=(
                    options.bytes_per_s if options.bytes_per_s != before.bytes_per_s else None
                ),
            )
        )

    def _send(self, message: FromClient) -> None:
        self._outgoing += framed(message)

    def _take(self, message: FromServer) -> None:
        if isinstance(message, ByeMessage):
            if message.reason == "bad_message":
                self._client_state.forget_ticket()  # earlier daemons do not know tickets
            raise EndedError(message.message or message.reason, message.reason)
        if isinstance(message, GreetingMessage):
            self._take_greeting(message)
        elif isinstance(message, WelcomeMessage):
            self._take_welcome(message)
        elif not self.is_welcome:
            raise StreamError("a message before the welcome", "bad_order")
        elif isinstance(message, AnswerMessage):
            self._answered(message)
        else:
            self._client_state.take(message)

    def _take_greeting(self, greeting: GreetingMessage) -> None:
        if self.is_greeted:
            raise StreamError("a second greeting", "bad_order")
        self.is_greeted = True
        if greeting.mapperd != PROTOCOL:
            raise EndedError(
                f"the server is not a {PROTOCOL}: {greeting.mapperd!r:.50}", "bad_version"
            )
        if VERSION not in greeting.versions:
            versions = ", ".join(map(str, greeting.versions[:10]))
            raise EndedError(
                f"the daemon supports versions {versions}, not {VERSION}", "bad_version"
            )
        proof = ""
        if greeting.challenge:
            if self._token is None:
                raise EndedError("the daemon requires a token", "needs_token")
            proof = proof_of(self._token, greeting.challenge)
        if "map" in self.options.wants:
            self._resume = self._client_state.resume()
        self._send(self.options.hello(proof, self._resume, self._client_state.last_event))

    def _take_welcome(self, welcome: WelcomeMessage) -> None:
        if not self.is_greeted or self.is_welcome:
            raise StreamError("an unexpected welcome", "bad_order")
        if welcome.version != VERSION:
            raise StreamError(f"a welcome with version {welcome.version}", "bad_version")
        self._client_state.begin(welcome, self._resume)
        self.is_welcome = True
