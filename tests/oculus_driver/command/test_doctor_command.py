"""`oculus doctor` and `oculus discover` against a played sonar on loopback."""

from __future__ import annotations

import asyncio
import socket
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from oculus_driver import Faults, PlayedSonar

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.oculus_driver.command.conftest import Oculus


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def played(path: Path, **values: Any) -> Iterator[tuple[PlayedSonar, int]]:
    """A sonar in a thread of its own, and the port that it sends statuses to."""
    status_port = free_udp_port()
    ready, stop = threading.Event(), asyncio.Event()
    made: list[tuple[PlayedSonar, asyncio.AbstractEventLoop]] = []

    async def work() -> None:
        options = {"loops": None, "status_period_s": 0.05, "dummy_period_s": 0.05} | values
        async with PlayedSonar(path, status_to=[("127.0.0.1", status_port)], **options) as sonar:
            made.append((sonar, asyncio.get_running_loop()))
            ready.set()
            await stop.wait()

    thread = threading.Thread(target=asyncio.run, args=(work(),))
    thread.start()
    assert ready.wait(20.0)
    try:
        yield made[0][0], status_port
    finally:
        made[0][1].call_soon_threadsafe(stop.set)
        thread.join(20.0)


def verdicts(oculus: Oculus, *words: object) -> tuple[int, dict[str, str]]:
    said = oculus("doctor", *words, "--listen", "127.0.0.1", "--json")
    (facts,) = said.facts
    return said.code, {layer["name"]: layer["verdict"] for layer in facts["layers"]}


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
        assert sonar.device.demand is not None
        assert sonar.device.demand.standby


def test_a_closed_port_is_the_first_that_fails(oculus: Oculus, capture_path: Path) -> None:
    with played(capture_path) as (_, status_port):
        words = ("--port", "1", "--status-port", status_port, "--seconds", "1")
        code, found = verdicts(oculus, *words)
    assert code == 1
    assert list(found.values()) == ["ok", "failed", "not tested", "not tested", "not tested"]


def test_a_sonar_that_is_held_by_another_client_is_told(
    oculus: Oculus, capture_path: Path
) -> None:  # quirk 20
    with (
        played(capture_path, faults=Faults(refuse_second=True)) as (sonar, status_port),
        socket.create_connection(("127.0.0.1", sonar.port)) as other,
    ):
        other.recv(1)
        words = ("--port", sonar.port, "--status-port", status_port, "--seconds", "1")
        said = oculus("doctor", *words, "--listen", "127.0.0.1", "--json")
    (facts,) = said.facts
    assert facts["first_failure"] == "bytes"
    assert "held" in {finding["code"] for finding in facts["findings"]}


def test_no_sonar_at_all_is_told(oculus: Oculus) -> None:
    words = ("--listen", "127.0.0.1", "--status-port", free_udp_port(), "--seconds", "0.05")
    said = oculus("doctor", *words)
    assert said.code == 1
    assert said.out.startswith("FAIL address")
    assert oculus("discover", *words).code == 1


def test_something_else_on_the_port_is_told(oculus: Oculus) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def greet() -> None:
            link, _ = server.accept()
            link.sendall(b"220 mail.example.org ESMTP\r\n" * 9)
            link.close()

        thread = threading.Thread(target=greet)
        thread.start()
        words = ("127.0.0.1", "--port", server.getsockname()[1], "--seconds", "0.2")
        said = oculus("doctor", *words, "--status-port", free_udp_port(), "--json")
        thread.join(20.0)
    assert said.facts[0]["first_failure"] == "frames"


def test_discover_lists_every_sonar(oculus: Oculus, capture_path: Path) -> None:
    with played(capture_path) as (_, status_port):
        words = ("--first", "--listen", "127.0.0.1", "--status-port", status_port)
        said = oculus("discover", "--json", *words)
        text = oculus("discover", *words)
    (facts,) = said.facts
    assert (facts["address"], facts["model"], facts["serial_number"]) == (
        "127.0.0.1",
        "M750d",
        7892,
    )
    assert (said.code, text.code) == (0, 0)
    assert text.out.startswith("127.0.0.1")
