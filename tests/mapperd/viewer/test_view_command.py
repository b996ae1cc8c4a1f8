"""Who may talk to the page, and the error when it cannot be served."""

import asyncio
import contextlib
import socket
import sqlite3
import sys
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import numpy as np
import pytest

from mapperd.cli.mapperctl.arguments import parser
from mapperd.cli.mapperctl.command import main
from mapperd.cli.mapperctl.connection import CtlError
from mapperd.cli.mapperctl.view import ReplayView, _report_link, open_page, run_view, same_origin
from mapperd.client import AskError, MapClient
from mapperd.daemon.map_server import MapServer, saved_map
from mapperd.mapping.queries import MapContent
from mapperd.store.stored_map import StoredMap
from mapperd.viewer.health import Health, health_html
from oculus_driver.command_line import ExitCode
from tests.mapperd.store.dive import CONFIG, dive_on, open_store
from tests.support.mapperctl import call
from tests.support.maps import FREE, OCCUPIED, map_of

__all__ = ["call"]

Call = Callable[..., tuple[int, list[str], str]]

pytestmark = pytest.mark.net


def test_only_pages_of_our_own_may_connect() -> None:
    assert same_origin("http://127.0.0.1:8080", "127.0.0.1:8080")
    assert same_origin(None, "127.0.0.1:8080"), "no browser"
    assert not same_origin("https://elsewhere.example", "127.0.0.1:8080")
    assert not same_origin("http://127.0.0.1:9999", "127.0.0.1:8080")
    assert not same_origin("null", "127.0.0.1:8080")
    for name in ("[::1]:8080", "localhost:8080", "rov.local", "topside:8080", "192.168.2.1"):
        assert same_origin(f"http://{name}", name)
    rebound = "elsewhere.example:8080"  # a name of theirs that points at us
    assert not same_origin(f"http://{rebound}", rebound)


def test_a_connection_that_another_page_makes_is_refused() -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    from websockets.asyncio.client import connect  # noqa: PLC0415
    from websockets.exceptions import InvalidStatus  # noqa: PLC0415

    server = open_page("127.0.0.1", 0)
    place = f"127.0.0.1:{server.get_port()}"

    async def status(origin: str) -> int:
        try:
            async with connect(f"ws://{place}", origin=origin, subprotocols=["viser-v1.1.1"]):  # type: ignore[arg-type, list-item]
                return 101
        except InvalidStatus as error:
            return error.response.status_code

    try:
        assert asyncio.run(status("https://elsewhere.example")) == 403
        assert asyncio.run(status(f"http://{place}")) == 101
        with pytest.raises(CtlError, match="another program listens there") as taken:
            open_page("127.0.0.1", server.get_port())
        assert taken.value.code == ExitCode.UNAVAILABLE
        assert server.request_share_url() is None, "nothing goes to other computers"
    finally:
        server.stop()


@pytest.mark.parametrize("host", ["192.0.2.1", "no-such-host.invalid"])
def test_a_host_that_is_not_this_computer_is_one_clear_error(host: str) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    with pytest.raises(CtlError, match=host) as refused:
        open_page(host, 0)
    assert refused.value.code == ExitCode.UNAVAILABLE


@pytest.mark.parametrize("port", [-1, 65536, 99999])
def test_a_port_that_does_not_exist_is_one_clear_error(port: int) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    with pytest.raises(CtlError, match=f"port {port}") as refused:
        open_page("127.0.0.1", port)
    assert refused.value.code == ExitCode.USAGE


def test_the_last_port_is_not_followed_by_another() -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 65535))
        taken.listen()
        with pytest.raises(CtlError, match="another program listens there"):
            open_page("127.0.0.1", 65535)


def test_a_message_stays_where_its_event_cannot_be_set() -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")

    class Event(asyncio.Event):
        def set(self) -> None:
            if threading.current_thread() is threading.main_thread():
                raise RuntimeError("deque mutated during iteration")
            super().set()

    server = open_page("127.0.0.1", 0)
    try:
        buffer = server._websock_server.get_message_buffer()
        buffer.message_event = Event()
        before = buffer.message_counter
        server.gui.add_html("a message")
        assert buffer.message_counter > before
    finally:
        server.stop()


def test_a_missing_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "--socket", str(tmp_path / "map.sock")]) == ExitCode.BAD_CONFIG
    assert "`topside`" in capsys.readouterr().err


def test_the_command_prints_the_address_and_opens_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    message = parser().parse_args(["view", "--port", "0", "--open"])
    lines = run_view(message, str(tmp_path / "map.sock"), None, None)
    url = next(lines).rpartition(" ")[2]
    assert url.startswith("http://127.0.0.1:")
    lines.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "words", [["--port", "x"], ["--port", "70000"], ["--level", "4"], ["--radius", "-1"]]
)
def test_what_cannot_be_is_refused(words: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        parser().parse_args(["view", *words])
    assert ended.value.code == ExitCode.USAGE


def test_a_map_file_is_served_as_a_daemon_serves_its_map(tmp_path: Path) -> None:
    path = tmp_path / "a.map"
    sonar_map = map_of(OCCUPIED, FREE)
    sonar_map.save(path)

    async def follow() -> None:
        async with serving(path) as client:
            await until_cells(client, sonar_map)
            assert (await client.ask("status"))["phase"] == "file"
            with pytest.raises(AskError, match="no daemon maps live"):
                await client.ask("reset")

    asyncio.run(follow())


def test_a_daemon_s_file_is_followed_while_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)

    async def follow() -> None:
        dive_on(sonar_map, store, 0, 3)
        store.save()
        async with serving(path) as client:
            before = await until_cells(client, StoredMap(path, CONFIG))
            dive_on(sonar_map, store, 3, 9)
            store.save()
            assert await until_cells(client, StoredMap(path, CONFIG)) > before

    with store:
        asyncio.run(follow())


