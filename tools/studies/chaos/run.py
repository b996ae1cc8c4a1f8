"""`make chaos`: a daemon, and everything around it failing at random.

Sonar off at boot, cable pulled, sonar rebooted, odometry silent, broker dead, clock stepped by an
hour, disk full: the daemon stays up, and at the end its map is that of its own recording, played
again as it was mapped. Prints what happened, and fails if any of that is not so.
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from mapperd.config.tree import Config, OctreeConfig
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import StoreReader
from studies.chaos.peers import Broker, CircleOdometry, Sonar
from studies.chaos.shim import Shim

__all__ = ["FAULTS", "Trouble", "trouble"]


FAULTS = {
    "cable_pulled": (1.0, 6.0),
    "sonar_rebooted": (1.0, 6.0),
    "odometry_silent": (0.5, 6.0),
    "broker_dead": (2.0, 15.0),
    "clock_stepped": (1.0, 20.0),
    "disk_full": (0.5, 4.0),
}
"""Least and longest time that each lasts, s."""

PAUSE_S = (0.2, 4.0)
STEP_S = 3600.0


@dataclass(frozen=True, slots=True)
class Trouble:
    """One thing that goes wrong.

    Attributes:
        begin_s, end_s: when, after the start.
        fault: which of `FAULTS`.
        amount: of a clock's step, s.
    """

    begin_s: float
    end_s: float
    fault: str
    amount: float = 0.0


def trouble(dice: int, duration_s: float) -> Iterator[Trouble]:
    """Everything that goes wrong, in order; troubles overlap, but none with its like.

    Args:
        dice: another number, another story.
        duration_s: of all; nothing lasts longer.
    """
    random = Random(dice)  # noqa: S311 a story, not a secret
    free_s = dict.fromkeys(FAULTS, 0.0)
    now_s = 0.0
    while True:
        now_s += random.uniform(*PAUSE_S)
        idle = sorted(fault for fault, end_s in free_s.items() if end_s <= now_s)
        fault = random.choice(idle or sorted(FAULTS))
        begin_s = max(now_s, free_s[fault])
        end_s = begin_s + random.uniform(*FAULTS[fault])
        if end_s > duration_s:
            return
        free_s[fault] = end_s
        yield Trouble(begin_s, end_s, fault, random.choice((-STEP_S, STEP_S)))


BOOT_S = 4.0
"""The sonar is off for so long at first."""

HEAL_S = 12.0
"""At the end nothing fails for so long: what can be caught up is."""

STOP_S = 60.0
RESOLUTION_M = 0.1

SETTINGS = """\
device: {{ address: 127.0.0.1, port: {sonar}, ping_rate: highest }}
odometry:
  sources:
    - {{ name: vehicle, link: "udp://127.0.0.1:{odometry}" }}
