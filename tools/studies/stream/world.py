"""A daemon that maps a dive that happens now, and programs beside it, perhaps on other hosts."""

import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from mapperd.client.mirror import MapMirror
from mapperd.config.loader import load_config
from mapperd.config.tree import Config, OctreeConfig
from mapperd.mapping.sonar_map import SonarMap
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet
from mapperd.wire.messages import BLOCK_EDGE, Interest, MapInfo
from studies.report import ROOT
from studies.stream.sent_steps import sent_steps

__all__ = ["RESOLUTION_M", "StreamWorld", "mirror_of"]

RESOLUTION_M = 0.1
SONAR, ODOMETRY, STREAM = 52100, 52200, 7471
START_S = 20.0
STOP_S = 60.0

SETTINGS = """\
device: {{ address: 127.0.0.1, port: {sonar}, ping_rate: highest, range: 10 }}
odometry:
  sources:
    - {{ name: vehicle, link: "udp://127.0.0.1:{odometry}" }}
octree: {{ voxel_resolution: {resolution} }}
recording: {{ enabled: false }}
outofcore: {{ use: {use_store} }}
server: {{ address: "{host}:{stream}", token_file: {token}, max_clients: 200 }}
"""


class StreamWorld:
    """A sonar, a vehicle, a daemon; `with`.

    Args:
        folder: for everything.
        capture: the dive.
        host: address that the stream is served at.
        namespace: that they live in; "" is this host.
        use_store: the map is kept in a file.

    Attributes:
        address, token: of the stream.
    """

    def __init__(
        self,
        folder: Path,
        capture: Path,
        *,
        host: str = "127.0.0.1",
        namespace: str = "",
        use_store: bool = False,
    ) -> None:
        self.folder, self._capture, self._namespace = folder, capture, namespace
        ports = (SONAR, ODOMETRY, STREAM) if namespace else _free_ports(3)
        self._sonar, self._odometry, stream = ports
        self.address = f"{host}:{stream}"
        self.token = folder / "token"
        self.token.write_text(secrets.token_hex(16))
        self.token.chmod(0o600)
        self._settings = folder / "mapperd.yaml"
        self._settings.write_text(
            SETTINGS.format(
                sonar=self._sonar,
                odometry=self._odometry,
                resolution=RESOLUTION_M,
                use_store=str(use_store).lower(),
                host=host,
                stream=stream,
                token=self.token,
            )
        )
        (folder / "run").mkdir()
        self._environ = os.environ | {
            "STATE_DIRECTORY": str(folder / "state"),
            "LOGS_DIRECTORY": str(folder / "logs"),
            "RUNTIME_DIRECTORY": str(folder / "run"),
            "PYTHONPATH": str(ROOT / "tools"),
        }
        self._running: list[subprocess.Popen[bytes]] = []
        self.daemon: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in reversed(self._running):
            if process.poll() is None:
                process.kill()
            process.wait()

    def config(self) -> Config:
        """That the daemon is given."""
        return load_config(self._settings)

    def start_daemon(self) -> None:
        """Map from now on; returns when the daemon answers."""
        words = [sys.executable, "-m", "mapperd", "--config", str(self._settings)]
        words += ["--out", str(self.folder / "out")]
        self.daemon = self.start(words, "daemon")
        until_s = time.monotonic() + START_S
        while self.ask("status", "--once", "--json").returncode != 0:
            if time.monotonic() > until_s or self.daemon.poll() is not None:
                log = (self.folder / "daemon.log").read_text()
                raise SystemExit(f"the daemon does not answer:\n{log[-3000:]}")
            time.sleep(0.1)

    def end_daemon(self, with_signal: signal.Signals = signal.SIGTERM) -> None:
        """End it, cleanly or not."""
        assert self.daemon is not None  # noqa: S101 it was started
        self.daemon.send_signal(with_signal)
        self.daemon.wait(STOP_S)

    def start_dive(self, loops: int = 0) -> subprocess.Popen[bytes]:
        """Begin the dive, from its beginning."""
        words = [sys.executable, "-m", "studies.stream.dive_player", str(self._capture)]
        words += ["--sonar", f"127.0.0.1:{self._sonar}", "--loops", str(loops)]
        words += ["--odometry", f"127.0.0.1:{self._odometry}"]
        return self.start(words, "dive")

    def start(
        self,
        words: Sequence[str],
        name: str,
        namespace: str | None = None,
        *,
        piped: bool = False,
    ) -> subprocess.Popen[bytes]:
        """A program on the daemon's host, or another; its output goes into `name`.log.

        With `piped` it is talked to by its standard input and output instead.
        """
        pipe = subprocess.PIPE if piped else None
        with (self.folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(  # noqa: S603
                [*self._on(namespace), *words],
                stdin=pipe,
                stdout=pipe or log,
                stderr=log,
                env=self._environ,
            )
        self._running.append(process)
        return process

    def ask(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Have `mapperctl` ask the daemon."""
        program = str(Path(sys.executable).with_name("mapperctl"))
        where = ["--socket", str(self.folder / "run" / "mapperd.sock")]
        command = [*self._on(None), program, *words, *where]
        return subprocess.run(  # noqa: S603
            command, capture_output=True, text=True, check=False, env=self._environ
        )

    def status(self) -> dict[str, Any]:
        """Read `mapperctl status --json`."""
        status: dict[str, Any] = json.loads(self.ask("status", "--once", "--json").stdout)
        return status

    def saved_map(self) -> Path:
        """The map as it is now, as a file."""
        done = self.ask("save", "end.map", "--json")
        if done.returncode != 0:
            raise SystemExit(f"the map cannot be saved: {done.stderr}")
        return Path(json.loads(done.stdout)["path"])

    def usage(self) -> tuple[float, int]:
        """CPU seconds that the daemon took so far, and its memory in bytes."""
        assert self.daemon is not None  # noqa: S101 it was started
        fields = Path(f"/proc/{self.daemon.pid}/stat").read_text().rpartition(")")[2].split()
        ticks = int(fields[11]) + int(fields[12])
        pages = int(fields[21])
        return ticks / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE")

    def _on(self, namespace: str | None) -> list[str]:
        name = self._namespace if namespace is None else namespace
        if not name:
            return []
        program = shutil.which("ip", path="/usr/sbin:/sbin:/usr/bin:/bin")
        return [str(program), "netns", "exec", name]


def mirror_of(path: Path, facts: MapInfo) -> MapMirror:
    """What a client of everything should hold, made of a map's file by plain numpy."""
    sonar_map = SonarMap(Config(octree=OctreeConfig(voxel_resolution=facts.resolution_m)))
    sonar_map.load(path)
    keys, units, counts = sonar_map.core.blocks()
    mirror = MapMirror(facts, Interest())
    if not len(keys):
        return mirror
    edge = round(units.shape[1] ** (1 / 3))
    parts = edge // BLOCK_EDGE
    cells = np.where(counts > 0, sent_steps(units * 2.0**-24, facts), np.int8(UNKNOWN))
    # Blocks of the core are z, y, x; each axis is cut into parts of a block of the stream.
    cut = cells.reshape(-1, parts, BLOCK_EDGE, parts, BLOCK_EDGE, parts, BLOCK_EDGE)
    cut = cut.transpose(0, 1, 3, 5, 2, 4, 6).reshape(-1, CELLS)
    zyx = np.stack(np.unravel_index(np.arange(parts**3), (parts,) * 3), axis=-1)
    all_keys = (keys[:, None] * parts + zyx[None, :, ::-1]).reshape(-1, 3).astype(np.int32)
    mirror.put(BlockSet(all_keys, np.zeros(len(cut), np.uint32), cut), 0)
    return mirror


def _free_ports(number: int) -> list[int]:
    with socket.socket() as one, socket.socket() as two, socket.socket() as three:
        probes = (one, two, three)[:number]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [int(probe.getsockname()[1]) for probe in probes]
