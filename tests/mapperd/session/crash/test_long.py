"""A day of pings through a tiny cache of tiles, saved all the time: nothing grows.

One test maps what a recording holds, the other lets a daemon map live while recordings rotate and
clients come and go.

`make crash-soak` does it half a million times.
"""

import contextlib
import json
import os
import random
import re
import signal
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from mapperd.client import MapFollower
from mapperd.config.loader import config_from_text
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.recordings import Tail
from mapperd.session.recovery import StoredSession, map_rest
from mapperd.session_log import Remarks
from mapperd.store.position import RecordingOffset
from mapperd.store.tile_store import TileStore
from oculus_driver.recording import OCULUS, Chunk
from tests.mapperd.conftest import START_NS, make_odometry, make_ping
from tests.mapperd.session.crash.client import Daemons, World, to_and_fro
from tests.mapperd.session.crash.test_crash import settings_of, wait_for_bytes
from tests.support.process import open_files, resident_bytes

pytestmark = pytest.mark.crash

PINGS = int(os.environ.get("SOAK_PINGS", "1000"))
LONG = 20_000
"""Pings from which on the process has taken all the memory that it will ever need."""

MAX_WAITING = 30
"""Pings waiting from which on the sonar, of 50 Hz times its speed, slows down."""

MAX_WAIT_S = 60
"""Wait of pings before some are dropped: a busy machine delays them, and drops none."""

AT_MOST_ONE = ("dive_N_NTNZ.mcap", "#N (deleted)")
"""Files of which none or one is open: a recording, none between two; and the unnamed file of the
trajectory, once some of it has left memory."""

NUMBERS = re.compile("[0-9]+")

SAMPLES = 50
"""Samples of what a daemon holds: some of them are between two clients and two recordings."""

MIN_SPEED = 0.05
"""Of the sonar; it never stands still."""

WARM = 0.2
"""Part of the pings after which everything is as large as it gets."""

S = 1_000_000_000
CONFIG = config_from_text(
    "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
    "outofcore: {tile_size: 6.4, cache_size: 2}\n"
)


