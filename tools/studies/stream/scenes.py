"""What is done to the stream, and what came of it."""

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.tile_store import TileStore
from mapperd.wire.messages import BLOCK_EDGE, MapInfo
from studies.stream.link import SERVER, LinkShape, NotPermittedError, joined_hosts
from studies.stream.staleness import Knowledge, Staleness, staleness
from studies.stream.watching import read_log
from studies.stream.world import RESOLUTION_M, StreamWorld, mirror_of

__all__ = [
    "FleetOutcome",
    "TetherOutcome",
    "WatcherOutcome",
    "fleet",
    "tether",
    "watchers",
    "write_far_map",
]


MIN_DISTANCE_M, MAX_DISTANCE_M = 30.0, 42.0
DEPTH_M, HEIGHT_M, WAVE_M = -8.0, 1.5, 7.0
WATER_M = 1.2
OCCUPIED, FREE = 3.0, -4.0


def write_far_map(path: Path, config: Config) -> None:
    """Write the file of such a map.

    Args:
        path: that is not there yet.
        config: of the daemon that is to open it.
    """
    sonar_map = SonarMap(config)
    step_m = sonar_map.resolution_m
    axis = np.arange(-MAX_DISTANCE_M, MAX_DISTANCE_M, step_m) + step_m / 2
    x, y = (each.ravel() for each in np.meshgrid(axis, axis))
    away_m = np.hypot(x, y)
    ring = (away_m > MIN_DISTANCE_M) & (away_m < MAX_DISTANCE_M)
    x, y = x[ring], y[ring]
    dice = np.random.default_rng(1)
    z = DEPTH_M + HEIGHT_M * np.sin(x / WAVE_M) * np.cos(y / WAVE_M)
    for above_m in np.arange(0, WATER_M, step_m):
        points = np.stack([x, y, z + above_m], axis=1)
        middle = FREE if above_m > step_m else OCCUPIED
        sonar_map.core.set_log_odds(points, middle + dice.normal(0, 0.3, len(points)))
    _, bricks = sonar_map.core.bricks_since(0)
    outofcore = config.outofcore
    path.parent.mkdir(parents=True, exist_ok=True)
    with TileStore(
        path,
        SonarMap(config),
        tile_size_m=outofcore.tile_size,
        cache_tiles=outofcore.cache_size,
    ) as store:
        store.restore([(key, brick) for key, _, brick in bricks], whole=True)


Log = Callable[[str], None]

NEAR_M = 10.0
"""Around the vehicle: what a pilot steers by."""

JOINS_S = 40.0
"""Into the dive the client on the bad link comes: the map of so long is its backlog."""

FRESH_S = 3.0
STEP_NS = 200_000_000
QUIET_S = 3
SETTLE_S = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class TetherOutcome:
    """Of one client on a bad link.

    Attributes:
        shape: of the link.
        equal: its map, the reference's and the daemon's are the same in the end.
        ages: of its map, from the moment on when it had first been sent what is near.
        caught_up_s: after it joined, until what is far was not older than 3 s for once.
        bytes: that it received.
        traffic: (K, 2) time in ns, bytes until then.
        joined_ns: when it began.
        lost_packets: on the way to it.
    """

    shape: LinkShape
    equal: bool
    ages: Staleness
    caught_up_s: float | None
    bytes: int
    traffic: NDArray[np.int64]
    joined_ns: int
    lost_packets: int

    def near_s(self) -> tuple[float, float]:
        """Worst and 95th percentile of the age of what is near, once it was there."""
        near = self.ages.near_s[self._first() :]
        return float(near.max()), float(np.percentile(near, 95))

    def first_near_s(self) -> float:
        """After it joined, until what is near was there for the first time."""
        return float(self.ages.times_ns[self._first()] - self.joined_ns) / 1e9

    def _first(self) -> int:
        fresh = np.nonzero(self.ages.near_s <= 1.0)[0]
        return int(fresh[0]) if len(fresh) else len(self.ages.near_s) - 1


