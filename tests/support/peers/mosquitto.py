"""Eclipse Mosquitto on loopback, and a cable to it that can be cut or jammed."""

import asyncio
import contextlib
import shutil
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Self

__all__ = ["Cable", "mosquitto_path", "running_mosquitto"]

BEGIN_S = 20.0


def mosquitto_path() -> str | None:
    """Return the path of the broker; Debian installs it in a folder of root's PATH alone."""
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")


@contextlib.contextmanager
def running_mosquitto(folder: Path, port: int, *lines: str) -> Iterator[None]:
    """Run a broker with these additional configuration lines."""
    path = mosquitto_path()
    assert path is not None
    config = folder / "mosquitto.conf"
    options = lines or ("allow_anonymous true",)
    text = [f"listener {port} 127.0.0.1", "persistence false", "user root", *options]
    config.write_text("\n".join(text) + "\n", encoding="utf-8")
    with (folder / "mosquitto.log").open("ab") as log:
        broker = subprocess.Popen([path, "-c", str(config)], stdout=log, stderr=log)  # noqa: S603 ours
    try:
        _wait_for(port, broker)
        yield
    finally:
        broker.terminate()
        broker.wait(BEGIN_S)


def _wait_for(port: int, broker: "subprocess.Popen[bytes]") -> None:
    end_s = time.monotonic() + BEGIN_S
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        assert broker.poll() is None, "the broker ended; see mosquitto.log"
        assert time.monotonic() < end_s, "the broker does not listen"
        time.sleep(0.02)


class Cable:
    """Carries connections to a port; used as an async context manager.

    Attributes:
        port: to connect to.
        jammed: while it is true nothing is carried, and nothing is closed either.
    """

    def __init__(self, to_port: int) -> None:
        self._to_port = to_port
        self._writers: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None
        self.port = 0
        self.jammed = False

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._carry, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        self.cut()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def cut(self) -> None:
        """Reset every connection."""
        for writer in self._writers:
            writer.transport.abort()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            onward = await asyncio.open_connection("127.0.0.1", self._to_port)
        except OSError:
            writer.transport.abort()
            return
        self._writers |= {writer, onward[1]}
        ways = [self._pump(reader, onward[1]), self._pump(onward[0], writer)]
        self._tasks |= {asyncio.create_task(way) for way in ways}

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            async for data in _pieces(reader):
                while self.jammed:  # noqa: ASYNC110 a bool is enough
                    await asyncio.sleep(0.01)
                writer.write(data)
                await writer.drain()
        writer.transport.abort()


async def _pieces(reader: asyncio.StreamReader) -> AsyncIterator[bytes]:
    while data := await reader.read(65536):
        yield data