class Round(Tail):
    """A vehicle that goes round and round, ten pings a second, with fifty records between."""

    def __init__(self) -> None:
        super().__init__({}, RecordingOffset())
        image = np.zeros((20, 9), dtype=np.uint8)
        image[15:17] = 200
        small = {"image": image, "bearings_cdeg": np.arange(-2000, 2001, 500, dtype=np.int16)}
        self._pings = [make_ping(k + 1, start_time=1 + 0.1 * k, **small) for k in range(400)]

    def __iter__(self) -> Iterator[Chunk]:
        for ping in range(PINGS):
            at = ping % 400
            x, y = (at, 0) if at < 200 else (400 - at, 5)
            t_ns = START_NS + ping * S // 10
            for k in range(5):
                record = make_odometry(p=(0.3 * x, y, 0.0), t=t_ns + k * S // 50, clk="unix")
                yield Chunk("vehicle", "odometry-native", t_ns + k * S // 50, record)
            self.place = RecordingOffset(1, ping)
            yield Chunk("sonar", OCULUS, t_ns + S // 20, self._pings[at])


def test_nothing_grows_however_long_the_dive_is(tmp_path: Path) -> None:
    sonar_map, counters = SonarMap(CONFIG), PipelineCounters()
    poses = OdometryPoses(CONFIG)
    warm_files = 0
    max_bytes = [0] * 10  # in each tenth of the dive
    with TileStore(tmp_path / "dive.map", sonar_map, tile_size_m=6.4, cache_tiles=2) as store:
        stored = StoredSession(store, sonar_map, "long", interval_s=0.2)
        steps = map_rest(stored, poses, Round(), Remarks(), counters=counters)
        for chunk, _ in enumerate(steps):
            if chunk == round(6 * PINGS * WARM):
                warm_files = open_files()
            if chunk % 60 == 0:
                tenth = min(chunk * 10 // (6 * PINGS), 9)
                max_bytes[tenth] = max(max_bytes[tenth], resident_bytes())
        assert open_files() == warm_files
        saves, loaded = store.counters.saves, store.counters.tiles_loaded
    assert counters.pings_mapped > 0.98 * PINGS
    assert loaded > PINGS / 40
    print(  # noqa: T201 for the person who runs half a million
        f"{counters.pings_mapped} pings, {saves} saves, {loaded} tiles loaded; most RSS in each "
        f"tenth, MB: {[round(size / 1e6, 1) for size in max_bytes]}"
    )
    if PINGS >= LONG:
        warm = round(10 * WARM)
        assert max(max_bytes[warm:]) < 1.05 * max(max_bytes[:warm])


class Usage:
    """What a process holds.

    Attributes:
        most_bytes: highest resident memory in each tenth of the dive.
    """

    def __init__(self, process: int) -> None:
        self._folder = Path(f"/proc/{process}")
        self.most_bytes = [0] * 10

    def sample(self, done: float) -> None:
        """Take a sample when a part of the dive, 0 to 1, is done."""
        tenth = min(int(10 * done), 9)
        pages = int((self._folder / "statm").read_text(encoding="ascii").split()[1])
        size = pages * os.sysconf("SC_PAGE_SIZE")
        self.most_bytes[tenth] = max(self.most_bytes[tenth], size)

    def held(self) -> tuple[Counter[str], int]:
        """Return open files and number of threads: the fewest of some seconds, without clients."""
        files, threads = zip(*(self._look() for _ in range(SAMPLES)), strict=True)
        return min(files, key=Counter.total), min(threads)

    def _look(self) -> tuple[Counter[str], int]:
        time.sleep(0.1)
        names = []
        for one in (self._folder / "fd").iterdir():
            with contextlib.suppress(FileNotFoundError):  # just closed
                names.append(NUMBERS.sub("N", one.readlink().name))
        return Counter(names), len(list((self._folder / "task").iterdir()))


def come_and_go(address: str, ends: threading.Event, chance: random.Random) -> int:
    """Connect clients that follow the map for a moment, or leave at once; return how many."""
    clients = 0
    while not ends.wait(chance.uniform(0.05, 0.5)):
        clients += 1
        if chance.random() < 0.3:
            with socket.socket(socket.AF_UNIX) as link:
                link.connect(address)
                link.send(chance.randbytes(chance.randrange(40)))
            continue
        with MapFollower(address) as follower:
            for _ in follower.changes(timeout_s=chance.uniform(0.1, 2.0)):
                if chance.random() < 0.05 or ends.is_set():
                    break
    return clients


def test_a_daemon_does_not_grow_while_clients_come_and_go(tmp_path: Path) -> None:
    world = World(place=lambda k: to_and_fro(k % 8000), speed=3.0)
    daemons = Daemons(tmp_path / "log")
    try:
        text = settings_of(world, tmp_path).replace(
            "max_file: 1, budget: 0", "max_file: 1, budget: 8"
        )
        text += f"behind: {{max_wait: {MAX_WAIT_S}}}\n"
        (tmp_path / "live.yaml").write_text(text, encoding="utf-8")
        process = daemons.start("--config", tmp_path / "live.yaml", "--out", tmp_path / "out")
        wait_for_bytes(process, tmp_path / "recordings", "*", 10_000)
        usage, address = Usage(process), f"{tmp_path}/control"
        held, clients = [], 0
        try:
            with MapFollower(address) as follower:
                follower.complete()
                for first, last in ((0, round(WARM * PINGS)), (round(WARM * PINGS), PINGS)):
                    clients += soak(follower, world, usage, first, last)
                    held.append(usage.held())
        finally:
            os.kill(process, signal.SIGTERM)
        assert daemons.ended() == 0
    finally:
        world.close()
        daemons.close()
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    print(  # noqa: T201 for the person who runs half a million
        f"{summary['pings_mapped']} of {summary['pings_total']} pings, "
        f"{clients} clients; MB at most in each tenth: "
        f"{[round(size / 1e6, 1) for size in usage.most_bytes]}; descriptors and threads after "
        f"the second tenth and the last: {held}"
    )
    assert summary["pings_mapped"] >= PINGS
    assert "too_slow" not in summary["pings_dropped"]  # the sonar waits for the daemon
    dropped = sum(summary["pings_dropped"].values())
    assert summary["pings_mapped"] + dropped == summary["pings_total"]
    (warm_files, warm_threads), (files, threads) = held
    for found in (warm_files, files):
        assert max(found.pop(name, 0) for name in AT_MOST_ONE) <= 1, found
    assert files.total() <= warm_files.total(), files - warm_files
    assert threads <= warm_threads
    if PINGS >= LONG:
        assert max(usage.most_bytes[1:]) < 1.05 * usage.most_bytes[1]


def soak(follower: MapFollower, world: World, usage: Usage, pings: int, until: int) -> int:
    """Let clients come and go until a number of pings is mapped; return how many did."""
    ends = threading.Event()
    with ThreadPoolExecutor() as pool:
        chances = [random.Random(pings + seed) for seed in range(3)]  # noqa: S311 for the instants
        address = follower.link.address
        going = [pool.submit(come_and_go, address, ends, chance) for chance in chances]
        try:
            while pings < until:
                counts = follower.ask("status")["pings"]
                pings, is_behind = counts["mapped"], counts["waiting"] > MAX_WAITING
                speed = world.sonar.speed or 1.0
                slower = max(0.8 * speed, MIN_SPEED)
                world.sonar.speed = slower if is_behind else min(1.05 * speed, 12.0)
                usage.sample(pings / PINGS)
                time.sleep(0.2)
        finally:
            ends.set()
    return sum(clients.result() for clients in going)