@dataclass(frozen=True, slots=True)
class FleetOutcome:
    """Of many clients with bad luck."""

    clients: int
    seconds: float
    equal: int
    connects: int
    restarts: int
    blocks_sent: int
    blocks: int


@dataclass(frozen=True, slots=True)
class WatcherOutcome:
    """What watching costs the daemon.

    Attributes:
        clients: that watched.
        cores: CPU seconds a second, of the daemon.
        pings_per_s: that it mapped meanwhile.
        memory_bytes: of the process in the end.
        stream: the part of its status on the stream.
    """

    clients: int
    cores: float
    pings_per_s: float
    memory_bytes: int
    stream: dict[str, Any] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """For a report."""
        return asdict(self)


def tether(folder: Path, capture: Path, shape: LinkShape, dice: int, log: Log) -> TetherOutcome:
    """One client behind a bad link joins in the middle of a dive, where a large map is already."""
    with ExitStack() as stack:
        try:
            server, client, link = stack.enter_context(joined_hosts(shape, dice))
        except NotPermittedError as error:
            log(f"no hosts ({error}): the link is a relay in a process")
            server, client, link = "", "", None
        world = stack.enter_context(
            StreamWorld(
                folder,
                capture,
                host=SERVER if server else "127.0.0.1",
                namespace=server,
                use_store=True,
            )
        )
        write_far_map(folder / "state" / "mapperd.map", world.config())
        world.start_daemon()
        reference = _watch(world, "reference", server)
        dive = world.start_dive(loops=1)
        _wait(JOINS_S, "the dive has begun", log)
        joined_ns = time.time_ns()
        far = world.address if server else _relayed(world)
        judged = _watch(world, "judged", client, far)
        _until_over(world, log)
        dive.kill()
        for watcher in (reference, judged):
            watcher.send_signal(signal.SIGTERM)
            watcher.wait(300)
        mapped = mirror_of(world.saved_map(), _facts(world)).digest()
        logs = [read_log(folder / f"{name}.npz") for name in ("reference", "judged")]
        digests = {str(log["facts"][0]) for log in logs} | {mapped}
        ages = _ages(logs[0], logs[1], joined_ns)
        late = np.nonzero(ages.far_s <= FRESH_S)[0]
        caught_up_s = float(ages.times_ns[late[0]] - joined_ns) / 1e9 if len(late) else None
        traffic = np.asarray(logs[1]["traffic"], np.int64)
        return TetherOutcome(
            shape,
            len(digests) == 1,
            ages,
            caught_up_s,
            int(traffic[-1, 1]) if len(traffic) else 0,
            traffic,
            joined_ns,
            0 if link is None else link.down.lost,
        )


