"""`mapperd` without settings lists what it hears, sends nothing and states how to start."""

import asyncio
import socket
from pathlib import Path

import pytest

from mapperd.cli.mapperd import main
from mapperd.cli.surroundings import listen, odometry_lines, sonar_lines
from oculus_driver.command_line import ExitCode
from oculus_driver.encode import encode_status
from tests.support.process import free_ports

MAVLINK = b"\xfd" + bytes(20)


async def heard(status_port: int, ports: list[int], sent: dict[int, bytes]) -> list[str]:
    listening = asyncio.create_task(listen(1.0, status_port, ports))
    await asyncio.sleep(0.3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for port, data in sent.items():
            sender.sendto(data, ("127.0.0.1", port))
    found = await listening
    return [*sonar_lines(found), *odometry_lines(found)]


@pytest.mark.slow
def test_sonars_and_odometry_are_listed() -> None:
    status, autopilot, boat, program = ports = free_ports(*[socket.SOCK_DGRAM] * 4)
    datagram = encode_status(device_id=4711, address="192.168.2.3", client_address="192.168.2.9")
    sent = {status: datagram, autopilot: MAVLINK, boat: b"$GPGGA,1", program: b"{}"}
    lines = asyncio.run(heard(status, ports[1:], sent))
    assert len(lines) == 4
    assert lines[0].startswith("sonar: Oculus ")
    assert "serial 4711, at 192.168.2.3" in lines[0]
    assert lines[1:] == [
        f"odometry: MAVLink from 127.0.0.1 on UDP port {autopilot}",
        f"odometry: NMEA from 127.0.0.1 on UDP port {boat}",
        f"odometry: data from 127.0.0.1 on UDP port {program}",
    ]


@pytest.mark.slow
def test_silence_and_a_port_in_use_are_named() -> None:
    status, quiet = free_ports(socket.SOCK_DGRAM, socket.SOCK_DGRAM)
    lines = asyncio.run(heard(status, [quiet], {}))
    assert lines[0].startswith(f"no sonar: no status received on UDP port {status}")
    assert lines[1:] == [f"no odometry on the UDP ports {quiet}"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", quiet))
        lines = asyncio.run(heard(status, [quiet], {}))
        assert lines[1:] == [f"odometry: UDP port {quiet} cannot be opened: address already in use"]


@pytest.mark.parametrize("words", [[], ["--pose", "0,0,0,0,0,0"]])
@pytest.mark.slow
def test_without_settings_no_sonar_is_started(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert main(words) == ExitCode.BAD_CONFIG
    printed = capsys.readouterr()
    (line,) = printed.err.splitlines()
    assert line == (
        "mapperd: no settings, so no sonar is started: run `mapperd init`, or pass --config"
    )
    for part in ("sonar: ", "mapperd init", "--config FILE", "--replay FILE"):
        assert part in printed.out
    assert list(tmp_path.iterdir()) == []  # no results, no recordings
