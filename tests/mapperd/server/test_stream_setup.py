"""The listeners that the settings ask for, and a whole daemon that serves them."""

import asyncio
import contextlib
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studies.stream.sent_steps import sent_steps

from mapperd.config.loader import config_from_text
from mapperd.daemon.servers import open_listeners, stream_server
from mapperd.daemon.session import host_clock
from mapperd.errors import ConfigError
from mapperd.events import EventLog
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.map_source import MapSource
from mapperd.wire.blocks import UNKNOWN
from mapperd.wire.messages import (
    FanMessage,
    ImageMessage,
    MapInfo,
    PathMessage,
    PoseMessage,
    ReturnsMessage,
)
from tests.mapperd.daemon.test_daemon import bench_of
from tests.mapperd.server.watched import Key, Watcher
from tests.support.control_server import TOKEN
from tests.support.waiting import run

pytestmark = pytest.mark.net

MakeBytes = Callable[..., bytes]


def doors_of(text: str, environ: dict[str, str]) -> tuple[list[str], list[str]]:
    """Names of the listeners, and codes of events."""
    events = EventLog(lambda: 1)
    listeners = open_listeners(config_from_text(text), events, environ)
    names = [listener.name for listener in listeners]
    for listener in listeners:
        listener.close()
    return names, [event.code for event in events.since(0)[0]]


def test_a_socket_for_every_user_is_reported(short: Path) -> None:
    text = f"server: {{socket: '{short}/own.sock', mode: '666'}}"
    assert doors_of(text, {}) == ([f"unix {short}/own.sock"], ["server_for_all"])


def test_tcp_without_a_token_is_of_the_loopback_alone(short: Path) -> None:
    environ = {"XDG_RUNTIME_DIR": str(short)}
    names, codes = doors_of("server: {address: '127.0.0.1:0'}", environ)
    assert names[1].startswith("tcp 127.0.0.1:")
    assert codes == []
    with pytest.raises(ConfigError, match=r"server\.token_file") as caught:
        doors_of("server: {address: '0.0.0.0:0'}", environ)
    assert caught.value.path == "$.server.token_file"
    assert not (short / "mapperd.sock").exists()
    token = short / "server-token"
    token.write_bytes(TOKEN)
    token.chmod(0o600)
    for given in ({"CREDENTIALS_DIRECTORY": str(short)}, {}):
        setting = "" if given else f", token_file: '{token}'"
        text = f"server: {{address: '0.0.0.0:0'{setting}}}"
        names, codes = doors_of(text, environ | given)
        assert names[1].startswith("tcp 0.0.0.0:")
        assert codes == ["server_in_clear"]


@pytest.mark.parametrize(
    ("stream", "path"),
    [
        ("address: nowhere", "$.server.address"),
        ("address: '127.0.0.1:0', token_file: /nowhere", "$.server.token_file"),
        ("address: '127.0.0.1:0', tls_key: /nowhere", "$.server.tls_certificate"),
        ("address: '127.0.0.1:0', tls_certificate: /nowhere", "$.server.tls_certificate"),
    ],
)
def test_wrong_settings_name_their_place(short: Path, stream: str, path: str) -> None:
    with pytest.raises(ConfigError) as caught:
        doors_of(f"server: {{{stream}}}", {"XDG_RUNTIME_DIR": str(short)})
    assert caught.value.path == path


def test_a_socket_of_the_service_manager_is_used(short: Path) -> None:
    with socket.socket(socket.AF_UNIX) as mine:
        mine.bind(str(short / "given"))
        mine.listen()
        listeners = open_listeners(
            config_from_text("{}"), EventLog(lambda: 1), {}, {"control": mine}
        )
        assert [listener.name for listener in listeners] == [f"unix {short}/given"]
        listeners[0].close()
    with (
        socket.socket(socket.AF_INET) as wrong,
        pytest.raises(ConfigError, match="listening Unix socket"),
    ):
        open_listeners(config_from_text("{}"), EventLog(lambda: 1), {}, {"x": wrong})


def test_a_daemon_shows_its_map_its_pose_and_what_the_sonar_sees(
    short: Path, ping_bytes: MakeBytes
) -> None:
    pings = [ping_bytes(n, start_time=100 + 0.02 * n) for n in range(1, 60)]
    wants = ["map", "pose", "path", "fan", "returns", "image", "status"]

    async def work() -> None:
        async with contextlib.AsyncExitStack() as stack:
            async with bench_of(short, pings) as bench:
                source = stack.enter_context(MapSource(bench.map, bench.keep, log_odds_step=0.25))
                environ = {"XDG_RUNTIME_DIR": str(short)}
                clock = host_clock()
                server = stream_server(bench.daemon, bench.live, source, environ, now_ns=clock)
                await stack.enter_async_context(server)
                watcher = Watcher(*await asyncio.open_unix_connection(short / "mapperd.sock"))
                stack.callback(watcher.writer.transport.abort)
                await watcher.until(lambda: watcher.greeting is not None)
                await watcher.hello(wants=wants)
                kinds = {PoseMessage, PathMessage, FanMessage, ReturnsMessage, ImageMessage}
                await watcher.until(lambda: kinds <= watcher.newest.keys() and bool(watcher.cells))
                await bench.daemon.reset("test")
                await watcher.until(lambda: watcher.resets > 0)
            end = bench.map.core.revision  # nothing is mapped any more
            await watcher.until(lambda: (watcher.complete or 0) >= end)
            assert watcher.cells == cells_of(bench.map, source.info())
            check_scene(watcher)
            assert server.status()["clients"] == 1

    run(work())


def cells_of(sonar_map: SonarMap, facts: MapInfo) -> dict[Key, bytes]:
    """Blocks of the stream as the map's own blocks have them."""
    found = {}
    for key, odds, counts in zip(*sonar_map.core.blocks(), strict=True):
        cells = sent_steps(odds * 2.0**-24, facts)
        cells = np.where(counts > 0, cells, np.int8(UNKNOWN)).reshape(2, 8, 2, 8, 2, 8)
        for z, y, x in np.ndindex(2, 2, 2):
            part = cells[z, :, y, :, x, :]
            if (part != UNKNOWN).any():
                at = (int(key[0]) * 2 + x, int(key[1]) * 2 + y, int(key[2]) * 2 + z)
                found[at] = part.tobytes()
    return found


def check_scene(watcher: Watcher) -> None:
    pose, returns, trace = (
        watcher.newest[kind] for kind in (PoseMessage, ReturnsMessage, PathMessage)
    )
    assert isinstance(pose, PoseMessage)
    assert (pose.source, pose.position_m) == ("fixed", (0.0, 0.0, 0.0))
    assert isinstance(trace, PathMessage)
    assert np.frombuffer(trace.points, "<f4").tolist() == [0.0, 0.0, 0.0]
    assert isinstance(returns, ReturnsMessage)
    assert returns.outcome == "mapped"
    assert returns.sonar_position_m == pose.sonar_position_m
    points = np.frombuffer(returns.points, "<f4").reshape(-1, 3)
    assert len(points) == len(returns.intensities) > 0
