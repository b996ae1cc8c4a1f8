"""Mistakes of a user: each is one line that names the remedy."""

import asyncio
import contextlib
import os
import socket
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from mapperd.cli.mapperctl.command import main as mapperctl
from mapperd.cli.mapperd import main as mapperd
from mapperd.daemon.session import host_clock
from mapperd.store.database import only_writer
from oculus_driver import PlaybackSonar
from oculus_driver.command_line import ExitCode
from oculus_driver.virtual_sonar.faults import Faults
from tests.support.process import free_port, free_tcp_port

PingBytes = Callable[..., bytes]
OdometryBytes = Callable[..., bytes]
Capture = pytest.CaptureFixture[str]
COARSE = "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
LIVE_S = 2.5
HOUR_NS = 3600 * 10**9
NOBODY = 65534


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for problems at once; have settings and folders of our own."""
    monkeypatch.setattr("mapperd.daemon.problems.GRACE_S", 0.3)
    monkeypatch.setattr("mapperd.daemon.status.POLL_INTERVAL_S", 0.1)
    # Daemons of these tests run beside the main thread, which alone gets signals.
    monkeypatch.setattr(
        "asyncio.unix_events._UnixSelectorEventLoop.add_signal_handler", lambda *_: 0
    )
    monkeypatch.setenv("XDG_CONFIG_HOME", "/none")


def one_line(text: str, *words: str) -> None:
    """Check that exactly one line holds all words."""
    found = [line for line in text.splitlines() if all(word in line for word in words)]
    assert len(found) == 1, text


class Bench:
    """A sonar and a vehicle on this computer, and a daemon that maps them for a moment."""

    def __init__(
        self, folder: Path, capsys: Capture, ping: PingBytes, odometry: OdometryBytes
    ) -> None:
        self._folder, self._capsys = folder, capsys
        self._pings = [ping(k, start_time=100 + 0.05 * k) for k in range(1, 40)]
        self._odometry = odometry
        self.path = folder / "live.yaml"
        self.port = free_port()

    def run(
        self,
        settings: str = "",
        *,
        sonar: int | None = None,
        record: dict[str, Any] | None = None,
        meanwhile: Callable[[], object] = lambda: None,
        faults: Faults | None = None,
        seconds: float = LIVE_S,
    ) -> tuple[int, str]:
        """Map for a moment; return the exit code and standard error.

        Args:
            settings: on top of the usual ones.
            sonar: port at which the daemon looks for it, if not at that of the real one.
            record: changes of the vehicle's odometry records; None sends none.
            meanwhile: called in a thread while the daemon starts.
            faults: how the sonar treats a second client, which the daemon is; None: it is alone.
            seconds: to map.
        """
        words = ["--config", self.path, "--out", self._folder / "out", "--duration", seconds]

        async def work() -> int:
            async with contextlib.AsyncExitStack() as stack:
                port = sonar or await self._sonar(stack, faults)
                self._write(settings, port)
                self._capsys.readouterr()
                if record is not None:
                    stack.callback(asyncio.create_task(self._send(record)).cancel)
                daemon = asyncio.to_thread(mapperd, [str(word) for word in words])
                code, _ = await asyncio.gather(daemon, asyncio.to_thread(meanwhile))
                return code

        return asyncio.run(work()), self._capsys.readouterr().err

    async def _sonar(self, stack: contextlib.AsyncExitStack, faults: Faults | None) -> int:
        """Start the sonar, with a first client if it shall have one; return its port."""
        sonar = await stack.enter_async_context(
            PlaybackSonar(self._pings, standby=True, loops=None, faults=faults or Faults())
        )
        if faults is not None:
            _, writer = await asyncio.open_connection(sonar.host, sonar.port)
            stack.callback(writer.close)
            await asyncio.sleep(0.1)
        return sonar.port

    def _write(self, settings: str, port: int) -> None:
        if "odometry:" not in settings:
            settings += f"odometry: {{sources: [{{link: 'udp://127.0.0.1:{self.port}'}}]}}\n"
        where = f"address: 127.0.0.1, port: {port}, ping_rate: highest"
        self.path.write_text(f"{COARSE}device: {{{where}}}\n{settings}")

    async def _send(self, record: dict[str, Any]) -> None:
        loop, clock = asyncio.get_running_loop(), host_clock()
        fields = {"p": (0.0, 0.0, 0.0), "clk": "unix"} | record
        ahead_ns = fields.pop("ahead_ns", 0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.setblocking(False)  # noqa: FBT003 the socket's own argument
            while True:
                data = self._odometry(**fields, t=clock() + ahead_ns)
                await loop.sock_sendto(link, data, ("127.0.0.1", self.port))
                await asyncio.sleep(0.02)


@pytest.fixture
def bench(
    tmp_path: Path, capsys: Capture, ping_bytes: PingBytes, odometry_bytes: OdometryBytes
) -> Bench:
    return Bench(tmp_path, capsys, ping_bytes, odometry_bytes)


# Wrong address


@pytest.mark.net
def test_wrong_address_of_the_sonar(bench: Bench) -> None:
    code, printed = bench.run(sonar=free_tcp_port())
    one_line(printed, "If 127.0.0.1 is wrong, correct device.address", "finds the sonar")
    one_line(printed, "no ping arrived from the sonar", "`mapperd doctor`")
    assert code == ExitCode.BAD_DATA


@pytest.mark.net
def test_wrong_address_of_an_odometry_source(bench: Bench) -> None:
    source = f"{{format: water_linked_json, link: 'tcp://127.0.0.1:{free_tcp_port()}'}}"
    _, printed = bench.run(f"odometry: {{sources: [{source}]}}\n")
    one_line(printed, "no odometry: ", "refused", "check that the sender is on, its address")


@pytest.mark.parametrize("words", [["status", "--once"], ["get", "filtering"]])
def test_wrong_address_of_the_daemon(words: list[str], capsys: Capture) -> None:
    code = mapperctl([*words, "--address", f"127.0.0.1:{free_tcp_port()}"])
    assert code == ExitCode.UNAVAILABLE
    one_line(capsys.readouterr().err, "no daemon answers", "check that mapperd runs there")


def test_no_daemon_on_this_computer(capsys: Capture) -> None:
    assert mapperctl(["events"]) == ExitCode.UNAVAILABLE
    one_line(capsys.readouterr().err, "no daemon is running", "start mapperd, or give --address")


# No sonar, and a sonar that serves somebody else


@pytest.mark.net
def test_no_sonar(tmp_path: Path, capsys: Capture, bench: Bench) -> None:
    _, printed = bench.run()  # it is there, nothing is missed
    assert "no sonar: " not in printed
    # No sonar has this number: whatever else this network holds is left alone.
    bench.path.write_text("device: {serial: 4294967295}\n")
    mapperd(["--config", str(bench.path), "--out", str(tmp_path / "out"), "--duration", "2"])
    one_line(capsys.readouterr().err, "no sonar: ", "power and cable", "device.address")


@pytest.mark.net
def test_second_client_that_the_sonar_refuses(bench: Bench) -> None:
    _, printed = bench.run(faults=Faults(refuse_second=True))
    one_line(printed, "the sonar at 127.0.0.1 sends nothing", "close other programs that use it")


@pytest.mark.net
def test_second_client_that_the_sonar_lets_wait(bench: Bench) -> None:
    _, printed = bench.run(faults=Faults(), seconds=6.0)
    one_line(printed, "the sonar does not ping: ", "close other programs that use it")


# Missing extras


@pytest.mark.parametrize(("module", "extra"), [("pymavlink", "mavlink"), ("pynmea2", "nmea")])
def test_missing_extra(
    module: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    for name in [name for name in sys.modules if name.startswith(f"mapperd.odometry.{extra}")]:
        monkeypatch.delitem(sys.modules, name)
    for name in {module, *(name for name in sys.modules if name.startswith(f"{module}."))}:
        monkeypatch.setitem(sys.modules, name, None)
    path = tmp_path / "live.yaml"
    path.write_text(f"odometry: {{sources: [{{format: {extra}}}]}}\n")
    assert mapperd(["--config", str(path), "--out", str(tmp_path / "out")]) == 78
    one_line(capsys.readouterr().err, f"to install the extra `{extra}`", "-m pip install")


# Odometry


@pytest.mark.net
def test_no_odometry(bench: Bench) -> None:
    code, printed = bench.run()
    one_line(
        printed, f"nothing arrives on UDP 127.0.0.1:{bench.port}", "let the vehicle send there"
    )
    one_line(printed, "no ping could be mapped: no_odometry", "check odometry.sources", "--pose")
    assert code == ExitCode.BAD_DATA


@pytest.mark.net
def test_attitude_only(bench: Bench) -> None:
    code, printed = bench.run(record={"p": None})
    one_line(printed, "neither horizontal position nor velocity", "The sonar is recorded and shown")
    one_line(printed, "no ping could be mapped: ", "no_position", "odometry.owners.position: fixed")
    assert code == ExitCode.BAD_DATA


@pytest.mark.net
def test_attitude_only_maps_from_a_fixed_spot(bench: Bench) -> None:
    link = f"{{link: 'udp://127.0.0.1:{bench.port}'}}"
    settings = f"odometry: {{sources: [{link}], owners: {{position: fixed}}}}\n"
    code, printed = bench.run(settings, record={"p": None})
    assert code == ExitCode.OK, printed
    assert "neither" not in printed


@pytest.mark.net
@pytest.mark.parametrize(("hours", "side"), [(3, "ahead of"), (-3, "behind")])
def test_clock_off_by_hours(hours: int, side: str, bench: Bench) -> None:
    code, printed = bench.run(record={"ahead_ns": hours * HOUR_NS})
    one_line(printed, f"is 3.0 h {side} this computer's", "Synchronize the clocks (NTP, chrony)")
    assert code == ExitCode.OK  # it maps: the stamps are fitted


def test_odometry_of_another_time(
    tmp_path: Path,
    capsys: Capture,
    write_recording: Callable[..., Any],
    ping_bytes: PingBytes,
    odometry_bytes: OdometryBytes,
) -> None:
    path, config = tmp_path / "a", tmp_path / "a.yaml"
    config.write_text(COARSE)
    events = [("odometry", odometry_bytes(), 0.1 * k) for k in range(3)]
    write_recording(path, [*events, ("ping", ping_bytes(1), 7200.0)])
    words = ["--replay", path, "--config", config, "--out", tmp_path / "out"]
    assert mapperd([str(word) for word in words]) == ExitCode.BAD_DATA
    one_line(capsys.readouterr().err, "after_odometry 1", "check the clocks of both recordings")


# The computer


@pytest.mark.net
def test_disk_nearly_full(bench: Bench) -> None:
    code, printed = bench.run("recording: {free_floor: 1000000000}\n")
    assert code == ExitCode.CANNOT_WRITE
    one_line(printed, "no space to keep a session", "delete files or choose another disk")


@contextlib.contextmanager
def unprivileged() -> Iterator[None]:
    """Without root's rights, which permissions do not stop."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


