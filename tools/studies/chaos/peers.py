"""The daemon's world: a sonar, a vehicle's odometry and a broker that can be broken."""

import math
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Self

import msgpack

__all__ = ["Broker", "CircleOdometry", "Program", "Sonar"]

RATE_HZ = 50.0
RADIUS_M = 6.0
TURN_S = 60.0
DEPTH_M = 1.0


class Program:
    """A process that can be stopped, frozen and started again.

    Args:
        command: the program and its words.
        log: receives its output.
    """

    def __init__(self, command: list[str], log: Path) -> None:
        self._command = command
        self._log = log
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Run it, if it does not run."""
        if self._process is None:
            with self._log.open("ab") as log:
                self._process = subprocess.Popen(self._command, stdout=log, stderr=log)  # noqa: S603

    def kill(self) -> None:
        """End it at once."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def freeze(self) -> None:
        """Let it do nothing, as if its cable were pulled."""
        if self._process is not None:
            self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        if self._process is not None:
            self._process.send_signal(signal.SIGCONT)


class Sonar(Program):
    """A recording that is played for ever, with faults of its own."""

    def __init__(self, recording: Path, port: int, status_port: int, log: Path) -> None:
        words = [sys.executable, "-m", "oculus_driver.cli", "play", str(recording), "--loop"]
        words += ["--listen", "127.0.0.1", "--port", str(port), "--address", "127.0.0.1"]
        words += ["--status-to", "127.0.0.1", "--status-port", str(status_port)]
        words += ["--cut", "0.005", "--lose", "0.01", "--garbage", "0.005"]
        words += ["--restart-ids", "0.002"]
        super().__init__(words, log)


class Broker(Program):
    """Mosquitto, where it is installed."""

    def __init__(self, port: int, folder: Path) -> None:
        settings = folder / "mosquitto.conf"
        settings.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
        program = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/bin")
        self.is_there = program is not None
        super().__init__([program or "mosquitto", "-c", str(settings)], folder / "mosquitto.log")

    def start(self) -> None:
        """Run it, where it is installed."""
        if self.is_there:
            super().start()


class CircleOdometry:
    """Native records of a vehicle on a circle, `with`.

    Args:
        port: where the daemon listens.

    Attributes:
        is_silent: nothing is sent.
    """

    def __init__(self, port: int) -> None:
        self.is_silent = False
        self._address = ("127.0.0.1", port)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not self._stop.wait(1 / RATE_HZ):
                if not self.is_silent:
                    out.sendto(record(time.time_ns()), self._address)


def record(now_ns: int) -> bytes:
    """Where the vehicle is at a time, as a native record (docs/guides/odometry.md)."""
    angle = 2 * math.pi * (now_ns / 1e9 / TURN_S % 1.0)
    yaw = angle + math.pi / 2
    speed_mps = 2 * math.pi * RADIUS_M / TURN_S
    packed: bytes = msgpack.packb(
        {
            "v": 1,
            "t": now_ns,
            "clk": "unix",
            "w": "enu",
            "b": "flu",
            "p": [RADIUS_M * math.cos(angle), RADIUS_M * math.sin(angle), -DEPTH_M],
            "q": [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)],
            "u": [speed_mps, 0.0, 0.0],
            "r": [0.0, 0.0, 2 * math.pi / TURN_S],
            "rst": 0,
            "src": "chaos",
        }
    )
    return packed
