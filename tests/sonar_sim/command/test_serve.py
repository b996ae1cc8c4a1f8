"""`sonar-sim serve` and `sonar-sim capture`, as a person runs them."""

import asyncio
import signal
import socket
import sys
from pathlib import Path

import pytest
from sonar_sim.command import main

from mapperd.config.odometry import OdometryFusionConfig
from mapperd.odometry.native import decode_native
from mapperd.odometry.records import Odometry
from oculus_driver import Ping, decode_ping
from oculus_driver.recording import ODOMETRY_NATIVE, open_recording
from oculus_driver.recording.chunk import messages_of
from tests.oculus_driver.virtual_sonar.client import FIRE, Client
from tests.support.process import free_ports

pytestmark = pytest.mark.net

SCENE = """
terrain:
  relief: {kind: flat, depth_m: 4.0}
  x_m: [-6, 6]
  y_m: [-6, 6]
  cell_m: 1.0
  material: sand
sonar: {model: M1200d, mode: 1, range_m: 3, ping_rate_hz: 10, beams: 256}
trajectory:
  waypoints:
    - {position_m: [0, 0, -1.5], yaw_deg: 0}
    - {position_m: [1, 0, -1.5], yaw_deg: 0}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SCENE, encoding="utf-8")
    return path


async def served(scene: Path, *words: str) -> asyncio.subprocess.Process:
    command = "import sys; from sonar_sim.command import main; sys.exit(main())"
    return await asyncio.create_subprocess_exec(
        sys.executable, "-c", command, "serve", str(scene), *words, stdout=asyncio.subprocess.PIPE
    )


def test_serve_reports_where_it_is_and_stops_on_request(scene: Path) -> None:
    async def work() -> None:
        port, status_port = free_ports(socket.SOCK_STREAM, socket.SOCK_DGRAM)
        words = ["--port", str(port), "--status-port", str(status_port), "--standby"]
        words += ["--status-to", "127.0.0.1", "--odometry", "native@udp:127.0.0.1:9"]
        process = await served(scene, *words, "--model", "M3000d")
        assert process.stdout is not None
        line = (await process.stdout.readline()).decode()
        assert line == f"an M3000d in small at 127.0.0.1:{port}\n"
        async with await Client.of_address("127.0.0.1", port) as client:
            client.writer.write(FIRE)
            (message,) = [m for m in await client.messages(2) if m.message_id == 0x23][:1]
            ping = decode_ping(message)
            assert isinstance(ping, Ping)
            assert ping.part_number == 2203
        process.send_signal(signal.SIGTERM)
        rest, _ = await process.communicate()
        assert process.returncode == 0
        assert "served: pings" in rest.decode()
        assert "native@udp:127.0.0.1:9" in rest.decode()

    async def limited() -> None:
        async with asyncio.timeout(60.0):
            await work()

    asyncio.run(limited())


FLEET = """
sonars: [{name: side, sonar: {range_m: 3}, mounting: {pitch_deg: 0, yaw_deg: 90}}]
vehicles:
  - vehicle: {name: second}
    trajectory: {waypoints: [{position_m: [0, 2, -1.5]}, {position_m: [1, 2, -1.5]}]}
    sonars: [{name: eye}]
"""


def test_serve_names_all_sonars_and_who_is_followed(scene: Path) -> None:
    scene.write_text(SCENE + FLEET, encoding="utf-8")

    async def work() -> None:
        udp = socket.SOCK_DGRAM
        port, follow, status_port = free_ports(socket.SOCK_STREAM, udp, udp)
        words = ["--port", str(port), "--status-to", "127.0.0.1", "--status-port", str(status_port)]
        url = f"udp://127.0.0.1:{follow}"
        words += ["--follow", f"second={url}", "--odometry", "second=native@udp:127.0.0.1:9"]
        process = await served(scene, *words)
        assert process.stdout is not None
        lines = [(await process.stdout.readline()).decode() for _ in range(6)]
        assert lines == [
            f"an M1200d in small at 127.0.0.1:{port}\n",
            f"an M750d in vehicle/side at 127.0.0.1:{port + 1}\n",
            f"an M750d in second/eye at 127.0.0.1:{port + 2}\n",
            f"statuses to 127.0.0.1:{status_port}\n",
            "odometry native@udp:127.0.0.1:9 at udp:127.0.0.1:9\n",
            f"second: waiting {url}\n",
        ]
        with socket.socket(socket.AF_INET, udp) as out:
            record = b'{"v":1,"clk":"arrival","w":"enu","b":"flu","p":[1,2,-3],"q":[1,0,0,0]}'
            out.sendto(record, ("127.0.0.1", follow))
        assert (await process.stdout.readline()).decode() == f"second: following {url}\n"
        process.send_signal(signal.SIGTERM)
        rest, _ = await process.communicate()
        assert process.returncode == 0
        assert "poses of second 1" in rest.decode()

    async def limited() -> None:
        async with asyncio.timeout(60.0):
            await work()

    asyncio.run(limited())


def test_serve_ends_with_the_time(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    port, status_port = free_ports(socket.SOCK_STREAM, socket.SOCK_DGRAM)
    words = ["--port", str(port), "--status-port", str(status_port), "--duration", "0.3"]
    assert main(["serve", str(scene), *words]) == 0
    assert "statuses 1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sends"),
    [
        ([], ["native@udp:127.0.0.1:52200"]),
        (["--odometry", "nmea@udp:127.0.0.1:9"], ["nmea@udp:127.0.0.1:9"]),
        (["--no-odometry"], []),
    ],
)
def test_serve_sends_odometry_to_the_daemon_by_default(
    scene: Path, words: list[str], sends: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    ports = [str(port) for port in free_ports(socket.SOCK_STREAM, socket.SOCK_DGRAM)]
    words = ["--port", ports[0], "--status-port", ports[1], "--duration", "0.3", *words]
    assert main(["serve", str(scene), *words]) == 0
    lines = capsys.readouterr().out.splitlines()
    found = [line.split()[1] for line in lines if line.startswith("odometry ")]
    assert found == sends
    assert OdometryFusionConfig().sources[0].link == "udp://127.0.0.1:52200"


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--odometry", "native"], "not a link"),
        (["--odometry", "x@pty"], "no format"),
        (["--effects", "magic"], "magic"),
    ],
)
def test_what_cannot_be_served_is_one_line(
    scene: Path, words: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", str(scene), "--port", "0", *words]) == 2
    stderr = capsys.readouterr().err
    assert stderr.count("\n") == 1
    assert reason in stderr


def test_capture_writes_what_mapperd_reads(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "capture.bin"
    words = ["capture", str(scene), "--out", str(path), "--processes", "1"]
    assert main(words) == 0
    assert "times as fast" in capsys.readouterr().out
    with open_recording(path) as recording:
        pings = [decode_ping(m) for m in messages_of(recording) if m.message_id == 0x23]
        assert len(pings) > 5
        assert all(isinstance(ping, Ping) for ping in pings)
    with open_recording(path) as recording:
        records = [c.data for c in recording if c.encoding == ODOMETRY_NATIVE]
        assert len(records) > 20
        assert all(isinstance(decode_native(record), Odometry) for record in records)
    first = path.read_bytes()
    assert main(words) == 0
    assert path.read_bytes() == first
