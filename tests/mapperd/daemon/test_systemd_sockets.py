"""Sockets from the manager: what systemd itself passes on."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mapperd.daemon.systemd import inherited_sockets

CHILD = """
import os
from mapperd.daemon.systemd import inherited_sockets
[(name, found)] = inherited_sockets(os.environ, os.getpid()).items()
left = [one for one in os.environ if one.startswith("LISTEN_")]
connection, _ = found.accept()
connection.sendall(f"{name} {left}".encode())
"""


@pytest.mark.skipif(shutil.which("systemd-socket-activate") is None, reason="no systemd here")
def test_systemd_hands_over_a_socket(tmp_path: Path) -> None:
    import socket  # noqa: PLC0415 only here

    path = tmp_path / "control"
    command = ["systemd-socket-activate", "-l", str(path), "--fdname=control", sys.executable]
    with subprocess.Popen([*command, "-c", CHILD], stderr=subprocess.DEVNULL) as process:  # noqa: S603
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(20)
            for _ in range(200):
                if path.exists():
                    break
                time.sleep(0.05)
            client.connect(str(path))
            assert client.recv(100) == b"control []"
        assert process.wait(20) == 0


@pytest.mark.parametrize(
    "environ",
    [
        {},
        {"LISTEN_PID": "1", "LISTEN_FDS": "1"},
        {"LISTEN_PID": "7", "LISTEN_FDS": "many"},
        {"LISTEN_PID": "7", "LISTEN_FDS": "-1"},
        {"LISTEN_PID": "7", "LISTEN_FDS": "17"},
        {"LISTEN_PID": "7", "LISTEN_FDS": "0", "LISTEN_FDNAMES": "control"},
    ],
)
def test_what_is_not_meant_for_us_is_not_touched(environ: dict[str, str]) -> None:
    given = dict(environ) | {"HOME": "/"}
    assert inherited_sockets(given, 7) == {}
    assert given == {"HOME": "/"}
