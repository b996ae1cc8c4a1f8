"""`MapFollower`: the same client, for programs that wait."""

import asyncio
import threading
from collections.abc import Callable

import pytest

from mapperd.client import AskError, LinkChanged, MapChanged, MapFollower, MapReset
from tests.support.stream_server import Served, Server, a_block

pytestmark = pytest.mark.net


def follow(served: Served, work: Callable[[Server, MapFollower], None]) -> None:
    """Run a test's work in a thread beside the server."""

    async def run() -> None:
        async with Server(served) as server:

            def with_follower() -> None:
                with MapFollower(server.address) as follower:
                    work(server, follower)
                assert follower.link.state == "closed"
                assert list(follower.changes()) == []

            await asyncio.to_thread(with_follower)

    asyncio.run(run())
    assert not [one for one in threading.enumerate() if one.name == "map-client"]


def test_follower_is_reported_the_same() -> None:
    def work(_: Server, follower: MapFollower) -> None:
        follower.complete(5)
        kinds = [type(change) for change in follower.changes(0.05)]
        assert kinds.index(MapReset) < kinds.index(MapChanged)
        assert LinkChanged in kinds
        assert follower.ask("status") == {"changed": {}}
        assert follower.set({"a.b": 1}) == {"a.b": 1}
        assert follower.mirror is not None
        assert len(follower.mirror) == 1
        follower.change(bytes_per_s=1000)
        with pytest.raises(AskError):
            follower.ask("fail")

    served = Served()
    served.put((0, 0, 0), a_block(1))
    follow(served, work)


def test_changes_between_two_calls_are_not_lost() -> None:
    served = Served()

    def work(_: Server, follower: MapFollower) -> None:
        follower.complete(5)
        assert list(follower.changes(0.05))
        sent = [change for change in follower.changes(0.0) if isinstance(change, MapReset)]
        assert sent == []  # and what was reported is not reported again

    follow(served, work)


def test_threads_read_while_the_map_changes() -> None:
    served = Served()

    def work(server: Server, follower: MapFollower) -> None:
        follower.complete(5)
        mirror = follower.mirror
        assert mirror is not None
        is_over = threading.Event()
        digests: list[bool] = []

        def read() -> None:
            while not is_over.is_set():
                with mirror.lock:
                    digests.append(mirror.digest() == mirror.digest())
                    mirror.cells("known")

        readers = [threading.Thread(target=read) for _ in range(3)]
        for reader in readers:
            reader.start()
        loop = server.connections[0].writer.transport._loop  # type: ignore[attr-defined]
        is_served = threading.Event()

        def serve(number: int) -> None:
            served.put((number % 7, 0, 0), a_block(number))
            server.publish()
            if number == 39:
                is_served.set()

        for number in range(40):
            loop.call_soon_threadsafe(serve, number)
        assert is_served.wait(20)
        while mirror.complete != served.revision:
            list(follower.changes(0.01))
        is_over.set()
        for reader in readers:
            reader.join()
        assert digests
        assert all(digests)
        assert len(mirror) == 7

    follow(served, work)


def test_follower_that_never_began_is_reported() -> None:
    follower = MapFollower("127.0.0.1:1")
    with pytest.raises(AskError, match="not been entered"):
        follower.ask("status")
    assert list(follower.changes()) == []
    follower.close()