def fleet(folder: Path, capture: Path, clients: int, seconds: float, log: Log) -> FleetOutcome:
    """Many clients whose links break and stall; the daemon is ended twice, once by force."""
    with StreamWorld(folder, capture, use_store=True) as world:
        world.start_daemon()
        dive = world.start_dive()
        halves = [clients - clients // 2, clients // 2]
        programs = [
            _fleet(world, number, half, seconds)
            for half, number in zip(halves, (0, 1000), strict=True)
        ]
        began_s = time.monotonic()
        restarts = 0
        for share, with_signal in ((0.35, signal.SIGTERM), (0.7, signal.SIGKILL)):
            _wait(began_s + share * seconds - time.monotonic(), "the fleet watches", log)
            log(f"the daemon gets {with_signal.name}")
            world.end_daemon(with_signal)
            world.start_daemon()
            restarts += 1
        _wait(began_s + seconds - time.monotonic(), "the fleet watches", log)
        dive.kill()
        _wait(SETTLE_S, "the last pings", log)
        facts = _facts(world)
        mapped = mirror_of(world.saved_map(), facts)
        lives: list[dict[str, Any]] = []
        for program in programs:
            out, _ = program.communicate(b"", timeout=300)
            lives += json.loads(out)
        return FleetOutcome(
            clients,
            seconds,
            sum(life["digest"] == mapped.digest() for life in lives),
            sum(life["connects"] for life in lives),
            restarts,
            sum(life["blocks"] for life in lives),
            len(mapped),
        )


def watchers(folder: Path, capture: Path, clients: int, seconds: float, log: Log) -> WatcherOutcome:
    """The daemon's cost with so many clients that want everything but images."""
    with StreamWorld(folder, capture) as world:
        world.start_daemon()
        programs = [
            world.start(_answers(world, f"watcher-{number}", everything=True), f"watcher-{number}")
            for number in range(clients)
        ]
        world.start_dive(loops=1)
        _wait(5.0, "all are there", log)
        before_s, before = world.usage()[0], world.status()["pings"]["mapped"]
        began_s = time.monotonic()
        _wait(seconds, f"{clients} clients watch", log)
        used_s, memory = world.usage()
        took_s = time.monotonic() - began_s
        status = world.status()
        for program in programs:
            program.send_signal(signal.SIGTERM)
        return WatcherOutcome(
            clients,
            (used_s - before_s) / took_s,
            (status["pings"]["mapped"] - before) / took_s,
            memory,
            status["servers"]["stream"],
        )


def _watch(
    world: StreamWorld, name: str, namespace: str, address: str = ""
) -> subprocess.Popen[bytes]:
    return world.start(_answers(world, name, address, until_complete=True), name, namespace)


def _relayed(world: StreamWorld) -> str:
    """Address of a bad link to the daemon, inside a process."""
    words = [sys.executable, "-m", "studies.stream.relay", world.address]
    program = world.start(words, "relay", piped=True)
    assert program.stdout is not None  # noqa: S101 it is piped
    return f"127.0.0.1:{int(program.stdout.readline())}"


def _answers(
    world: StreamWorld,
    name: str,
    address: str = "",
    *,
    until_complete: bool = False,
    everything: bool = False,
) -> list[str]:
    to = address or world.address
    words = [sys.executable, "-m", "studies.stream.watching", to, str(world.token)]
    words += [str(world.folder / f"{name}.npz")]
    words += ["--until-complete"] if until_complete else []
    return words + (["--everything"] if everything else [])


def _fleet(world: StreamWorld, dice: int, clients: int, seconds: float) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", "studies.stream.fleet", world.address, str(world.token)]
    words += ["--clients", str(clients), "--seconds", str(seconds), "--dice", str(dice)]
    return world.start(words, f"fleet-{dice}", piped=True)


def _facts(world: StreamWorld) -> MapInfo:
    """Of the map as the stream sends them; what a digest depends on."""
    config = world.config()
    occupied, free = config.occupied_threshold, config.free_threshold
    return MapInfo(
        "",
        RESOLUTION_M,
        config.stream.log_odds_step,
        math.log(occupied / (1 - occupied)),
        math.log(free / (1 - free)),
    )


def _ages(reference: dict[str, Any], judged: dict[str, Any], joined_ns: int) -> Staleness:
    times = np.asarray(reference["pose_times_ns"], np.int64)
    moments = np.arange(joined_ns, int(times[-1]), STEP_NS)
    at = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, None)
    places = np.asarray(reference["poses_m"], np.float64)[at]
    known = [
        Knowledge(log["times_ns"], log["keys"], log["digests"], log["stamps_ns"])
        for log in (reference, judged)
    ]
    block_m = RESOLUTION_M * BLOCK_EDGE
    return staleness(known[0], known[1], moments, places, radius_m=NEAR_M, block_m=block_m)


def _until_over(world: StreamWorld, log: Log) -> None:
    """Until no ping comes any more."""
    last, same = -1, 0
    while same < QUIET_S:
        mapped = int(world.status()["pings"]["mapped"])
        same = same + 1 if mapped == last else 0
        last = mapped
        _wait(1.0, f"{mapped} pings are mapped", log)


def _wait(seconds: float, what: str, log: Log) -> None:
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0:
        log(f"{what} ({left_s:.0f} s)")
        time.sleep(min(left_s, 1.0))
