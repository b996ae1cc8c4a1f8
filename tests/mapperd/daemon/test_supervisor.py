"""The tests play the service manager: they hear what it hears, and send its signals."""

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from mapperd.api import OperationError, PoseRequest, ReportedChanges
from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.config.tree import Config
from mapperd.daemon.supervisor import StatusLine, deferred_interrupt, graceful_stop, supervised
from mapperd.daemon.systemd import Notifier
from mapperd.errors import ConfigError
from mapperd.events import EventLog
from mapperd.pipeline.watchdog import Worker
from tests.support.waiting import until


class Daemon:
    """Does nothing, and remembers what it was asked."""

    def __init__(self) -> None:
        self.settings = ConfigStore(Layered(Config(), {}))
        self.events = EventLog(lambda: 0)
        self.changes = ReportedChanges()
        self.asked: list[str] = []
        self.refuses = False
        self.done = 0
        self.waiting = 0

    def status(self) -> dict[str, Any]:
        return {"phase": "mapping", "pings": {"mapped": self.done, "dropped": {"no_pose": 2}}}

    def workers(self) -> list[Worker]:
        return [Worker("integration", self.waiting, self.done)]

    async def save(self, name: str, origin: str) -> dict[str, Any]:
        raise NotImplementedError

    async def reset(self, origin: str) -> dict[str, Any]:
        raise NotImplementedError

    async def reload(self, origin: str) -> dict[str, Any]:
        self.asked.append(f"reload by {origin}")
        if self.refuses:
            raise ConfigError("settings: unreadable")
        return {}

    def localization(self, particles: int = 0) -> dict[str, Any]:
        raise NotImplementedError

    async def initial_pose(self, asked: PoseRequest, origin: str) -> dict[str, Any]:
        raise NotImplementedError

    async def global_localization(self, origin: str) -> dict[str, Any]:
        raise NotImplementedError

    async def request_nomotion_update(self, origin: str) -> dict[str, Any]:
        raise NotImplementedError

    async def set_map(self, name: str, asked: PoseRequest | None, origin: str) -> dict[str, Any]:
        raise NotImplementedError

    async def snapshot(self, origin: str) -> dict[str, Any]:
        self.asked.append(f"snapshot by {origin}")
        if self.refuses:
            raise OperationError("disk full", "cannot_write")
        return {}


