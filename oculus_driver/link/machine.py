"""State machine of the link to one sonar: events and times in, actions out.

searching ─▶ connecting ─▶ configuring ─▶ pinging ⇄ silent     standby: while requested
    ▲             │             │            └─────────┤
    └─────────────┴─ backing off ◀─────────────────────┘  (connection lost, or nothing received)

The module has no socket and reads no clock. The state is "pinging" only while pings arrive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from oculus_driver.back_off import BackOff
from oculus_driver.encode import encode_dummy
from oculus_driver.link.state import (
    SECOND_NS,
    Action,
    Connect,
    Disconnect,
    LinkState,
    LinkStatus,
    LinkTimeouts,
    Send,
)
from oculus_driver.wire import TCP_PORT, MessageId

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from oculus_driver.settings import FireSettings

    Timer = tuple[int, Callable[[int], list[Action]]]

_PREFERRED_VERSION: Final = 2
_FALLBACK: Final = {2: 1, 1: 2}
_LATE_STATUS_NS: Final = 3 * SECOND_NS
"""After this time a status is not from before the connection."""

_CONNECTED: Final = frozenset(
    {LinkState.CONFIGURING, LinkState.PINGING, LinkState.STANDBY, LinkState.SILENT}
)


class Link:
    """Decides what to do next. The owner of the socket executes the actions and reports events.

    Every method takes the host's monotonic time in nanoseconds and returns the actions to execute
    now, in order. Call `tick` at `deadline_ns`; an earlier call does no harm.

    Args:
        settings: requested settings of the sonar.
        address: of the sonar; None: wait for its status (`discovered`).
        version: of the fire messages; None: 2 with fallback to 1.
        times: timeouts.
        rng: source of random numbers from 0 to 1, for the retry delays.
    """

    def __init__(
        self,
        settings: FireSettings,
        *,
        rng: Callable[[], float],
        address: str | None = None,
        version: int | None = None,
        times: LinkTimeouts | None = None,
    ) -> None:
        self._settings = settings
        self._times = times or LinkTimeouts()
        self._back_off = BackOff(self._times.back_off_ns, rng)
        self._discovers = address is None
        self._target = address  # last known address of the sonar
        self._address: str | None = None  # address of the connection
        self._holder: str | None = None
        self._discovered_ns = 0
        self._local_addresses: set[str] = set()
        self._requested_version = version
        self._version = version or _PREFERRED_VERSION
        self._proven = False  # a ping arrived on this connection: the fire version works
        self._fell_back = False
        self._held: str | None = None
        self._state = LinkState.CLOSED
        self._since_ns = 0
        self._reason = "not started"
        self._retry_ns = 0
        self._expected_since_ns: int | None = None  # None: no ping expected
        self._received_ns = 0
        self._dummies = 0  # since the last ping or fire message
        self._triggered = False  # since the last settings
        self._sent_ns: int | None = None
        self._pending: bytes | None = None

    @property
    def status(self) -> LinkStatus:
        """The present status of the link."""
        address = self._address or self._target
        return LinkStatus(
            self._state,
            self._since_ns,
            self._reason,
            address,
            self._version,
            self._back_off.failures,
        )

    @property
    def deadline_ns(self) -> int | None:
        """When to call `tick`, None if only an event can change anything."""
        return min((due_ns for due_ns, _ in self._timers()), default=None)

    def tick(self, now_ns: int) -> list[Action]:
        """Execute all timers that are due."""
        actions: list[Action] = []
        while True:
            due = [timer for timer in self._timers() if timer[0] <= now_ns]
            if not due:
                return actions
            _, handler = min(due, key=lambda timer: timer[0])
            actions += handler(now_ns)

    def start(self, now_ns: int) -> list[Action]:
        """Start to search for the sonar, or to connect if its address is given."""
        if self._target is not None:
            return self._connect("address given", now_ns)
        self._enter(LinkState.SEARCHING, "no status received yet", now_ns)
        return []

    def discovered(self, address: str, now_ns: int, *, holder: str | None = None) -> list[Action]:
        """Handle a status of the sonar: its address and the connected client (None: nobody).

        Has no effect on a given address. A client that the sonar names while it pings for this
        link is this link, even under another address, as behind a router.
        """
        if not self._discovers:
            return []
        is_own = self._state is LinkState.PINGING and now_ns - self._since_ns > _LATE_STATUS_NS
        if is_own and holder is not None and address == self._address:
            self._local_addresses.add(holder)
        self._target, self._holder, self._discovered_ns = address, holder, now_ns
        if self._state is LinkState.SEARCHING:
            return self._connect_if_free("status received", now_ns)
        if address == self._address or self._state in (LinkState.CLOSED, LinkState.PINGING):
            return []
        return self._follow(now_ns)

    def connected(self, now_ns: int, local_address: str | None = None) -> list[Action]:
        """Continue after the connection was established; `local_address` is this host's address."""
        if local_address is not None:
            self._local_addresses.add(local_address)
        self._received_ns = now_ns
        self._sent_ns = self._pending = None
        self._proven = self._fell_back = False
        self._enter(LinkState.CONFIGURING, f"connected to {self._address}", now_ns)
        return self._send_settings(now_ns)

    def lost(self, reason: str, now_ns: int) -> list[Action]:
        """Handle the end of the connection, or of a connection attempt."""
        if self._state is LinkState.CLOSED:
            return []
        if not self._proven:
            self._version = self._requested_version or _PREFERRED_VERSION
        self._retry_ns = now_ns + round(self._back_off.failed())
        self._enter(LinkState.BACKING_OFF, reason, now_ns)
        return []

    def message_received(self, message_id: int, now_ns: int) -> None:
        """Handle a complete message of any kind: a sign of life."""
        self._received_ns = now_ns
        self._back_off.succeeded()
        self._dummies += message_id == MessageId.DUMMY

    def ping_received(self, now_ns: int) -> None:
        """Handle a valid ping, the only event that leads to state "pinging"."""
        self._proven = True
        self._dummies = 0
        self._expected_since_ns = None if self._settings.network_trigger else now_ns
        if self._state in (LinkState.CONFIGURING, LinkState.SILENT):
            self._enter(LinkState.PINGING, "pings arrive", now_ns)

    def apply(self, settings: FireSettings, now_ns: int) -> list[Action]:
        """Request other settings from now on."""
        self._settings = settings
        return self._send_settings(now_ns) if self._state in _CONNECTED else []

    def hold(self, reason: str | None, now_ns: int) -> list[Action]:
        """Keep the sonar in standby for a reason, regardless of the settings; None ends it."""
        if reason == self._held:
            return []
        self._held = reason
        return self._send_settings(now_ns) if self._state in _CONNECTED else []

    @property
    def has_unsent(self) -> bool:
        """Whether a message waits for the minimum gap between two messages; `tick` sends it."""
        return self._pending is not None

    @property
    def can_trigger(self) -> bool:
        """Whether `trigger` would fire: triggered mode, connected, not held, nothing unsent."""
        free = self._held is None and self._pending is None
        return free and self._state in _CONNECTED and self._settings.network_trigger

    def trigger(self, now_ns: int) -> list[Action]:
        """Fire once in triggered mode; does nothing unless `can_trigger`."""
        if not self.can_trigger:
            return []
        if self._state is LinkState.STANDBY:
            self._enter(LinkState.CONFIGURING, "first trigger sent, no ping yet", now_ns)
            self._expected_since_ns = now_ns
        elif self._expected_since_ns is None:
            self._expected_since_ns = now_ns
        self._triggered = True
        return self._send(self._encoded(self._settings), now_ns)

    def close(self, reason: str, now_ns: int) -> list[Action]:
        """Close the link. To leave the sonar in standby, `hold` it first."""
        active = self._state in _CONNECTED or self._state is LinkState.CONNECTING
        self._enter(LinkState.CLOSED, reason, now_ns)
        return [Disconnect(reason)] if active else []

    def abort_connection(self, reason: str, now_ns: int) -> list[Action]:
        """Abort the connection because of its content, and reconnect after a delay."""
        return [Disconnect(reason), *self.lost(reason, now_ns)]

    def postpone(self, pause_ns: int) -> None:
        """Do not count a time in which this program did not run: messages may wait to be read."""
        self._since_ns += pause_ns
        self._received_ns += pause_ns
        self._discovered_ns += pause_ns
        if self._expected_since_ns is not None:
            self._expected_since_ns += pause_ns

    # Timers.

    def _timers(self) -> Iterator[Timer]:
        yield from self._state_timers()
        if self._state in _CONNECTED and self._sent_ns is not None:
            yield from self._sending_timers(self._sent_ns)
        if self._discovers and self._state in (LinkState.SILENT, LinkState.STANDBY):
            last_ns = max(self._discovered_ns, self._received_ns)
            if self._state is LinkState.STANDBY:  # leave time to answer the request
                last_ns = max(last_ns, self._since_ns)
            yield last_ns + self._times.status_gone_ns, self._sonar_gone

    def _state_timers(self) -> Iterator[Timer]:
        times, expected_since_ns = self._times, self._expected_since_ns
        match self._state:
            case LinkState.CONNECTING:
                yield self._since_ns + times.connect_ns, self._connect_timed_out
            case LinkState.BACKING_OFF:
                yield self._retry_ns, self._retry
            case LinkState.CONFIGURING if expected_since_ns is not None:
                yield expected_since_ns + times.fallback_ns + self._period_ns, self._no_first_ping
            case LinkState.PINGING if expected_since_ns is not None:
                yield expected_since_ns + times.silence_ns + self._period_ns, self._pings_stopped
            case LinkState.SILENT:
                yield self._received_ns + times.reconnect_ns + self._period_ns, self._reconnect
            case LinkState.STANDBY if self._dummies:
                yield self._received_ns + times.reconnect_ns, self._reconnect

    def _sending_timers(self, sent_ns: int) -> Iterator[Timer]:
        if self._pending is not None:
            yield sent_ns + self._times.send_gap_ns, self._send_pending
        elif self._times.keep_alive_ns is not None:
            yield sent_ns + self._times.keep_alive_ns, self._keep_alive

    @property
    def _period_ns(self) -> int:
        """Maximum time of one ping; many seconds over a slow network."""
        return 0 if self._settings.standby else round(self._settings.max_period_s * SECOND_NS)

    def _connect_timed_out(self, now_ns: int) -> list[Action]:
        seconds = self._times.connect_ns / SECOND_NS
        return self.abort_connection(
            f"{self._address}:{TCP_PORT} did not answer within {seconds:g} s: check power and "
            "cable, and that this host has an address in the sonar's subnet",
            now_ns,
        )

    def _retry(self, now_ns: int) -> list[Action]:
        if self._target is None:  # pragma: no cover - "backing off" implies an address
            return self.start(now_ns)
        if not self._discovers:
            return self._connect("retry", now_ns)
        if now_ns - self._discovered_ns <= self._times.status_gone_ns:
            return self._connect_if_free("retry", now_ns)
        return self._sonar_gone(now_ns)

    def _no_first_ping(self, now_ns: int) -> list[Action]:
        seconds = self._times.fallback_ns / SECOND_NS
        fixed = self._requested_version is not None or self._settings.needs_version_2
        if self._proven or self._fell_back or fixed:
            reason = f"no ping within {seconds:g} s of fire messages of version {self._version}"
            self._enter(LinkState.SILENT, reason, now_ns)
            return []
        self._fell_back = True
        self._version = _FALLBACK[self._version]
        self._reason = f"no ping within {seconds:g} s: trying fire version {self._version}"
        self._expected_since_ns = now_ns
        return self._send(self._encoded(self._settings), now_ns)

    def _pings_stopped(self, now_ns: int) -> list[Action]:
        if self._discovers and self._target != self._address:
            return self._follow(now_ns)
        seconds = (now_ns - (self._expected_since_ns or now_ns)) / SECOND_NS
        why = "the sonar reports standby" if self._dummies else "and no other message"
        self._enter(LinkState.SILENT, f"no ping for {seconds:.1f} s, {why}", now_ns)
        return []

    def _reconnect(self, now_ns: int) -> list[Action]:
        seconds = (now_ns - self._received_ns) / SECOND_NS
        return self.abort_connection(f"no message from {self._address} for {seconds:.1f} s", now_ns)

    def _sonar_gone(self, now_ns: int) -> list[Action]:
        connected = self._state in _CONNECTED
        seconds = (now_ns - self._discovered_ns) / SECOND_NS
        reason = f"no status from {self._target} for {seconds:.1f} s: is the sonar powered?"
        self._enter(LinkState.SEARCHING, reason, now_ns)
        return [Disconnect(reason)] if connected else []

    # Steps shared by several events.

    def _enter(self, state: LinkState, reason: str, now_ns: int) -> None:
        self._state, self._since_ns, self._reason = state, now_ns, reason

    def _connect_if_free(self, reason: str, now_ns: int) -> list[Action]:
        if self._holder is None or self._holder in self._local_addresses:
            return self._connect(reason, now_ns)
        held = (
            f"the sonar at {self._target} is in use by {self._holder}: it serves one client at a "
            "time, close the other one"
        )
        since_ns = self._since_ns if self._state is LinkState.SEARCHING else now_ns
        self._enter(LinkState.SEARCHING, held, since_ns)
        return []

    def _connect(self, reason: str, now_ns: int) -> list[Action]:
        assert self._target is not None  # noqa: S101 - the callers have checked it
        self._address = self._target
        self._enter(LinkState.CONNECTING, reason, now_ns)
        return [Connect(self._target)]

    def _follow(self, now_ns: int) -> list[Action]:
        """Connect to the new address of the sonar."""
        reason = f"the sonar moved from {self._address} to {self._target}"
        waits = self._state is LinkState.BACKING_OFF
        dropped: list[Action] = [] if waits else [Disconnect(reason)]
        return dropped + self._connect_if_free(reason, now_ns)

    def _send_settings(self, now_ns: int) -> list[Action]:
        """Send the settings and expect their effect."""
        self._expected_since_ns = now_ns
        self._dummies = 0
        self._triggered = False
        quiet = self._standby_reason()
        if quiet is not None:
            self._enter(LinkState.STANDBY, quiet, now_ns)
        elif self._state is not LinkState.PINGING:
            self._enter(LinkState.CONFIGURING, "settings sent, no ping yet", now_ns)
        return self._send(self._encoded(self._settings_to_send()), now_ns)

    def _standby_reason(self) -> str | None:
        if self._held is not None:
            return self._held
        if self._settings.standby:
            return "standby requested"
        return "waiting for a trigger" if self._settings.network_trigger else None

    def _settings_to_send(self) -> FireSettings:
        """Return the settings to send without a trigger: standby until the first trigger."""
        quiet = self._standby_reason() is not None
        return self._settings.in_standby() if quiet else self._settings

    def _keep_alive(self, now_ns: int) -> list[Action]:
        """Repeat the fire message to keep the connection alive, or a dummy if it would trigger."""
        data = encode_dummy() if self._triggered else self._encoded(self._settings_to_send())
        return self._send(data, now_ns)

    def _encoded(self, settings: FireSettings) -> bytes:
        return settings.encode(2 if settings.needs_version_2 else self._version)

    def _send(self, data: bytes, now_ns: int) -> list[Action]:
        if self._sent_ns is not None and now_ns - self._sent_ns < self._times.send_gap_ns:
            self._pending = data
            return []
        self._sent_ns, self._pending = now_ns, None
        return [Send(data)]

    def _send_pending(self, now_ns: int) -> list[Action]:
        return [] if self._pending is None else self._send(self._pending, now_ns)