def test_no_permission_for_the_settings(short: Path, capsys: Capture) -> None:
    path = short / "live.yaml"
    short.chmod(0o755)
    path.write_text("{}")
    path.chmod(0)
    with unprivileged():
        code = mapperd(["--config", str(path)])
    assert code == ExitCode.BAD_CONFIG
    one_line(capsys.readouterr().err, str(path), "Permission denied; check its owner")


def test_no_permission_for_the_results(short: Path, capsys: Capture, ping_bytes: PingBytes) -> None:
    recording, folder = short / "raw", short / "locked"
    recording.write_bytes(ping_bytes(1))
    folder.mkdir(0o555)
    short.chmod(0o755)
    with unprivileged():
        code = mapperd(
            ["--replay", str(recording), "--pose", "0,0,0,0,0,0", "--out", str(folder / "out")]
        )
    assert code == ExitCode.CANNOT_WRITE
    one_line(capsys.readouterr().err, str(folder), "Permission denied; check its owner")


def test_no_permission_for_the_socket(short: Path, capsys: Capture) -> None:
    path = short / "mapperd.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()
        path.chmod(0o600)
        short.chmod(0o755)
        if os.geteuid() != 0:
            path.chmod(0)
        with unprivileged():
            code = mapperctl(["events", "--socket", str(path)])
    assert code == ExitCode.NO_PERMISSION
    one_line(capsys.readouterr().err, "Permission denied", "join the group that owns it")


