"""Starts daemons and kills them, and plays the world that they map."""

import asyncio
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from oculus_driver import Faults, PlaybackSonar
from tests.mapperd.conftest import make_odometry, make_ping

ROOT = Path(__file__).resolve().parents[4]


def to_and_fro(k: int) -> tuple[float, float]:
    """Lanes of 8 m."""
    return abs(k % 800 - 400) * 0.02, 0.3 * (k // 800)


class World:
    """A sonar that pings as fast as anybody reads, and a vehicle that drives, until closed.

    Args:
        pings: that are played again and again.
        place: x and y of the vehicle's k-th record.
        speed: at which the pings are played.
        faults: of the sonar.

    Attributes:
        sonar: that plays them.
    """

    sonar: PlaybackSonar

    def __init__(
        self,
        pings: list[bytes] | None = None,
        place: Callable[[int], tuple[float, float]] = to_and_fro,
        speed: float = 3.0,
        faults: Faults | None = None,
    ) -> None:
        self._faults = faults
        self.sonar_port = 0
        self._pings = pings or [make_ping(k, start_time=100 + 0.02 * k) for k in range(1, 200)]
        self._place = place
        self._speed = speed
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.odometry_port = int(probe.getsockname()[1])
        self._ready = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._done = asyncio.Event()
        self._thread = threading.Thread(target=lambda: self._loop.run_until_complete(self._go()))
        self._thread.start()
        assert self._ready.wait(20)

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._done.set)
        self._thread.join()
        self._loop.close()

    async def _go(self) -> None:
        async with PlaybackSonar(
            self._pings, standby=True, loops=None, speed=self._speed, faults=self._faults
        ) as sonar:
            self.sonar, self.sonar_port = sonar, sonar.port
            self._ready.set()
            driving = asyncio.create_task(self._drive())
            await self._done.wait()
            driving.cancel()
            await asyncio.gather(driving, return_exceptions=True)

    async def _drive(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            k = 0
            while True:
                k += 1
                record = make_odometry(p=(*self._place(k), 0.0), r=(0.0, 0.0, 0.05))
                link.sendto(record, ("127.0.0.1", self.odometry_port))
                await asyncio.sleep(0.01)


class Daemons:
    """Starts daemons and kills them.

    Args:
        log: file for what they print.
        environ: variables added to those of this process.
    """

    def __init__(self, log: Path, environ: Mapping[str, str] = MappingProxyType({})) -> None:
        self._log = log.open("wb")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.mapperd.session.crash.daemons"],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=os.environ | dict(environ),
        )

    def close(self) -> None:
        self._process.communicate()
        self._log.close()

    def start(self, *words: object) -> int:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([str(word) for word in words]) + "\n")
        self._process.stdin.flush()
        began, process = self._heard()[:2]
        assert began == "began"
        return int(process)

    def ended(self) -> int:
        """Wait for the end; returns the exit code, negative for a signal."""
        ended, _, code = self._heard()
        assert ended == "ended"
        return int(code)

    def _heard(self) -> list[str]:
        assert self._process.stdout is not None
        return self._process.stdout.readline().split()
