"""The connection to the broker, as the settings have it, and the bounded queue of messages for it.

aiomqtt belongs to the extra `mqtt`; it is imported only where a broker is named.
"""

import contextlib
import importlib.util
import logging
import ssl
from collections import Counter, deque
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from mapperd.config.paths import read_secret
from mapperd.config.tree import Config, MqttConfig
from mapperd.errors import ConfigError, missing_extra
from mapperd.telemetry.topics import Topics

if TYPE_CHECKING:
    from aiomqtt import Client

__all__ = [
    "Kind",
    "Outbox",
    "QueuedMessage",
    "check_telemetry",
    "connection",
]


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


CREDENTIAL = "mqtt-password"
TIMEOUT_S = 10.0
"""For the broker's answer to anything."""

MAX_INCOMING = 64

TAKEN = frozenset(
    (
        *("status", "state", "pose", "sonar", "map", "health", "event", "config", "cmd", "tf"),
        *("amcl_pose", "map_odom", "particle_cloud", "diagnostics", "changes"),
    )
)
"""Topics of ours, which robots cannot have."""


def check_telemetry(config: Config, environment: Mapping[str, str]) -> None:
    """Check that telemetry can run, where a broker is named.

    Args:
        config: the settings.
        environment: gives the systemd credentials directory.

    Raises:
        ConfigError: aiomqtt is not installed, a file cannot be read, there is a password without a
            user, or two things have one topic.
    """
    settings = config.mqtt
    if not settings.host:
        return
    if importlib.util.find_spec("aiomqtt") is None:
        raise ConfigError(f"mqtt.host: {missing_extra('aiomqtt', 'mqtt')}", "$.mqtt.host")
    if _password(settings, environment) is not None and not settings.username:
        raise ConfigError("mqtt.username: a password needs one", "$.mqtt.username")
    if settings.tls:
        _tls(settings)
    topic = config.robot_detection.topic
    if topic.lstrip("/").partition("/")[0] in TAKEN:
        path = "$.robot_detection.topic"
        raise ConfigError(
            f"{path}: {topic} is taken; allowed: not {', '.join(sorted(TAKEN))}", path
        )


@contextlib.asynccontextmanager
async def connection(
    settings: MqttConfig, environment: Mapping[str, str]
) -> AsyncIterator["Client"]:
    """A connection whose will publishes `offline` if it breaks.

    Args:
        settings: `check_telemetry` has passed them.
        environment: gives the systemd credentials directory.

    Raises:
        ConfigError: a file cannot be read any more.
        MqttError: there is no such broker, or it does not want us.
    """
    client, connected = _client(settings, environment), False
    try:
        async with client:
            connected = True
            yield client
    finally:
        if not connected:  # aiomqtt leaves the socket of a broker open that never answers
            with contextlib.suppress(Exception):
                await client.__aexit__(None, None, None)


def _client(settings: MqttConfig, environment: Mapping[str, str]) -> "Client":
    from aiomqtt import Client, Will  # noqa: PLC0415 an extra

    status = Topics.of(settings).of_name("status")
    return Client(
        settings.host,
        settings.port,
        identifier=f"{settings.vehicle}-mapper",
        username=settings.username or None,
        password=_password(settings, environment),
        will=Will(status, b"offline", qos=1, retain=True),
        clean_session=True,
        keepalive=settings.keepalive,
        timeout=TIMEOUT_S,
        max_queued_incoming_messages=MAX_INCOMING,
        tls_context=_tls(settings) if settings.tls else None,
        logger=_silent(),
    )


def _password(settings: MqttConfig, environment: Mapping[str, str]) -> str | None:
    return read_secret("mqtt.password_file", settings.password_file, CREDENTIAL, environment)


def _tls(settings: MqttConfig) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=settings.ca_file or None)
    except OSError as error:  # ssl.SSLError is one
        why = f"{settings.ca_file}: {error.strerror or error}"
        raise ConfigError(f"mqtt.ca_file: {why}", "$.mqtt.ca_file") from error


def _silent() -> logging.Logger:
    """Silences the library's logger: the link's state reports the same."""
    logger = logging.getLogger("mapperd.telemetry")
    logger.propagate = False
    logger.disabled = True
    return logger
