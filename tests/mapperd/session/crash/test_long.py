"""A day of pings through a tiny cache of tiles, saved all the time: nothing grows.

One test maps what a recording holds, the other lets a daemon map live while recordings rotate and
clients come and go.

`make crash-soak` does it half a million times.
"""

import json
import os
import random
import signal
import socket
import threading
import time
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
    """What a process holds, sampled; the lowest of a tenth is that without clients.

    Attributes:
        most_bytes: highest resident memory in each tenth of the dive.
        least_files, least_threads: fewest descriptors and threads in each tenth.
    """

    def __init__(self, process: int) -> None:
        self._folder = Path(f"/proc/{process}")
        self.most_bytes = [0] * 10
        self.least_files = [1 << 30] * 10
        self.least_threads = [1 << 30] * 10

    def sample(self, done: float) -> None:
        """Take a sample when a part of the dive, 0 to 1, is done."""
        tenth = min(int(10 * done), 9)
        pages = int((self._folder / "statm").read_text(encoding="ascii").split()[1])
        size = pages * os.sysconf("SC_PAGE_SIZE")
        self.most_bytes[tenth] = max(self.most_bytes[tenth], size)
        for least, name in ((self.least_files, "fd"), (self.least_threads, "task")):
            least[tenth] = min(least[tenth], len(list((self._folder / name).iterdir())))


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
    ends = threading.Event()
    try:
        text = settings_of(world, tmp_path).replace(
            "max_file: 1, budget: 0", "max_file: 1, budget: 8"
        )
        (tmp_path / "live.yaml").write_text(text, encoding="utf-8")
        process = daemons.start("--config", tmp_path / "live.yaml", "--out", tmp_path / "out")
        wait_for_bytes(process, tmp_path / "recordings", "*", 10_000)
        usage, pings, address = Usage(process), 0, f"{tmp_path}/control"
        with ThreadPoolExecutor() as pool:
            chances = [random.Random(seed) for seed in range(3)]  # noqa: S311 for the instants
            going = [pool.submit(come_and_go, address, ends, chance) for chance in chances]
            try:
                with MapFollower(address) as follower:
                    follower.complete()
                    while pings < PINGS:
                        counts = follower.ask("status")["pings"]
                        pings, is_behind = counts["total"], counts["waiting"] > MAX_WAITING
                        speed = world.sonar.speed or 1.0
                        world.sonar.speed = min(0.8 * speed if is_behind else 1.05 * speed, 12.0)
                        usage.sample(pings / PINGS)
                        time.sleep(0.2)
            finally:
                ends.set()
                os.kill(process, signal.SIGTERM)
        assert daemons.ended() == 0
    finally:
        world.close()
        daemons.close()
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    print(  # noqa: T201 for the person who runs half a million
        f"{summary['pings_mapped']} of {summary['pings_total']} pings, "
        f"{sum(clients.result() for clients in going)} clients; MB at most in each tenth: "
        f"{[round(size / 1e6, 1) for size in usage.most_bytes]}; descriptors {usage.least_files}, "
        f"threads {usage.least_threads}"
    )
    assert summary["pings_mapped"] > 0.9 * PINGS
    if PINGS >= LONG:
        assert max(usage.most_bytes[1:]) < 1.05 * usage.most_bytes[1]
        assert usage.least_files[9] <= usage.least_files[1]
        assert usage.least_threads[9] <= usage.least_threads[1]