octree: {{ voxel_resolution: {resolution} }}
mounting: {{ orientation: {{ pitch: 30.0 }} }}
outofcore: {{ use: true, cache_size: 4, tile_size: 5.0 }}
recording: {{ max_file: 8, free_floor: 0 }}
visualization: {{ tile_save_interval: 1.0 }}
mqtt: {{ host: 127.0.0.1, port: {broker} }}
"""


class ChaosWorld:
    """The daemon and all that it talks to.

    Args:
        folder: for everything.
        recording: what the sonar plays.
    """

    def __init__(self, folder: Path, recording: Path, stack: ExitStack) -> None:
        self.folder = folder
        ports = free_ports(5)
        self.odometry = stack.enter_context(CircleOdometry(ports[1]))
        self.sonar = Sonar(recording, ports[0], ports[3], folder / "sonar.log")
        self.broker = Broker(ports[2], folder)
        self.shim = stack.enter_context(closing(Shim(folder)))
        settings = folder / "mapperd.yaml"
        settings.write_text(
            SETTINGS.format(
                sonar=ports[0], odometry=ports[1], broker=ports[2], resolution=RESOLUTION_M
            )
        )
        self.state, self.logs = folder / "state", folder / "logs"
        (folder / "run").mkdir()
        self.environ = os.environ | {
            "STATE_DIRECTORY": str(self.state),
            "LOGS_DIRECTORY": str(self.logs),
            "RUNTIME_DIRECTORY": str(folder / "run"),
        }
        stack.callback(self.broker.kill)
        stack.callback(self.sonar.kill)
        self._log = stack.enter_context((folder / "daemon.log").open("wb"))
        # Through a pipe: a disk that is full for the daemon takes its lines all the same.
        lines = stack.enter_context(
            subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=self._log)  # noqa: S607
        )
        self.daemon = subprocess.Popen(  # noqa: S603 our own words
            [sys.executable, "-m", "mapperd", "--config", settings, "--out", folder / "live"],
            env=self.environ | self.shim.environ,
            stdout=lines.stdin,
            stderr=lines.stdin,
        )
        stack.callback(self.daemon.kill)

    def faults(self) -> dict[str, tuple[Callable[[float], None], Callable[[], None]]]:
        """By name: what begins it, given an amount, and what ends it."""
        return {
            "cable_pulled": (lambda _: self.sonar.freeze(), self.sonar.thaw),
            "sonar_rebooted": (lambda _: self.sonar.kill(), self.sonar.start),
            "odometry_silent": (lambda _: self.silence(on=True), lambda: self.silence(on=False)),
            "broker_dead": (lambda _: self.broker.kill(), self.broker.start),
            "clock_stepped": (self.shim.step_clock, lambda: self.shim.step_clock(0.0)),
            "disk_full": (
                lambda _: self.shim.fill_disk(full=True),
                lambda: self.shim.fill_disk(full=False),
            ),
        }

    def silence(self, *, on: bool) -> None:
        """Let the odometry be silent, or not."""
        self.odometry.is_silent = on

    def status(self) -> dict[str, Any] | None:
        """Read `mapperctl status`; None without an answer."""
        command: list[str | Path] = [
            Path(sys.executable).with_name("mapperctl"),
            "status",
            "--once",
            "--json",
            "--socket",
            self.folder / "run" / "mapperd.sock",
        ]
        done = subprocess.run(  # noqa: S603 our own words
            command, env=self.environ, capture_output=True, check=False, timeout=30
        )
        if done.returncode:
            return None
        status: dict[str, Any] = json.loads(done.stdout)
        return status


def free_ports(count: int) -> list[int]:
    """Ports that nobody uses just now."""
    with ExitStack() as stack:
        sockets = [stack.enter_context(closing(socket.socket())) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [int(one.getsockname()[1]) for one in sockets]


def play(world: ChaosWorld, script: list[Trouble], duration_s: float) -> Counter[str]:
    """Let everything happen; returns how often each did.

    Raises:
        RuntimeError: the daemon has ended.
    """
    faults = world.faults()
    moments = [(one.begin_s, True, one) for one in script]
    moments += [(one.end_s, False, one) for one in script]
    happened: Counter[str] = Counter()
    began_s = time.monotonic()
    for at_s, begins, one in sorted(moments, key=lambda moment: moment[:2]):
        wait(world, began_s + at_s)
        begin, end = faults[one.fault]
        if begins:
            begin(one.amount)
            happened[one.fault] += 1
        else:
            end()
        show(time.monotonic() - began_s, duration_s, happened)
    wait(world, began_s + duration_s)
    return happened


def wait(world: ChaosWorld, until_s: float) -> None:
    """Sleep, as long as the daemon lives."""
    while (left_s := until_s - time.monotonic()) > 0:
        if world.daemon.poll() is not None:
            raise RuntimeError(f"the daemon ended with {world.daemon.returncode}")
        time.sleep(min(left_s, 0.2))


def show(now_s: float, duration_s: float, happened: Counter[str]) -> None:
    """One line that shows how far it is."""
    print(
        f"\r{now_s:6.0f} of {duration_s:.0f} s, {happened.total()} troubles",
        end="",
        file=sys.stderr,
    )


def stored_map(world: ChaosWorld) -> str:
    """Fingerprint of the map on disk."""
    [path] = sorted(world.state.rglob("*.map"))
    whole = SonarMap(Config(octree=OctreeConfig(voxel_resolution=RESOLUTION_M)))
    with StoreReader(path) as reader:
        reader.load(whole)
    return whole.sha256()


def replayed_map(world: ChaosWorld) -> dict[str, Any]:
    """Summary of the recording, played again as it was mapped."""
    command: list[str | Path] = [
        sys.executable,
        "-m",
        "mapperd",
        "--replay",
        world.logs,
        "--as-recorded",
    ]
    subprocess.run(  # noqa: S603 our own words
        [*command, "--out", world.folder / "again"], env=world.environ, check=True
    )
    summary: dict[str, Any] = json.loads((world.folder / "again" / "summary.json").read_text())
    return summary


def main() -> int:
    """Run it; 0 if all held."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("recording", type=Path, help="what the sonar plays, for ever")
    add("--duration", type=float, default=600.0, metavar="S", help="(default: 600)")
    add("--dice", type=int, default=1, metavar="N", help="another number, another story")
    add("--keep", type=Path, metavar="DIR", help="leave everything here")
    args = parser.parse_args()
    with ExitStack() as stack:
        folder = args.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        world = ChaosWorld(folder, args.recording.resolve(), stack)
        world.broker.start()
        time.sleep(BOOT_S)
        world.sonar.start()
        script = list(trouble(args.dice, args.duration - HEAL_S))
        happened = play(world, script, args.duration)
        status = world.status()
        world.daemon.send_signal(signal.SIGTERM)
        code = world.daemon.wait(STOP_S)
        kept, again = stored_map(world), replayed_map(world)
        return verdict(happened, status, code, kept, again)


def verdict(
    happened: Counter[str],
    status: dict[str, Any] | None,
    code: int,
    kept: str,
    again: dict[str, Any],
) -> int:
    """Print what happened; 0 if all held."""
    problems = []
    if code != 0:
        problems.append(f"the daemon ended with {code}")
    if status is None:
        problems.append("the daemon does not report its status")
    else:
        pings = status["pings"]
        counted = pings["mapped"] + sum(pings["dropped"].values()) + pings["waiting"]
        if counted != pings["total"]:
            problems.append(f"{pings['total']} pings, but {counted} accounted for")
    if kept != again["map_sha256"]:
        problems.append(f"the map is {kept[:12]}, its recording gives {again['map_sha256'][:12]}")
    if not again["pings_mapped"]:
        problems.append("not a single ping was mapped")
    facts = {
        "troubles": dict(sorted(happened.items())),
        "pings": None if status is None else status["pings"],
        "recording": None if status is None else status["recording"],
        "store": None if status is None else status["store"],
        "replayed": {key: again[key] for key in ("pings_total", "pings_mapped", "pings_dropped")},
        "map_sha256": kept,
        "problems": problems,
    }
    print(json.dumps(facts, indent=2))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
