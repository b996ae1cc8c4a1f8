"""A day of pings through a tiny cache of tiles, saved all the time: nothing grows.

`make crash-soak` does it half a million times.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

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
from tests.support.process import open_files, resident_bytes

pytestmark = pytest.mark.crash

PINGS = int(os.environ.get("SOAK_PINGS", "1000"))
LONG = 20_000
"""Pings from which on the process has taken all the memory that it will ever need."""

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