@pytest.mark.net
def test_port_of_the_server_in_use(bench: Bench) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        code, printed = bench.run(f"server: {{address: '127.0.0.1:{port}'}}\n")
    assert code == ExitCode.UNAVAILABLE
    one_line(printed, f"127.0.0.1:{port}: cannot be listened on", "choose another port")


@pytest.mark.net
def test_port_of_the_odometry_in_use(bench: Bench) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", bench.port))
        _, printed = bench.run()
    one_line(printed, "no odometry: ", "already in use", "give the source another port")


@pytest.mark.net
def test_second_daemon(short: Path, bench: Bench) -> None:
    path = short / "mapperd.sock"
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(path))
        other.listen()
        code, printed = bench.run(f"server: {{socket: {path}}}\n")
    assert code == ExitCode.UNAVAILABLE
    one_line(printed, str(path), "such as another mapperd: stop it, or set server.socket")


@pytest.mark.net
def test_second_daemon_on_one_map(tmp_path: Path, bench: Bench) -> None:
    path = tmp_path / "mapperd.map"
    with only_writer(path):
        code, printed = bench.run(f"outofcore: {{use: true, map_path: {path}}}\n")
    assert code == ExitCode.CANNOT_WRITE
    one_line(printed, str(path), "another mapperd maps into it: stop it, or set outofcore.map_path")