@pytest.mark.parametrize("quarantined", [False, True])
def test_a_damaged_file_is_shown_with_its_holes_named(tmp_path: Path, *, quarantined: bool) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)
    with store:
        dive_on(sonar_map, store, 0, 20)
        store.save()
    with contextlib.closing(sqlite3.connect(path)) as file, file:
        file.execute("UPDATE brick SET crc = crc + 1 WHERE rowid = 1")
    if quarantined:
        _, store = open_store(path)
        with store:
            assert len(store.check()) == 1

    async def follow() -> None:
        async with serving(path) as client:
            await client.complete(60)
            assert client.mirror is not None
            assert client.mirror.info.bricks_lost == 1
            status = await client.ask("status")
            assert [one["code"] for one in status["problems"]] == ["bricks_lost"]
            health = Health()
            health.take_status(status, {}, 0.0)
            assert "1 damaged bricks" in health_html(health, 0.0, 0)

    asyncio.run(follow())


def test_holes_that_the_writer_finds_are_named_while_the_file_is_shown(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)

    async def follow() -> None:
        dive_on(sonar_map, store, 0, 20)
        store.save()
        async with serving(path) as client:
            await client.complete(60)
            assert (await client.ask("status"))["problems"] == []
            with contextlib.closing(sqlite3.connect(path)) as file, file:
                file.execute(
                    "INSERT INTO quarantine (x, y, z, reason) SELECT x, y, z, '' FROM brick "
                    "WHERE rowid = 1"
                )
                file.execute("DELETE FROM brick WHERE rowid = 1")
            async with asyncio.timeout(60):
                while not (await client.ask("status"))["problems"]:  # noqa: ASYNC110 no event
                    await asyncio.sleep(0.05)

    with store:
        asyncio.run(follow())


@contextlib.asynccontextmanager
async def serving(path: Path) -> AsyncIterator[MapClient]:
    sonar_map, store = saved_map(path, CONFIG)
    server = MapServer(sonar_map, store, str(path), "file")
    async with server.serving() as address, MapClient(address) as client:
        yield client


async def until_cells(client: MapClient, content: MapContent) -> int:
    """Wait until a client has exactly the occupied voxels of a map; return their number."""
    wanted = [batch.centres_m for batch in content.occupied().batches()]
    content.close()
    centres_m = np.concatenate(wanted)
    expected = centres_m[np.lexsort(centres_m.T)]
    found = np.empty((0, 3))
    async with asyncio.timeout(60):
        async for _ in client.changes():
            if client.mirror is not None:
                found = client.mirror.cells("occupied").centres_m
            if len(found) == len(expected):
                break
    np.testing.assert_allclose(found[np.lexsort(found.T)], expected, atol=1e-6)
    return len(found)


def test_what_is_no_map_is_one_line(tmp_path: Path, call: Call) -> None:
    recording = tmp_path / "dive one.mcap"
    recording.write_bytes(b"\x89MCAP0\r\n")
    code, _, error = call("view", recording)
    assert (code, "mapperd --replay" in error, "dive one.mcap' --view" in error) == (65, True, True)
    code, _, error = call("view", tmp_path / "none.map")
    assert (code, "no such file" in error) == (66, True)
    code, _, error = call("view", tmp_path)
    assert (code, f"mapperd --replay {tmp_path} --view" in error) == (66, True)
    cloud = tmp_path / "changes.ply"
    cloud.write_bytes(b"ply\n")
    code, _, error = call("view", cloud)
    assert (code, "CloudCompare or MeshLab" in error, "--replay" in error) == (65, True, False)
    code, _, error = call("view", recording, "--socket", tmp_path / "a.sock")
    assert (code, "--socket" in error) == (2, True)


@pytest.mark.parametrize("command", [["view"], ["status"], ["export", "a.ply"]])
def test_an_address_without_a_port_is_one_line(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--address", "192.168.2.2"]) == ExitCode.USAGE
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
    assert "192.168.2.2" in output.err
    assert ":7471" in output.err


def test_the_command_reports_each_outage_once(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"

        async def work() -> None:
            async with MapClient(address, token=b"x") as client:
                reporting = asyncio.create_task(_report_link(client))
                await asyncio.sleep(1.0)  # several attempts
            await reporting

        asyncio.run(work())
    expected = f"mapperctl: {address}: no daemon answers: Connection refused; trying again\n"
    assert capsys.readouterr().err == expected


@pytest.mark.timeout(60)
def test_the_page_of_a_replay_closes_even_before_its_thread_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    left = threading.Event()
    run = ReplayView._run

    async def late(page: ReplayView) -> None:
        left.wait()
        await run(page)

    monkeypatch.setattr(ReplayView, "_run", late)
    with ReplayView(0, map_of([]), "dive.mcap"):
        threading.Timer(0.5, left.set).start()
