"""Who may talk to the page, and the error when it cannot be served."""

import asyncio
import sys
import webbrowser
from pathlib import Path

import pytest

from mapperd.cli.mapperctl.arguments import parser
from mapperd.cli.mapperctl.command import main
from mapperd.cli.mapperctl.errors import CtlError, CtlExit
from mapperd.cli.mapperctl.view import open_page, run_view, same_origin

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
        with pytest.raises(CtlError, match="somebody else listens there") as taken:
            open_page("127.0.0.1", server.get_port())
        assert taken.value.code == CtlExit.UNAVAILABLE
        assert server.request_share_url() is None, "nothing goes to other computers"
    finally:
        server.stop()


def test_a_missing_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "--socket", str(tmp_path / "map.sock")]) == CtlExit.USAGE
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
    assert ended.value.code == CtlExit.USAGE
