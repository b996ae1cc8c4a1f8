"""A log line names the damaged bricks that are missing in the map."""

from typing import Any, cast

import pytest
from msgspec.structs import replace

from mapperd.client.changes import MapReset
from mapperd.client.mirror import MapMirror
from mapperd.foxglove.bridge import FoxgloveRelay
from mapperd.foxglove.channels import ChannelMessage, Channels
from mapperd.foxglove.map_publisher import LIVE
from mapperd.wire.messages import Interest
from tests.mapperd.foxglove.foxglove_fakes import MAP_INFO, STATUS, FakeStream


class Log:
    """Channels of which only the log is heard."""

    def __init__(self) -> None:
        self.newest_ns = 0
        self.lines: list[bytes] = []

    def heard(self, topic: str) -> bool:
        return topic == "/log"

    def publish(self, message: ChannelMessage) -> None:
        self.lines.append(message.message.encode())


@pytest.mark.parametrize("lost", [0, 3])
def test_each_number_of_lost_bricks_is_logged_once(lost: int) -> None:
    stream, log = FakeStream(), Log()
    relay = FoxgloveRelay(cast("Any", stream), cast("Channels", log), LIVE)
    facts = replace(MAP_INFO, bricks_lost=lost)
    stream.mirror = MapMirror(facts, Interest())
    relay.take(MapReset(facts))
    relay.tick(0.0)  # before the first stamp
    relay.take(STATUS)
    for now_s in (1.0, 2.0):
        relay.tick(now_s)
    assert len(log.lines) == (lost > 0)
    assert all(b"3 damaged bricks are missing in the map" in line for line in log.lines)
