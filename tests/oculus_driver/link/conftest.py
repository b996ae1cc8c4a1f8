"""A link on a clock of the test's own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from oculus_driver import FireSettings
from oculus_driver.link.machine import Link
from oculus_driver.link.state import Action, Connect, Disconnect, LinkState, Send
from oculus_driver.wire import FIRE_V1, FIRE_V2, MessageId

HERE, VIEWER = "192.168.2.3", "192.168.2.10"
S = 1_000_000_000

MakeBench = Callable[..., "Bench"]


class Bench:
    """A link with a clock, and all that it did."""

    def __init__(
        self,
        settings: FireSettings | None = None,
        *,
        rng: Callable[[], float] = lambda: 0.0,
        **options: Any,
    ) -> None:
        options.setdefault("address", HERE)
        self.now_ns = 1000 * S
        self.link = Link(settings or FireSettings(), rng=rng, **options)
        self.actions: list[Action] = self.link.start(self.now_ns)

    @property
    def state(self) -> LinkState:
        return self.link.status.state

    @property
    def reason(self) -> str:
        return self.link.status.reason

    @property
    def sent(self) -> list[dict[str, Any]]:
        """Every fire message sent, decoded, and None for a dummy."""
        data = [action.data for action in self.actions if isinstance(action, Send)]
        layouts = {53: FIRE_V1, 89: FIRE_V2}
        return [layouts[len(one)].unpack(one) if len(one) != 16 else {} for one in data]

    @property
    def connects(self) -> list[str]:
        return [action.address for action in self.actions if isinstance(action, Connect)]

    @property
    def disconnects(self) -> list[str]:
        return [action.reason for action in self.actions if isinstance(action, Disconnect)]

    def wait(self, seconds: float) -> None:
        """Let time pass as an event loop would: each deadline is met."""
        end_ns = self.now_ns + round(seconds * S)
        while (due_ns := self.link.deadline_ns) is not None and due_ns <= end_ns:
            self.now_ns = max(self.now_ns, due_ns)
            self.actions += self.link.tick(self.now_ns)
        self.now_ns = end_ns

    def connect(self) -> None:
        self.actions += self.link.connected(self.now_ns, VIEWER)

    def ping(self) -> None:
        self.link.message_received(MessageId.PING_RESULT, self.now_ns)
        self.link.ping_received(self.now_ns)

    def dummy(self) -> None:
        self.link.message_received(MessageId.DUMMY, self.now_ns)

    def sight(self, address: str = HERE, holder: str | None = None) -> None:
        self.actions += self.link.discovered(address, self.now_ns, holder=holder)

    def lose(self, reason: str = "connection reset by the sonar") -> None:
        self.actions += self.link.lost(reason, self.now_ns)


@pytest.fixture(scope="session")
def start() -> MakeBench:
    """Return a maker of links that were just started."""
    return Bench


@pytest.fixture(scope="session")
def pinging() -> MakeBench:
    """Return a maker of links that have had their first ping."""

    def make(settings: FireSettings | None = None, **options: Any) -> Bench:
        bench = Bench(settings, **options)
        if bench.state is LinkState.SEARCHING:
            bench.sight()
        bench.connect()
        bench.wait(0.2)
        bench.ping()
        assert bench.state is LinkState.PINGING
        return bench

    return make