def test_port_of_the_page_in_use(capsys: Capture) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        assert mapperctl(["view", "--port", str(other.getsockname()[1])]) != 0
    one_line(capsys.readouterr().err, "another program listens there: choose another --port")


# Tokens


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.net
def test_wrong_token(tmp_path: Path, bench: Bench) -> None:
    right, wrong = tmp_path / "right", tmp_path / "wrong"
    for path in (right, wrong):
        path.write_text(f"{path.name * 8}\n")
        path.chmod(0o600)
    port = free_tcp_port()
    address = f"127.0.0.1:{port}"
    codes: list[int] = []

    def ask() -> None:
        until_s = time.monotonic() + 30
        while not answers(port) and time.monotonic() < until_s:
            time.sleep(0.1)
        words = ["get", "filtering", "--address", address]
        codes.append(mapperctl(words))
        codes.append(mapperctl([*words, "--token-file", str(wrong)]))
        codes.append(mapperctl([*words, "--token-file", str(right)]))
        # A copy in the user's folder needs no option.
        copied = tmp_path / "mapperd" / "token"
        copied.parent.mkdir()
        copied.write_bytes(right.read_bytes())
        copied.chmod(0o600)
        with pytest.MonkeyPatch.context() as environment:
            environment.setenv("XDG_CONFIG_HOME", str(tmp_path))
            codes.append(mapperctl(words))

    _, printed = bench.run(
        f"server: {{address: '{address}', token_file: {right}}}\n", meanwhile=ask, seconds=8
    )
    assert codes == [*[ExitCode.NO_PERMISSION] * 2, *[ExitCode.OK] * 2], printed
    one_line(printed, "needs a token: give --token-file")
    one_line(printed, "wrong token; use a copy of the file that server.token_file")


