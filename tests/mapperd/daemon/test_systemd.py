"""What the manager hears; the tests are the manager."""

import contextlib
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from mapperd.daemon.systemd import MAX_STATUS, Notifier, watchdog_s


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(5)
        yield listening


def heard(manager: socket.socket) -> str:
    return manager.recv(4096).decode()


def test_every_word_of_the_protocol(manager: socket.socket) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": manager.getsockname()})
    assert notifier.is_supervised
    notifier.ready("12.1 pings/s")
    assert heard(manager) == "READY=1\nSTATUS=12.1 pings/s"
    notifier.status("two\nlines")
    assert heard(manager) == "STATUS=two lines"
    notifier.reloading(1_234_567_890)
    assert heard(manager) == "RELOADING=1\nMONOTONIC_USEC=1234567"
    notifier.stopping("bye")
    assert heard(manager) == "STOPPING=1\nSTATUS=bye"
    notifier.alive()
    assert heard(manager) == "WATCHDOG=1"
    notifier.extend(2.5)
    assert heard(manager) == "EXTEND_TIMEOUT_USEC=2500000"
    assert notifier.lost == 0
    notifier.close()


def test_abstract_sockets() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0mapperd-test-notify")
        manager.settimeout(5)
        with closing(Notifier({"NOTIFY_SOCKET": "@mapperd-test-notify"})) as notifier:
            notifier.ready()
        assert heard(manager) == "READY=1"


@pytest.mark.parametrize("name", ["", "relative/path", "vsock:2:1234"])
def test_without_a_manager_nothing_is_reported(name: str) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": name})
    notifier.ready()
    assert not notifier.is_supervised
    assert notifier.lost == 0


def test_a_manager_that_is_gone_or_deaf_costs_a_counter(
    tmp_path: Path, manager: socket.socket
) -> None:
    with closing(Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")})) as gone:
        gone.alive()
        assert gone.lost == 1
    with closing(Notifier({"NOTIFY_SOCKET": manager.getsockname()})) as deaf:
        for _ in range(10_000):  # nobody reads: it fills, and nobody waits
            deaf.alive()
        assert 0 < deaf.lost < 10_000


def test_long_status_is_cut(manager: socket.socket) -> None:
    with closing(Notifier({"NOTIFY_SOCKET": manager.getsockname()})) as notifier:
        notifier.status("x" * 10_000)
    assert heard(manager) == "STATUS=" + "x" * MAX_STATUS


@pytest.mark.parametrize(
    ("environ", "seconds"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "20000000"}, 20.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": "7"}, 20.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": "8"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({"WATCHDOG_USEC": "1", "WATCHDOG_PID": "me"}, None),
    ],
)
def test_watchdog_time(environ: dict[str, str], seconds: float | None) -> None:
    assert watchdog_s(environ, 7) == seconds


@pytest.mark.slow
def test_long_work_gets_time_while_it_makes_progress_only(manager: socket.socket) -> None:
    parts: list[int] = []
    manager.settimeout(0)
    with closing(Notifier({"NOTIFY_SOCKET": manager.getsockname()})) as notifier:
        with notifier.extended_timeout(lambda: len(parts), limit_s=0.3):
            for part in range(12):
                time.sleep(0.1)
                parts.append(part)
                assert heard(manager) in ("EXTEND_TIMEOUT_USEC=300000", "WATCHDOG=1")
            time.sleep(0.6)  # it hangs
            with contextlib.suppress(BlockingIOError):
                while True:
                    heard(manager)
            time.sleep(0.3)
            with pytest.raises(BlockingIOError):
                heard(manager)
        with pytest.raises(BlockingIOError):
            heard(manager)
