"""`mapperctl record` and `mapperctl foxglove` as programs, against a small daemon."""

import asyncio
import json
import re
import signal
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from websockets.asyncio.client import connect

from mapperd.cli.mapperctl.command import main
from mapperd.foxglove import server as foxglove_server
from mapperd.foxglove.proxy import ORIGINS, ViewerAccess
from mapperd.wire.messages import ByeMessage
from tests.mapperd.foxglove.foxglove_fakes import message_class, points_of_cloud
from tests.support.stream_server import Served, Server, a_block
from tests.support.waiting import until

pytestmark = pytest.mark.net


async def started(*arguments: str) -> asyncio.subprocess.Process:
    code = "import sys; from mapperd.cli.mapperctl.command import main; sys.exit(main())"
    return await asyncio.create_subprocess_exec(
        sys.executable,
        "-c",
        code,
        *arguments,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )


def beside_a_daemon(folder: Path, act: Callable[[Served, Server], Awaitable[None]]) -> None:
    async def run() -> None:
        served = Served()
        served.status_s = 0.05
        served.put((0, 0, 0), a_block(1))
        async with Server(served, folder / "map.sock") as server, asyncio.timeout(60):
            await act(served, server)

    asyncio.run(run())


def clouds(path: Path) -> list[Any]:
    with path.open("rb") as file:
        return [
            message_class(schema.data, schema.name).FromString(message.data)
            for schema, _, message in make_reader(file).iter_messages(topics=["/map"])
            if schema is not None
        ]


def test_a_recording_ends_cleanly_on_request(short: Path) -> None:
    path = short / "a.mcap"

    async def act(served: Served, server: Server) -> None:
        program = await started("record", str(path), "--socket", server.address, "--json")
        await until(lambda: served.acked)
        served.put((1, 2, 3), a_block(2))
        server.publish()
        sent_bytes = served.sent
        await until(lambda: served.acked >= sent_bytes)
        program.send_signal(signal.SIGTERM)
        out, err = await program.communicate()
        assert (program.returncode, err) == (0, b"")
        done = json.loads(out)
        assert done["path"] == str(path)
        assert done["bytes"] == path.stat().st_size
        assert done["messages"] > 2

    beside_a_daemon(short, act)
    last = points_of_cloud(clouds(path)[-1])
    occupied = sum(int((a_block(k).astype(float) * 0.25 > 0.6).sum()) for k in (1, 2))
    assert len(last) == occupied
    assert last["x"].max() == pytest.approx((2 * 8 - 0.5) * 0.1, abs=0.11)


def test_a_recording_lasts_as_long_as_it_is_reported_to(
    short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = short / "a.mcap"

    async def act(served: Served, server: Server) -> None:
        given = ["record", str(path), "--duration", "0.6", "--wants", "map", "--level", "1"]
        code = await asyncio.to_thread(main, [*given, "--socket", server.address])
        assert code == 0
        (hello,) = served.hellos
        assert (hello.wants, hello.interest.level) == (["map"], 1)

    beside_a_daemon(short, act)
    assert re.search(r"a\.mcap: 0:00  0\.0 MiB  \d+ messages", capsys.readouterr().out)
    assert clouds(path)


def test_another_suffix_gets_the_map_of_the_end(
    short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = short / "a.xyz"

    async def act(_: Served, server: Server) -> None:
        given = ["record", str(path), "--duration", "0.4", "--socket", server.address]
        assert await asyncio.to_thread(main, given) == 0

    beside_a_daemon(short, act)
    assert len(np.loadtxt(path)) == int((a_block(1).astype(float) * 0.25 > 0.6).sum())
    assert f"{path}: {path.stat().st_size} bytes" in capsys.readouterr().out


def test_what_cannot_be_recorded_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nobody = ["--socket", str(tmp_path / "none.sock")]
    (tmp_path / "there.mcap").write_bytes(b"mine")
    for name, code, why in (
        ("there.mcap", 73, "file exists"),
        ("no/a.mcap", 73, "No such file or directory"),
        ("a.docx", 73, "unknown format"),
        ("a.ply", 69, "no daemon answers"),
        ("a.mcap", 69, "no daemon answers"),
    ):
        given = ["record", str(tmp_path / name), "--duration", "0.1", *nobody]
        assert main(given) == code
        output = capsys.readouterr().err
        assert why in output
        assert output.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["there.mcap"]


@pytest.mark.parametrize("name", ["a.mcap", "a.xyz"])
def test_a_recording_that_is_refused_leaves_no_file(
    name: str, short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async def act(served: Served, server: Server) -> None:
        served.refusal = ByeMessage(reason="no_permission", message="you may not")
        given = ["record", str(short / name), "--socket", server.address]
        assert await asyncio.to_thread(main, given) == 77

    beside_a_daemon(short, act)
    assert "you may not" in capsys.readouterr().err
    assert not (short / name).exists()


def test_a_library_that_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "foxglove"]:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.startswith("mapperd.foxglove.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    where = ["--socket", str(tmp_path / "none.sock")]
    assert main(["record", str(tmp_path / "a.mcap"), *where]) == 78
    assert "pip install 'foxglove-sdk" in capsys.readouterr().err
    assert main(["foxglove", "--port", "0", *where]) == 78
    assert "pip install 'foxglove-sdk" in capsys.readouterr().err


def test_viewers_are_served_until_stopped(short: Path) -> None:
    async def act(served: Served, server: Server) -> None:
        program = await started(
            "foxglove", "--port", "0", "--json", "--socket", server.address, "--radius", "30"
        )
        assert program.stdout is not None
        url = json.loads(await program.stdout.readline())["url"]
        protocols: Any = ["foxglove.sdk.v1"]
        async with connect(url, subprotocols=protocols) as socket:
            assert json.loads(await socket.recv())["op"] == "serverInfo"
            await until(lambda: served.hellos)
            assert served.hellos[0].interest.radius_m == 30.0
            assert "image" not in served.hellos[0].wants
            program.send_signal(signal.SIGTERM)
            out, err = await program.communicate()
        assert (program.returncode, out, err) == (0, b"", b"")

    beside_a_daemon(short, act)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[ViewerAccess, bool]]:
    """What the command serves with: who may watch, and whether viewers may change settings."""
    found: list[tuple[ViewerAccess, bool]] = []

    async def serve(*_: object, access: ViewerAccess, may_change: bool) -> None:
        found.append((access, may_change))

    monkeypatch.setattr(foxglove_server, "serve", serve)
    return found


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "10.0.0.1"])
def test_settings_are_changed_only_where_that_is_allowed(
    host: str, tmp_path: Path, calls: list[tuple[ViewerAccess, bool]]
) -> None:
    """The server cannot distinguish viewers."""
    token = tmp_path / "token"
    token.write_text("a-token-of-letters")
    token.chmod(0o600)
    given = ["foxglove", "--host", host, "--socket", str(tmp_path / "none.sock")]
    given += ["--viewer-token-file", str(token)]
    assert main(given) == main([*given, "--allow-changes"]) == 0
    assert [may_change for _, may_change in calls] == [False, True]


