"""What a map on disk costs beside one in memory: pings of a survey whose scene does not fit.

A sonar looks down on a flat seabed and goes to and fro over it. Each round is mapped in memory and
through a store, ping by ping in turn, so that what else the machine does falls on both alike.
Prints the table of docs/reports/performance.md, in some five minutes.

Usage: python -m bench tile-cache [--pings N] [--range METRES]
"""

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config, OctreeConfig
from mapperd.geometry.frames import pose_from_rpy
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.tile_store import TileStore

CONFIG = Config(octree=OctreeConfig(voxel_resolution=0.05))
ROWS, BEAMS = 500, 512
LEG_M = 60.0
TILE_M = 10.0
SAVE_EVERY = 50
"""Pings: five seconds at ten a second."""

CASES = ((0.1, 4), (0.1, 1), (2.0, 4), (2.0, 1))
"""Metres between pings, and tiles in memory."""


@dataclass(frozen=True, slots=True)
class Times:
    """Milliseconds a ping, and how often tiles came."""

    memory_ms: NDArray[np.float64]
    store_ms: NDArray[np.float64]
    tiles_loaded: int

    def row(self, step_m: float, tiles: int) -> str:
        """As a row of the table."""
        memory, store = self.memory_ms.mean(), self.store_ms.mean()
        p99 = np.percentile(self.store_ms, 99)
        return (
            f"| {step_m:g} | {tiles} | {memory:.0f} | {store:.0f} | {p99:.0f} "
            f"| {self.tiles_loaded} | {memory / store:.0%} |"
        )


def echo_of(number: int, range_m: float) -> PingImage:
    """A flat seabed at 0.6 of the range, in noise."""
    noise = np.random.default_rng(number).integers(0, 30, (ROWS, BEAMS))
    bearings = np.arcsin(np.linspace(-1, 1, BEAMS) * np.sin(np.radians(65)))
    first = 0.6 / np.cos(bearings) * ROWS
    row = np.arange(ROWS)[:, None]
    image = np.where((row >= first) & (row < first + 6), 180, noise).astype(np.float32)
    return PingImage(image, bearings, range_m / ROWS)


def pose_of(distance_m: float) -> NDArray[np.float64]:
    """To and fro, each leg half a metre beside the last."""
    leg, along_m = divmod(distance_m, LEG_M)
    x = along_m if leg % 2 == 0 else LEG_M - along_m
    return pose_from_rpy((x, 0.5 * leg, 0.0), (0, 0, 0)).map_T_base


def measured(folder: Path, pings: int, range_m: float, step_m: float, tiles: int) -> Times:
    """The same pings into both maps."""
    echoes = [echo_of(number, range_m) for number in range(8)]
    whole, paged = SonarMap(CONFIG), SonarMap(CONFIG)
    path = folder / f"{step_m}-{tiles}.map"
    ms: list[tuple[float, float]] = []
    with TileStore(path, paged, tile_size_m=TILE_M, cache_tiles=tiles) as store:
        for number in range(pings):
            echo, pose = echoes[number % 8], pose_of(step_m * number) @ whole.base_T_sonar
            began_s = time.perf_counter()
            whole.integrate(echo, pose)
            between_s = time.perf_counter()
            paged.integrate(echo, pose)
            store.advance(number.to_bytes(8, "little"))
            if number % SAVE_EVERY == 0:
                store.save()
            ms.append((1e3 * (between_s - began_s), 1e3 * (time.perf_counter() - between_s)))
        loaded = store.counters.tiles_loaded
    memory, kept = np.array(ms).T
    return Times(memory, kept, loaded)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=300)
    parser.add_argument("--range", type=float, default=10.0, metavar="METRES")
    options = parser.parse_args()
    print("| m a ping | tiles | memory, ms | store, ms | p99 | tiles loaded | speed |")
    print("|---:|---:|---:|---:|---:|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        for step_m, tiles in CASES:
            times = measured(Path(folder), options.pings, options.range, step_m, tiles)
            print(times.row(step_m, tiles), flush=True)


if __name__ == "__main__":
    main()
