"""Bridges stay as they are while the daemon closes their connection again and again."""

import asyncio
import contextlib
import gc
from collections.abc import Callable, Coroutine, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.bridges import changes, mavlink
from mapperd.client import MapClient
from mapperd.client import client as client_module
from mapperd.config.tree import ChangesConfig, Config, MavlinkConfig, Ros2Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.wire.messages import PoseMessage, Want
from tests.mapperd.bridges.bridge_fakes import a_ping, a_pose, a_status, sure
from tests.support.process import free_port, open_files, resident_bytes
from tests.support.stream_server import Served, Server, a_block
from tests.support.waiting import run, until

pytestmark = [pytest.mark.net, pytest.mark.slow]

LOOPBACK = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast>"
    '<Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
DOMAIN = 19
WARM_UP, RECONNECTS = 100, 400

Work = Callable[[MapClient, Callable[[str], None]], Coroutine[Any, Any, None]]


@contextmanager
def ros2() -> Iterator[tuple[tuple[Want, ...], Work]]:
    """With a program that subscribes to every topic."""
    pytest.importorskip("cyclonedds")
    from mapperd.bridges.dds import DdsNode  # noqa: PLC0415 an extra
    from mapperd.bridges.ros2 import TOPICS, WANTS, serve  # noqa: PLC0415 as above

    config = Config(ros2=Ros2Config(domain=DOMAIN, cloud_period=0.1))
    with closing(DdsNode(DOMAIN, "")) as node:
        readers = [
            node.subscriber(name, kind, profile)
            for name, kind, profile, _ in TOPICS.values()
            if name
        ]

        async def work(client: MapClient, report: Callable[[str], None]) -> None:
            serving, heard = asyncio.create_task(serve(client, config, report)), set[str]()
            try:
                while not serving.done():
                    heard |= {one.name for one in readers if list(one.take(1000))}
                    await asyncio.sleep(0.05)
            finally:
                serving.cancel()
                await asyncio.wait((serving,))
                assert {"/tf", "/map", "/mapperd/returns", "/diagnostics"} <= heard

        yield WANTS, work


@contextmanager
def autopilot() -> Iterator[tuple[tuple[Want, ...], Work]]:
    config = MavlinkConfig(address=f"udp://127.0.0.1:{free_port()}")
    yield mavlink.WANTS, lambda client, report: mavlink.serve(client, config, report)


@contextmanager
def watch() -> Iterator[tuple[tuple[Want, ...], Work]]:
    known, config = SonarMap(Config()), ChangesConfig(period=0.5)
    known.core.set_log_odds(np.zeros((1, 3)), np.ones(1))
    yield (
        changes.WANTS,
        lambda client, report: changes.serve(client, known, "old.map", config, report),
    )


@pytest.mark.parametrize("bridge", [ros2, autopilot, watch])
@pytest.mark.timeout(300)
def test_reconnects_leave_nothing_behind(
    bridge: Callable[[], Any], short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.setattr(client_module, "RETRY_DELAY_S", 0.001)
    monkeypatch.setattr(client_module, "MAX_RETRY_DELAY_S", 0.002)
    served, lines = Served(status_s=0.05), list[str]()
    served.put((0, 0, 0), a_block(1))

    async def reconnect(server: Server, client: MapClient, number: int) -> None:
        """Wait for the client, give it the state of a daemon, and close the connection."""

        def welcomed() -> bool:
            return any(one.wants for one in server.connections)

        await until(welcomed)
        connection = next(one for one in server.connections if one.wants)
        pose: PoseMessage = a_pose(number)
        connection.send(a_status("no_sonar", localization={}), sure(), a_ping(number), pose)
        await until(lambda: client.pose is not None and client.pose.stamp_ns == pose.stamp_ns)
        await asyncio.sleep(0.005)
        server.cut()
        await until(lambda: connection not in server.connections)
        del served.hellos[:], served.asked[:], lines[:]

    async def work() -> None:
        with ExitStack() as stack:
            wants, serve = stack.enter_context(bridge())
            async with (
                Server(served, short / "m.sock") as server,
                MapClient(str(short / "m.sock"), wants=wants) as client,
            ):
                serving = asyncio.create_task(serve(client, lines.append))
                held: list[tuple[int, int]] = []
                for number in range(WARM_UP + RECONNECTS):
                    if number == WARM_UP:
                        gc.collect()
                        held.append((resident_bytes(), open_files()))
                    await reconnect(server, client, number)
                gc.collect()
                held.append((resident_bytes(), open_files()))
                assert not serving.done()
                assert client.link.connects > RECONNECTS
                serving.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await serving
        (bytes_before, files_before), (bytes_after, files_after) = held
        assert bytes_after - bytes_before < 8e6
        assert files_after - files_before <= 1  # the next connection may be there

    run(work(), within_s=240)
