"""`mapperctl` against a daemon that listens."""

import json
import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mapperd.cli.mapperctl.command import main
from mapperd.cli.mapperctl.connection import ControlConnection, DaemonTarget
from mapperd.cli.mapperd import main as mapperd
from mapperd.config.catalog import parameters
from mapperd.config.loader import load_config
from mapperd.events import Severity
from tests.mapperd.cli.mapperctl.conftest import Running
from tests.support.control_server import message_of, refusal

pytestmark = pytest.mark.net

Call = Callable[..., tuple[int, list[str], str]]
THRESHOLD = "filtering.intensity_threshold"


@pytest.fixture
def call(running: Running, capsys: pytest.CaptureFixture[str]) -> Call:
    def run(*words: str) -> tuple[int, list[str], str]:
        code = main([*words, "--socket", str(running.socket)])
        output = capsys.readouterr()
        assert output.err.count("\n") == (0 if code == 0 else 1)
        assert code == 0 or output.err.startswith("mapperctl: ")
        return code, output.out.splitlines(), output.err

    return run


def test_status_is_reported_once_where_nobody_watches(call: Call) -> None:
    code, lines, _ = call("status")
    assert code == 0
    assert lines == ["mapperd mapping, up 0:00:00", "pings         0 mapped"]


def test_settings_are_reported_and_changed(call: Call, running: Running) -> None:
    assert call("get", THRESHOLD)[1] == [f"{THRESHOLD} = 35.0"]
    assert call("set", f"{THRESHOLD}=50", "filtering.min_range=1e0")[1] == [
        f"{THRESHOLD}: 35.0 is now 50",
        "filtering.min_range: 0.5 is now 1.0",
    ]
    assert running.one.daemon.settings.current.filtering.intensity_threshold == 50.0
    assert call("set", f"{THRESHOLD}=50")[1] == ["nothing changed"]
    (line,) = call("params", THRESHOLD, "--origin")[1]
    assert line == f"{THRESHOLD} = 50.0  # control, user {os.getuid()}"
    assert len(call("params")[1]) == len(parameters())


def test_refused_change_is_one_line(call: Call) -> None:
    code, lines, output = call("set", f"{THRESHOLD}=50", "octree.voxel_resolution=1")
    assert (code, lines) == (1, [])
    assert re.search(r"octree\.voxel_resolution: .*restart", output)


def test_operations_are_done(call: Call, running: Running) -> None:
    assert call("save", "a.ply")[1] == ["/maps/a.ply: 9 bytes"]
    assert call("reset", "--yes")[1] == ["the map is empty"]
    assert call("snapshot")[1] == ["3 bytes in 0.50 s"]
    assert call("reload")[1] == ["filtering.min_range is now [0.5, 1.0]"]
    assert [what[0] for what in running.one.daemon.done] == ["save", "reset", "snapshot", "reload"]


def test_reset_asks_first(call: Call, running: Running) -> None:
    code, _, output = call("reset")
    assert code == 2
    assert "--yes" in output
    assert running.one.daemon.done == []


@pytest.mark.parametrize(
    ("reason", "code"),
    [("bad_name", 2), ("bad_format", 2), ("cannot_write", 73), ("busy", 75), ("no_store", 1)],
)
def test_what_the_daemon_refuses_is_one_line_and_a_code(
    call: Call, running: Running, reason: str, code: int
) -> None:
    running.one.daemon.fault = refusal(reason)
    assert call("save", "a.ply")[::2] == (code, f"mapperctl: it cannot be: {reason}\n")


@pytest.mark.parametrize(
    "words",
    [
        ["status", "--once"],
        ["params"],
        ["get", "filtering"],
        ["set", f"{THRESHOLD}=40"],
        ["save", "a.ply"],
        ["reset", "--yes"],
        ["reload"],
        ["snapshot"],
    ],
)
def test_json_is_one_object(call: Call, words: list[str]) -> None:
    code, lines, _ = call(*words, "--json")
    assert code == 0
    (line,) = lines
    assert isinstance(json.loads(line), dict)


