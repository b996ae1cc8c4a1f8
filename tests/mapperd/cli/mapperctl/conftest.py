"""A daemon in another thread, as `mapperctl` meets it."""

import asyncio
import ssl
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import trustme

from mapperd.wire.auth import Limits
from tests.support.control_server import TOKEN, Served, served
from tests.support.mapperctl import call

__all__ = ["call"]


@pytest.fixture(autouse=True)
def _no_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("MAPPERD_CONFIG", "RUNTIME_DIRECTORY", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    for name in ("XDG_CONFIG_HOME", "XDG_RUNTIME_DIR", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "xdg"))
    monkeypatch.setattr("mapperd.config.layers.load_settings.__defaults__", (tmp_path / "etc",))
    monkeypatch.setattr("mapperd.config.paths.socket_places.__defaults__", (tmp_path / "run",))


class Running:
    """A server in a thread of its own."""

    def __init__(self, folder: Path, tls: tuple[ssl.SSLContext, ssl.SSLContext]) -> None:
        self._ready, self._folder, self._tls = threading.Event(), folder, tls
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))
        self._thread.start()
        assert self._ready.wait(60)
        self.socket = folder / "mapperd.sock"

    async def _run(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        async with served(self._folder, limits=Limits(operators=4), tls=self._tls) as one:
            self.one: Served = one
            self._ready.set()
            await self._end.wait()

    def port(self, kind: str) -> int:
        port = self.one.listeners[kind].socket.getsockname()[1]
        assert isinstance(port, int)
        return port

    def stop(self) -> None:
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(60)


@pytest.fixture
def running(short: Path, tls: tuple[ssl.SSLContext, ssl.SSLContext]) -> Iterator[Running]:
    daemon = Running(short, tls)
    yield daemon
    daemon.stop()


@pytest.fixture
def token_file(tmp_path: Path) -> Path:
    path = tmp_path / "token"
    path.write_bytes(TOKEN + b"\n")
    path.chmod(0o600)
    return path


@pytest.fixture
def trusted(authority: trustme.CA, tmp_path: Path) -> Path:
    path = tmp_path / "ca.pem"
    authority.cert_pem.write_to_path(str(path))
    return path
