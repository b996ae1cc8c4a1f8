"""`oculus doctor` and `oculus discover` against a played sonar on loopback."""

from __future__ import annotations

import socket
import threading
from typing import TYPE_CHECKING

import pytest

from oculus_driver import Faults
from tests.oculus_driver.cli.sonar_thread import played
from tests.support.process import free_port

if TYPE_CHECKING:
    from pathlib import Path

    from tests.oculus_driver.cli.conftest import Oculus

pytestmark = pytest.mark.net


def verdicts(oculus: Oculus, *words: object) -> tuple[int, dict[str, str]]:
    result = oculus("doctor", *words, "--listen", "127.0.0.1", "--json")
    (facts,) = result.facts
    return result.code, {layer["name"]: layer["verdict"] for layer in facts["layers"]}


WELL = {"address": "ok", "port": "ok", "bytes": "ok", "frames": "ok", "pings": "ok"}


def test_a_sonar_that_pings_is_well(oculus: Oculus, capture_path: Path) -> None:
    with played(capture_path, speed=20.0) as (sonar, status_port):
        words = ("--port", sonar.port, "--status-port", status_port, "--seconds", "0.5")
        assert verdicts(oculus, *words) == (0, WELL)
        text = oculus("doctor", *words, "--listen", "127.0.0.1").out
    assert text.splitlines()[0] == "ok   address  127.0.0.1: M750d, serial number 7892, running"


def test_a_sonar_in_standby_pings_only_when_it_is_asked_to(
    oculus: Oculus, capture_path: Path
) -> None:  # quirk 16
    with played(capture_path, speed=20.0, standby=True) as (sonar, status_port):
        words = ("--port", sonar.port, "--status-port", status_port, "--seconds", "0.5")
        assert verdicts(oculus, *words) == (0, WELL | {"pings": "not tested"})
        assert sonar.counters.pings == 0
        assert verdicts(oculus, *words, "--ping") == (0, WELL)
        assert sonar.device.request is not None
        assert sonar.device.request.standby


def test_a_closed_port_is_the_first_that_fails(oculus: Oculus, capture_path: Path) -> None:
    with played(capture_path) as (_, status_port):
        words = ("--port", "1", "--status-port", status_port, "--seconds", "1")
        code, found = verdicts(oculus, *words)
    assert code == 1
    assert list(found.values()) == ["ok", "failed", "not tested", "not tested", "not tested"]


def test_a_sonar_that_is_held_by_another_client_is_reported(
    oculus: Oculus, capture_path: Path
) -> None:  # quirk 20
    with (
        played(capture_path, faults=Faults(refuse_second=True)) as (sonar, status_port),
        socket.create_connection(("127.0.0.1", sonar.port)) as other,
    ):
        other.recv(1)
        words = ("--port", sonar.port, "--status-port", status_port, "--seconds", "1")
        result = oculus("doctor", *words, "--listen", "127.0.0.1", "--json")
    (facts,) = result.facts
    assert facts["first_failure"] == "bytes"
    assert "held" in {finding["code"] for finding in facts["findings"]}


def test_no_sonar_at_all_is_reported(oculus: Oculus) -> None:
    words = ("--listen", "127.0.0.1", "--status-port", free_port(), "--seconds", "0.05")
    result = oculus("doctor", *words)
    assert result.code == 1
    assert result.out.startswith("FAIL address")
    assert oculus("discover", *words).code == 1


def test_something_else_on_the_port_is_reported(oculus: Oculus) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def greet() -> None:
            link, _ = server.accept()
            link.sendall(b"220 mail.example.org ESMTP\r\n" * 9)
            link.close()

        thread = threading.Thread(target=greet)
        thread.start()
        words = ("127.0.0.1", "--port", server.getsockname()[1], "--seconds", "0.2")
        result = oculus("doctor", *words, "--status-port", free_port(), "--json")
        thread.join(20.0)
    assert result.facts[0]["first_failure"] == "frames"


def test_discover_lists_every_sonar(oculus: Oculus, capture_path: Path) -> None:
    with played(capture_path) as (_, status_port):
        words = ("--first", "--listen", "127.0.0.1", "--status-port", status_port)
        result = oculus("discover", "--json", *words)
        text = oculus("discover", *words)
    (facts,) = result.facts
    assert (facts["address"], facts["model"], facts["serial_number"]) == (
        "127.0.0.1",
        "M750d",
        7892,
    )
    assert (result.code, text.code) == (0, 0)
    assert text.out.startswith("127.0.0.1")