@pytest.mark.net
def test_address_for_others_without_a_token(bench: Bench) -> None:
    code, printed = bench.run("server: {address: '0.0.0.0:7471'}\n")
    assert code == ExitCode.BAD_CONFIG
    one_line(printed, "needs a token: set server.token_file")


# Localization


@pytest.mark.net
def test_localization_without_a_map(bench: Bench) -> None:
    _, printed = bench.run("localization: {mode: track}\n")
    one_line(printed, "localization has no map: set localization.map_path", "`mapperctl set_map`")


def test_localization_of_a_replay_without_a_map(
    tmp_path: Path, capsys: Capture, ping_bytes: PingBytes
) -> None:
    recording, config = tmp_path / "raw", tmp_path / "a.yaml"
    recording.write_bytes(ping_bytes(1))
    config.write_text(f"{COARSE}localization: {{mode: track}}\n")
    words = ["--replay", recording, "--config", config, "--out", tmp_path / "out"]
    mapperd([*map(str, words), "--pose", "0,0,0,0,0,0"])
    one_line(capsys.readouterr().err, "localization has no map: set localization.map_path")


@pytest.mark.net
def test_localization_on_a_map_that_is_not_there(bench: Bench) -> None:
    code, printed = bench.run("localization: {mode: track, map_path: /nope.map}\n")
    assert code == ExitCode.BAD_CONFIG
    one_line(printed, "localization.map_path: /nope.map: there is no such file")


# Files


FILES = {
    "picture.jpg": b"\xff\xd8\xff\xe0\x00\x10JFIF\x00" + bytes(range(256)),
    "archive.zip": b"PK\x03\x04" + bytes(range(256)),
    "notes.txt": b"dive 7: cold\n",
    "noise.bin": bytes(range(255, -1, -1)) * 9,
    "empty.mcap": b"",
}


@pytest.mark.parametrize("name", FILES)
def test_unknown_kind_of_recording(name: str, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / name
    path.write_bytes(FILES[name])
    code = mapperd(["--replay", str(path), "--out", str(tmp_path / "out")])
    assert code == ExitCode.BAD_DATA
    remedy = "nothing was recorded" if name == "empty.mcap" else "expected MCAP"
    one_line(capsys.readouterr().err, name, remedy)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("words", [["convert", "{}", "map.ply"], ["diff", "{}", "{}"]])
def test_unknown_kind_of_map(
    words: Sequence[str], name: str, tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / name
    path.write_bytes(FILES[name])
    assert mapperctl([word.format(path) for word in words]) == ExitCode.BAD_DATA
    one_line(capsys.readouterr().err, name, "no map: ", "OctoMap")


def ros_mcap(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("nav_msgs/msg/Odometry", "ros2msg", b"")
        channel = writer.register_channel("/odom", "cdr", schema)
        writer.add_message(channel, 0, bytes(50), 0)
        writer.finish()  # type: ignore[no-untyped-call]


def ros_database(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        database.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
        database.execute("INSERT INTO topics VALUES(1, '/odom', 'nav_msgs/msg/Odometry', 'cdr')")
        database.commit()


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("bag_0.mcap", ros_mcap),
        ("bag_0.db3", ros_database),
        ("old.bag", lambda path: path.write_bytes(b"#ROSBAG V2.0\n" + bytes(99))),
    ],
)
def test_ros_bag_without_sonar_data(
    name: str, write: Callable[[Path], object], tmp_path: Path, capsys: Capture
) -> None:
    write(tmp_path / name)
    code = mapperd(["--replay", str(tmp_path / name), "--out", str(tmp_path / "out")])
    assert code == ExitCode.BAD_DATA
    one_line(capsys.readouterr().err, name, "ROS bag")
