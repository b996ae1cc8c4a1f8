"""A client gets only newer pictures, however coarse they become."""

from collections.abc import Callable

from mapperd.events import EventLog
from mapperd.mapping.sonar_map import PingStats
from mapperd.server.outbox import ClientOutbox
from mapperd.server.pacer import Pacer
from mapperd.wire.framing import client_inbox
from mapperd.wire.messages import ImageMessage
from oculus_driver.ping import Ping
from tests.mapperd.server.test_state_feed import feed_of, fused, ping_result


class Choosing(ClientOutbox):
    """A client with room for pictures that are as coarse as a test requires."""

    coarse = 0

    def coarseness(self) -> int:
        return self.coarse


class Roomy(Pacer):
    def fits(self, size: int, now_s: float) -> bool:
        return size > 0 < now_s


def test_no_picture_is_older_than_the_one_before(ping: Callable[..., Ping]) -> None:
    feed, _, _ = feed_of()
    now_s = 100.0

    def deliver(client: ClientOutbox) -> list[int]:
        output = client_inbox().feed(b"".join(client.pieces(now_s, 1)))
        return [one.ping_id for one in output if isinstance(one, ImageMessage)]

    def client() -> Choosing:
        new = Choosing(feed, EventLog(lambda: 1), Roomy())
        new.want(["image"])
        return new

    one = client()
    sent: list[int] = []
    for number, (drawn, coarse) in enumerate(
        [({0, 1, 2}, 0), ({0}, 0), ({0}, 1), ({0, 1}, 1), ({1}, 2), ({1, 2}, 2), ({1, 2}, 0)], 1
    ):
        feed.put(ping_result(ping(ping_id=number), fused(number), PingStats()))
        now_s += 1
        feed.refresh({"image"}, now_s)
        feed.draw({"image"}, drawn)
        one.coarse = coarse
        sent += deliver(one)
    assert sent == [1, 2, 4, 6]
    assert len(feed.image(0).frame) > len(feed.image(2).frame) > 0  # so large they are
    late = client()
    assert deliver(late) == []  # the fine one is of the fourth ping
    late.coarse = 1
    assert deliver(late) == [7]
