"""A dive that always goes the same way: input for maps that must come out equal.

As a program it maps the dive into a store, from where that is, until it is done or killed, or
about to execute the nth statement of its next saves.
"""

import itertools
import os
import signal
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import (
    Config,
    FilteringConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
    SonarConfig,
)
from mapperd.geometry.frames import pose_from_rpy
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.tile_store import TileStore

CONFIG = Config(
    sonar=SonarConfig(vertical_aperture=20.0),
    filtering=FilteringConfig(min_range=0.2),
    octree=OctreeConfig(voxel_resolution=0.1),
    mounting=MountingConfig(orientation=OrientationConfig(pitch=40.0)),
)
ROWS, BEAMS = 40, 24
RANGE_M = 4.0
SAVE_EVERY = 3
TILE_M, CACHE_TILES = 6.4, 2


def echo_of(number: int) -> PingImage:
    """Noise, and a seabed that is not flat."""
    random = np.random.default_rng([20, number])
    intensity = random.integers(0, 30, (ROWS, BEAMS)).astype(np.float32)
    seabed = 25 + 5 * np.sin(0.3 * number + np.linspace(0, 3, BEAMS))
    rows = np.arange(ROWS)[:, None]
    intensity[(rows >= seabed) & (rows < seabed + 3)] = 180
    bearings = np.linspace(-1.0, 1.0, BEAMS)
    return PingImage(intensity, bearings, RANGE_M / ROWS)


def pose_of(number: int) -> NDArray[np.float64]:
    """Out for fifty metres, back beside it, and again."""
    leg, at = divmod(number, 50)
    x = at if leg % 2 == 0 else 50 - at
    return pose_from_rpy((x, 2.0 * leg, -3.0), (0, 0, 20.0 * at)).map_T_base


def integrate(sonar_map: SonarMap, number: int) -> None:
    """One ping of the dive."""
    sonar_map.integrate(echo_of(number), pose_of(number) @ sonar_map.base_T_sonar)


def mapped(pings: int) -> SonarMap:
    """The dive so far, in a map that is in memory as a whole."""
    sonar_map = SonarMap(CONFIG)
    for number in range(pings):
        integrate(sonar_map, number)
    return sonar_map


def open_store(path: Path, **changes: float) -> tuple[SonarMap, TileStore]:
    """An empty map and its store."""
    sonar_map = SonarMap(CONFIG)
    how: dict[str, Any] = {"tile_size_m": TILE_M, "cache_tiles": CACHE_TILES} | changes
    return sonar_map, TileStore(path, sonar_map, **how)


def next_ping(store: TileStore) -> int:
    """The first ping that is not in the saved map."""
    return struct.unpack("<Q", store.position)[0] if store.position else 0


def dive_on(sonar_map: SonarMap, store: TileStore, begin: int, end: int) -> None:
    """Map a part of the dive, and save now and then."""
    for number in range(begin, end):
        integrate(sonar_map, number)
        store.advance(struct.pack("<Q", number + 1))
        if number % SAVE_EVERY == 0:
            store.save()


def die_at(store: TileStore, statements: int) -> None:
    """Kill this process when it is about to execute one of its next statements that write."""
    left = itertools.count(statements, -1)

    def count(_: str) -> None:
        if next(left) == 0:
            os.kill(os.getpid(), signal.SIGKILL)

    store._saver._connection.set_trace_callback(count)


def main() -> None:
    path, pings = Path(sys.argv[1]), int(sys.argv[2])
    sonar_map, store = open_store(path)
    if len(sys.argv) > 3:
        die_at(store, int(sys.argv[3]))
    with store:
        print(next_ping(store), flush=True)  # noqa: T201 the test reads it
        dive_on(sonar_map, store, next_ping(store), pings)


if __name__ == "__main__":
    main()
