"""Whatever happens, in whatever order: the link stays sound."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oculus_driver import FireSettings
from oculus_driver.link.state import Connect, Disconnect, LinkState, Send

if TYPE_CHECKING:
    from tests.oculus_driver.link.conftest import Bench, MakeBench

HERE, THERE, VIEWER = "192.168.2.3", "192.168.2.4", "192.168.2.10"
GAP_NS = 50_000_000
CONNECTED = (LinkState.CONFIGURING, LinkState.PINGING, LinkState.STANDBY, LinkState.SILENT)


class Witness:
    """Plays the socket: does what it may do, and checks every action."""

    def __init__(self, bench: Bench, free: FireSettings) -> None:
        self.bench = bench
        self.free = free
        self.open = False
        self.seen = 0
        self.sent_ns = 0

    def happen(self, name: str) -> None:
        bench, link = self.bench, self.bench.link
        connecting = bench.state is LinkState.CONNECTING
        if name == "connect" and connecting:
            self.open, self.sent_ns = True, 0
            bench.connect()
        elif name == "lose" and (self.open or connecting):
            self.open = False
            bench.lose()
        elif name == "break" and self.open:
            bench.actions += link.abort_connection("stream lost", bench.now_ns)
        elif name in ("ping", "dummy") and self.open:
            getattr(bench, name)()
        elif name in ("standby", "go"):
            wanted = self.free.in_standby() if name == "standby" else self.free
            bench.actions += link.apply(wanted, bench.now_ns)
        else:
            self.post(name)

    def post(self, name: str) -> None:
        bench, link = self.bench, self.bench.link
        if name in ("sight", "move", "busy"):
            bench.sight(THERE if name == "move" else HERE, VIEWER if name == "busy" else None)
        elif name in ("hold", "free"):
            bench.actions += link.hold("too hot" if name == "hold" else None, bench.now_ns)
        elif name == "trigger":
            bench.actions += link.trigger(bench.now_ns)

    def check(self) -> None:
        for action in self.bench.actions[self.seen :]:
            if isinstance(action, Send):
                assert self.open, "sent without a connection"
                assert self.bench.now_ns - self.sent_ns >= GAP_NS
                self.sent_ns = self.bench.now_ns
            elif isinstance(action, Disconnect):
                self.open = False
            else:
                assert isinstance(action, Connect)
                assert not self.open, "a second connection"
        self.seen = len(self.bench.actions)

    def wait(self, seconds: float) -> None:
        end_ns = self.bench.now_ns + round(seconds * 1e9)
        while (due_ns := self.bench.link.deadline_ns) is not None and due_ns <= end_ns:
            assert due_ns >= self.bench.now_ns - 1, "something due was not done"
            self.bench.now_ns = due_ns
            self.bench.actions += self.bench.link.tick(due_ns)
            self.check()
        self.bench.now_ns = end_ns


EVENT = st.sampled_from(
    [
        *("connect", "lose", "break", "ping", "dummy", "sight", "move", "busy"),
        *("standby", "go", "hold", "free", "trigger"),
    ]
)


@given(
    events=st.lists(st.tuples(EVENT, st.floats(0.0, 12.0)), max_size=60),
    searches=st.booleans(),
    triggered=st.booleans(),
)
@settings(max_examples=300, deadline=None)
@pytest.mark.slow
def test_any_events_keep_the_link_sound(
    start: MakeBench, events: list[tuple[str, float]], *, searches: bool, triggered: bool
) -> None:
    free = FireSettings(network_trigger=triggered)
    bench = start(free, address=None if searches else HERE)
    witness = Witness(bench, free)
    witness.check()
    for name, pause_s in events:
        witness.happen(name)
        witness.check()
        witness.wait(pause_s)
        assert witness.open == (bench.state in CONNECTED)
        assert bench.reason
