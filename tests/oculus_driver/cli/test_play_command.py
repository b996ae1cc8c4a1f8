"""`oculus play`, as a program of its own, on loopback."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from oculus_driver import encode_fire

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.oculus_driver.cli.conftest import Oculus

pytestmark = pytest.mark.net

OCULUS = (sys.executable, "-m", "oculus_driver.cli")


@contextmanager
def playing(path: Path, *words: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The program and the port on which it listens."""
    command = [*OCULUS, "play", str(path), "--json", "--port", "0", "--status-port", "9", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:  # noqa: S603
        try:
            assert program.stdout is not None
            yield program, json.loads(program.stdout.readline())["port"]
        finally:
            program.kill()


def all_of(port: int, first_words: bytes = b"") -> bytes:
    """Everything that the sonar at this port sends."""
    data = bytearray()
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as link:
        link.sendall(first_words)
        while piece := link.recv(1 << 16):
            data += piece
    return bytes(data)


def end_of(program: subprocess.Popen[str]) -> dict[str, int]:
    out, _ = program.communicate(timeout=20.0)
    facts: dict[str, int] = json.loads(out.splitlines()[-1])
    return facts


def test_a_recording_is_played_once_and_reported(capture_path: Path, capture: bytes) -> None:
    with playing(capture_path, "--unthrottled") as (program, port):
        assert all_of(port) == capture
        facts = end_of(program)
        assert program.returncode == 0
    assert (facts["pings"], facts["bytes_sent"], facts["clients"]) == (3, len(capture), 1)


def test_a_termination_is_a_good_end(capture_path: Path) -> None:
    with playing(capture_path, "--loop") as (program, _):
        program.send_signal(signal.SIGTERM)
        assert end_of(program)["pings"] == 0
        assert program.returncode == 0


def test_it_misbehaves_on_request(capture_path: Path, capture: bytes) -> None:
    with playing(capture_path, "--unthrottled", "--cut", "1") as (program, port):
        parts = [all_of(port) for _ in range(3)]
        facts = end_of(program)
    assert all(len(part) < 182016 for part in parts)
    assert all(capture[182016 * index :].startswith(part) for index, part in enumerate(parts))
    assert (facts["cuts"], facts["pings"], facts["pings_damaged"]) == (3, 0, 3)


def test_pings_are_made_again_on_request(capture_path: Path) -> None:
    with playing(capture_path, "--unthrottled", "--remade", "--standby") as (_, port):
        data = all_of(port, encode_fire(range_demand=1.0, mode=2, ping_rate=2))
    sizes = 2048 + 352 * (512 + 4)
    assert len(data) >= 3 * sizes
    assert data[:2] == b"SO"


def test_a_file_that_is_no_recording_is_one_line(oculus: Oculus, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello")
    result = oculus("play", tmp_path / "a.txt", "--port", "0")
    assert (result.code, result.err.count("\n")) == (65, 1)


def test_a_port_that_is_taken_is_one_line(oculus: Oculus, capture_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        result = oculus("play", capture_path, "--port", taken.getsockname()[1])
    assert result.code == 1
    assert "another address or port" in result.err