def test_events_are_reported(call: Call, running: Running) -> None:
    log = running.one.daemon.events
    for number in range(450):
        log.add(Severity.WARNING, "code", f"event {number}\x1b[2J", depth_m=number)
    _, lines, _ = call("events")
    assert len(lines) == 450
    assert lines[3].endswith("warning event 3?[2J")
    _, lines, _ = call("events", "--since", "449", "--json")
    assert json.loads(lines[0])["facts"] == {"depth_m": 449}
    assert len(lines) == 1


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_tcp_with_a_token(
    running: Running,
    token_file: Path,
    trusted: Path,
    kind: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    there = ["--address", f"127.0.0.1:{running.port(kind)}", "--token-file", str(token_file)]
    more = ["--tls-ca", str(trusted)] if kind == "tls" else []
    assert main(["snapshot", *there, *more]) == 0
    assert running.one.daemon.done == [("snapshot", "control, 127.0.0.1")]
    token_file.write_text("another-token-of-somebody", encoding="ascii")
    assert main(["snapshot", *there, *more]) == 77
    assert main(["snapshot", *there[:2], *more]) == 77
    output = capsys.readouterr().err.splitlines()
    assert output[0].startswith("mapperctl: ")
    assert "token" in output[0]
    assert "--token-file" in output[1]


def test_certificate_of_somebody_else_is_not_trusted(
    running: Running, token_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import trustme  # noqa: PLC0415 only here

    other = tmp_path / "other.pem"
    trustme.CA().cert_pem.write_to_path(str(other))
    words = ["--address", f"127.0.0.1:{running.port('tls')}", "--token-file", str(token_file)]
    assert main(["snapshot", *words, "--tls-ca", str(other)]) == 77
    assert "not trusted" in capsys.readouterr().err
    assert running.one.daemon.done == []


def test_as_many_as_allowed(call: Call, running: Running) -> None:
    others = [ControlConnection(DaemonTarget(running.socket), 30.0) for _ in range(4)]
    code, _, output = call("status")
    assert code == 75
    assert "4 clients are connected, which is the maximum" in output
    for other in others:
        other.close()


def test_connection_lasts_while_it_waits(running: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapperd.server.session.QUIET_S", 1.5)
    with ControlConnection(DaemonTarget(running.socket), 30.0) as connection:
        connection.wait(3.5)
        assert connection.ask("status")["phase"] == "mapping"


def test_integer_beyond_64_bits_is_refused(call: Call) -> None:
    code, _, output = call("set", f"{THRESHOLD}={1 << 64}")
    assert code == 2
    assert "64 bits" in output


def test_no_daemon_is_one_line(capsys: pytest.CaptureFixture[str], short: Path) -> None:
    assert main(["status"]) == 69
    assert "socket" in capsys.readouterr().err
    assert main(["status", "--socket", str(short / "none")]) == 69
    assert main(["status", "--socket", "x" * 300]) == 69
    assert capsys.readouterr().err.count("\n") == 2


@pytest.mark.parametrize(
    "output",
    [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"[]\n", b"\xff\n", b"[" * 50000 + b"\n",
     message_of({}), message_of([]), message_of({"t": "greeting", "mapperd": "map"}),
     message_of({"t": "greeting", "versions": [9]}), message_of({"t": "greeting"}),
     message_of({"t": "greeting"}) * 2,
     message_of({"t": "greeting"}) + message_of({"t": "bye", "reason": "bad_version"}),
     message_of({"t": "greeting"}) + message_of({"t": "bye", "reason": "closing"})],
)  # fmt: skip
def test_peer_that_is_no_mapperd_is_one_line(
    short: Path, output: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(short / "odd"))
        listening.listen()

        def answer() -> None:
            peer, _ = listening.accept()
            with peer:
                peer.sendall(output)

        thread = threading.Thread(target=answer)
        thread.start()
        assert main(["status", "--socket", str(short / "odd")]) in (69, 76)
        thread.join()
    assert capsys.readouterr().err.count("\n") == 1


def test_socket_of_the_settings_is_found(
    running: Running, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "own.yaml"
    config.write_text(f"server: {{socket: {running.socket}}}", encoding="utf-8")
    assert main(["status", "--config", str(config)]) == 0
    assert main(["params", "--running", "--config", str(config), THRESHOLD]) == 0
    assert capsys.readouterr().out.endswith(f"{THRESHOLD} = 35.0\n")


def test_socket_of_the_user_is_found(
    running: Running, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(running.socket.parent))
    assert main(["status", "--json", "--once"]) == 0
    assert json.loads(capsys.readouterr().out)["phase"] == "mapping"


@pytest.mark.parametrize(
    "words", [[], ["set", "a"], ["set", "a=1"], ["set", f"{THRESHOLD}=[1"], ["get"], ["save"],
              ["events", "--since", "x"], ["status", "--every", "0"], ["destroy"]],
)  # fmt: skip
def test_command_that_makes_no_sense_exits_2(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


class Terminal:
    """A person at a terminal who runs `mapperctl`.

    Background jobs of a shell, these tests among them, ignore SIGINT; those of a terminal do not.
    """

    def __init__(self, *words: str) -> None:
        self.screen, inner = pty.openpty()
        code = (
            "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
            "from mapperd.cli.mapperctl.command import main; sys.exit(main(sys.argv[1:]))"
        )
        self.process = subprocess.Popen(  # noqa: S603 our own words
            [sys.executable, "-c", code, *words],
            stdin=inner, stdout=inner, stderr=inner, start_new_session=True,
        )  # fmt: skip
        os.close(inner)
        self.seen = b""

    def see(self, what: bytes, times: int = 1) -> None:
        while self.seen.count(what) < times:
            ready, _, _ = select.select([self.screen], [], [], 60)
            assert ready, self.seen
            self.seen += os.read(self.screen, 65536)

    def end(self) -> int:
        code = self.process.wait(60)
        os.close(self.screen)
        return code


def test_live_view_goes_on_until_interrupted(running: Running) -> None:
    person = Terminal("status", "--every", "0.1", "--socket", str(running.socket))
    person.see(b"\x1b[H\x1b[Jmapperd mapping", times=3)
    running.stop()
    person.see(b"looking for it")
    person.process.send_signal(signal.SIGINT)
    assert person.end() == 0


@pytest.mark.parametrize(("output", "code"), [(b"y\n", 0), (b"\n", 1), (b"no\n", 1)])
def test_person_is_asked_before_the_map_is_emptied(
    running: Running, output: bytes, code: int
) -> None:
    person = Terminal("reset", "--socket", str(running.socket))
    person.see(b"? [y/N] ")
    os.write(person.screen, output)
    assert person.process.wait(60) == code
    os.close(person.screen)
    assert len(running.one.daemon.done) == (code == 0)


def test_events_are_followed_until_interrupted(running: Running) -> None:
    log: Any = running.one.daemon.events
    log.add(Severity.INFO, "a", "before")
    person = Terminal("events", "--follow", "--json", "--socket", str(running.socket))
    person.see(b'"text": "before"')
    log.add(Severity.ERROR, "b", "afterwards")
    person.see(b'"text": "afterwards"')
    person.process.send_signal(signal.SIGINT)
    assert person.end() == 0


def test_a_change_is_written_into_the_settings_file(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "vehicle.yaml"
    path.write_text("filtering: # ours\n  min_range: 0.8 # m\n")
    code, lines, _ = call("set", f"{THRESHOLD}=50", "--persist", str(path))
    assert (code, lines[-1]) == (0, f"{path}: written")
    assert call("set", "filtering.min_range=1.5", "--persist", str(path))[0] == 0
    config = load_config(path)
    assert (config.filtering.min_range, config.filtering.intensity_threshold) == (1.5, 50)
    assert "# ours" in path.read_text()
    before = path.read_text()
    code, _, output = call("set", "octree.voxel_resolution=1", "--persist", str(path))
    assert (code, path.read_text()) == (1, before), output


def test_without_a_file_those_of_the_user_are_written(call: Call, tmp_path: Path) -> None:
    assert call("set", f"{THRESHOLD}=50", "--persist")[0] == 0
    path = tmp_path / "xdg" / "mapperd" / "mapperd.yaml"
    assert load_config(path).filtering.intensity_threshold == 50


def test_the_doctor_asks_a_running_daemon(
    running: Running, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "vehicle.yaml"
    settings.write_text(f"server: {{ socket: {running.socket} }}\n")
    words = ["doctor", "--config", str(settings), "--seconds", "0.1"]
    assert mapperd(words) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "no problems"
    problems = [{"code": "no_sonar", "text": "no sonar: check power"}]
    status = running.one.daemon.status() | {"problems": problems}
    running.one.daemon.status = lambda: status  # type: ignore[method-assign]
    assert mapperd(words) == 1
    assert "! no sonar: check power" in capsys.readouterr().out
    assert mapperd([*words, "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["failed"] == ["no_sonar"]