def test_other_computers_need_a_token(
    tmp_path: Path, calls: list[tuple[ViewerAccess, bool]], capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["foxglove", "--socket", str(tmp_path / "none.sock")]
    for host in ("0.0.0.0", "::", "10.0.0.1", "topside"):  # noqa: S104 refused
        assert main([*given, "--host", host]) == 2
        assert "--viewer-token-file" in capsys.readouterr().err
    token = tmp_path / "token"
    token.write_text("short")
    token.chmod(0o600)
    assert main([*given, "--viewer-token-file", str(token)]) == 2
    assert "16 or more" in capsys.readouterr().err
    assert calls == []
    token.write_text("a-token-of-letters\n")
    assert main([*given, "--host", "0.0.0.0", "--viewer-token-file", str(token)]) == 0  # noqa: S104
    assert calls[0][0].token == b"a-token-of-letters"


def test_further_origins_are_admitted(
    tmp_path: Path, calls: list[tuple[ViewerAccess, bool]]
) -> None:
    given = ["foxglove", "--socket", str(tmp_path / "none.sock")]
    assert main([*given, "--allow-origin", "http://LocalHost:8080/"]) == 0
    assert calls[0][0].origins == (*ORIGINS, "http://localhost:8080")
    assert calls[0][0].token is None


def test_wrong_arguments_are_reported(capsys: pytest.CaptureFixture[str]) -> None:
    for given, why in (
        (["record", "a.mcap", "--wants", "map,tea"], "tea: some of map"),
        (["record", "a.mcap", "--duration", "-1"], "seconds were expected"),
        (["record", "a.mcap", "--radius", "far"], "metres were expected"),
        (["foxglove", "--port", "70000"], "a port was expected"),
        (["foxglove", "--level", "9"], "invalid choice"),
        (["foxglove", "--allow-origin", "*"], "an origin was expected"),
    ):
        with pytest.raises(SystemExit, match="2"):
            main(given)
        assert why in capsys.readouterr().err


def test_a_daemon_that_is_restarted_is_followed_on(short: Path) -> None:
    path = short / "a.mcap"

    async def act(served: Served, server: Server) -> None:
        program = await started("record", str(path), "--socket", server.address)
        await until(lambda: served.acked)
        served.put((5, 5, 5), a_block(3))
        server.cut()
        before, served.acked = served.sent, 0
        await until(lambda: len(served.hellos) == 2)
        reported = served.sent - before
        await until(lambda: served.acked >= reported)
        program.send_signal(signal.SIGINT)
        _, err = await program.communicate()
        assert (program.returncode, err) == (0, b"")

    beside_a_daemon(short, act)
    assert np.isclose(points_of_cloud(clouds(path)[-1])["x"].max(), 4.75, atol=0.11)