class Manager:
    """Listens as systemd does."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(0)
        self.environ = {"NOTIFY_SOCKET": str(path)}
        self.heard: list[str] = []

    def listen(self) -> list[str]:
        while True:
            try:
                self.heard += self._socket.recv(4096).decode().splitlines()
            except BlockingIOError:
                return self.heard

    async def hears(self, line: str, within_s: float = 10.0) -> None:
        await until(lambda: line in self.listen(), within_s)

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    listening = Manager(tmp_path / "notify")
    yield listening
    listening.close()


async def run(daemon: Daemon, manager: Manager, scene: Any, watchdog_s: float | None = 0.3) -> Any:
    stop = asyncio.Event()
    stated: list[str] = []
    with closing(Notifier(manager.environ)) as notifier:
        async with supervised(
            daemon,
            daemon.workers,
            notifier,
            watchdog_s=watchdog_s,
            stop=stop.set,
            print_line=stated.append,
        ):
            return await scene(stop, stated)


def test_ready_first_and_stopping_last(manager: Manager) -> None:
    async def scene(_: asyncio.Event, __: list[str]) -> None:
        await manager.hears("READY=1")
        await manager.hears("WATCHDOG=1")

    asyncio.run(run(Daemon(), manager, scene))
    heard = manager.listen()
    assert heard[0] == "READY=1"
    assert heard[1] == "STATUS=mapping, 0 mapped, 2 dropped"
    assert "STOPPING=1" in heard[-2:]


def test_the_watchdog_is_fed_by_progress_alone(manager: Manager) -> None:
    daemon = Daemon()

    async def scene(_: asyncio.Event, stated: list[str]) -> None:
        daemon.waiting = 1  # and nothing is done from now on, though the loop goes round
        await manager.hears("STATUS=stuck: integration")
        manager.heard.clear()
        await asyncio.sleep(0.4)
        assert "WATCHDOG=1" not in manager.listen()
        assert any(line.startswith("thread MainThread") for line in stated)
        assert any("test_supervisor" in line for line in stated)
        daemon.done += 1
        await manager.hears("WATCHDOG=1")

    asyncio.run(run(daemon, manager, scene))
    [event] = daemon.events.since(0)[0]
    assert event.code == "stuck"


def test_without_a_watchdog_none_is_fed(manager: Manager) -> None:
    async def scene(_: asyncio.Event, __: list[str]) -> None:
        await manager.hears("READY=1")
        await asyncio.sleep(0.1)

    asyncio.run(run(Daemon(), manager, scene, watchdog_s=None))
    assert "WATCHDOG=1" not in manager.listen()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_stopped(manager: Manager, number: int) -> None:
    async def scene(stop: asyncio.Event, _: list[str]) -> None:
        os.kill(os.getpid(), number)
        async with asyncio.timeout(5):
            await stop.wait()
        assert "STOPPING=1" in manager.listen()
        assert signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL)

    asyncio.run(run(Daemon(), manager, scene))


def test_ctrl_c_waits_for_the_end_of_short_work() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    done = []

    def work() -> None:
        with deferred_interrupt():
            signal.raise_signal(signal.SIGINT)
        done.append("work")

    try:
        with pytest.raises(KeyboardInterrupt), deferred_interrupt():
            work()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        with deferred_interrupt():
            done.append("without Ctrl-C")
    finally:
        signal.signal(signal.SIGINT, before)
    assert done == ["work", "without Ctrl-C"]


def test_a_second_ctrl_c_ends_work_that_takes_long() -> None:
    def work() -> None:
        with deferred_interrupt():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
            pytest.fail("the work went on")

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            work()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_ctrl_c_of_another_effect_keeps_it() -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    try:
        with deferred_interrupt():
            signal.raise_signal(signal.SIGINT)
            assert heard == [signal.SIGINT]
    finally:
        signal.signal(signal.SIGINT, before)


ENDLESS = """
import signal, sys, time
from mapperd.cli.mapperd import main
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.session.store_session import SqlitePersistence
signal.signal(signal.SIGINT, signal.default_int_handler)
for persistence in (MemoryPersistence, SqlitePersistence):
    persistence.end = lambda _: (print("ending", flush=True), time.sleep(60))
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(
    ("settings", "kept"),
    [
        ("outofcore: {use: true}\n", "saved last; the next start maps the rest"),
        ("outofcore: {use: true}\nrecording: {enabled: false}\n", "after that is lost"),
        ("", "the map was in memory and is lost; its recordings are in"),
        ("recording: {enabled: false}\n", "is lost, and recording.enabled is off"),
    ],
)
def test_second_signal_ends_at_once_and_states_what_is_kept(
    tmp_path: Path, settings: str, kept: str, number: int
) -> None:
    (tmp_path / "a.yaml").write_text(
        f"device: {{address: 127.0.0.1, port: 1}}\nservice: {{state_folder: {tmp_path}}}\n"
        f"{settings}",
        encoding="utf-8",
    )
    words = ["--config", str(tmp_path / "a.yaml"), "--out", str(tmp_path / "out")]
    with subprocess.Popen(  # noqa: S603 our own lines
        [sys.executable, "-c", ENDLESS, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        while "begins" not in program.stderr.readline():
            pass
        time.sleep(0.2)
        program.send_signal(number)
        assert program.stdout.readline() == "ending\n"
        program.send_signal(number)
        left = program.stderr.read()
        assert program.wait(10) == 128 + number
    assert "Traceback" not in left
    assert kept in left.splitlines()[-1]


@pytest.mark.parametrize("refuses", [False, True])
def test_reload_reports_when_it_begins_and_ends(manager: Manager, *, refuses: bool) -> None:
    daemon = Daemon()
    daemon.refuses = refuses

    async def scene(_: asyncio.Event, __: list[str]) -> None:
        await manager.hears("READY=1")
        manager.heard.clear()
        os.kill(os.getpid(), signal.SIGHUP)
        await manager.hears("READY=1")
        heard = [line.partition("=")[0] for line in manager.heard]
        assert heard.index("RELOADING") < heard.index("READY")
        assert any(line.startswith("MONOTONIC_USEC=") for line in manager.heard)

    asyncio.run(run(daemon, manager, scene))
    assert daemon.asked == ["reload by SIGHUP"]
    assert [event.code for event in daemon.events.since(0)[0]] == ["reload_failed"] * refuses


@pytest.mark.parametrize("refuses", [False, True])
def test_snapshot_on_signal(manager: Manager, *, refuses: bool) -> None:
    daemon = Daemon()
    daemon.refuses = refuses

    async def scene(_: asyncio.Event, __: list[str]) -> None:
        os.kill(os.getpid(), signal.SIGUSR1)
        await until(lambda: bool(daemon.asked))

    asyncio.run(run(daemon, manager, scene))
    assert daemon.asked == ["snapshot by SIGUSR1"]
    assert [event.code for event in daemon.events.since(0)[0]] == ["snapshot_failed"] * refuses


def test_dump_on_signal(manager: Manager) -> None:
    async def scene(_: asyncio.Event, stated: list[str]) -> None:
        os.kill(os.getpid(), signal.SIGUSR2)
        await until(lambda: bool(stated) and stated[-1].startswith("status"))
        assert stated[-1].startswith("status: {'phase': 'mapping'")
        assert any("scene" in line for line in stated)

    asyncio.run(run(Daemon(), manager, scene))


def numbers_of(line: str) -> list[str]:
    """Numbers of a line, in its order."""
    return re.findall(r"\d+(?:\.\d+)?", line)


def test_status_line_has_phase_rate_counts_link_and_memory() -> None:
    line = StatusLine()
    status: dict[str, Any] = {
        "phase": "mapping",
        "pings": {"mapped": 100, "dropped": {}},
        "sonar": {"state": "pinging"},
        "map": {"memory_bytes": 50 << 20},
    }
    first = line.of(status, 10.0)
    assert numbers_of(first) == ["100", "50"], "no rate yet, and nothing dropped"
    assert "mapping" in first
    assert "pinging" in first
    status["pings"] = {"mapped": 125, "dropped": {"no_pose": 3, "too_slow": 1}}
    assert numbers_of(line.of(status, 12.0)) == ["12.5", "125", "4", "50"]
    assert numbers_of(line.of({}, 12.0)) == ["0"]


def test_nobody_is_there_to_reload_at_the_start_and_the_end(manager: Manager) -> None:
    asking = (signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
    before = [signal.getsignal(number) for number in asking]

    async def scene(_: asyncio.Event, __: list[str]) -> None:
        await manager.hears("READY=1")

    with graceful_stop():
        for _ in range(2):
            for number in asking:
                os.kill(os.getpid(), number)
            asyncio.run(run(Daemon(), manager, scene))
        for number in asking:
            os.kill(os.getpid(), number)
    assert [signal.getsignal(number) for number in asking] == before
