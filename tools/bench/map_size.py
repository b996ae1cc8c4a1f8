"""Peak memory of what is done with a map on disk: a map of any size, made within seconds.

A brick of a seabed is repeated over a square. Each way then runs in a process of its own, with one
tile in memory. Prints the table of docs/reports/performance.md; 2000 MB take some ten minutes and
1 GB of disk.

Usage: python -m bench map-size [--megabytes N] [--folder FOLDER] [--only WAY ...]
"""

import argparse
import re
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from mapperd.config.daemon import OutOfCoreConfig
from mapperd.config.tree import Config, OctreeConfig
from mapperd.daemon.map_folder import write_results
from mapperd.export.formats import FORMATS, write_map
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.mapping.sonar_map import BRICK_VOXELS, SonarMap
from mapperd.store.maintenance import packed, write_whole
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore

CONFIG = Config(
    octree=OctreeConfig(voxel_resolution=0.05), outofcore=OutOfCoreConfig(use=True, cache_size=1)
)
BEDS = 8
"""Different bricks."""

SHARE_OF_BED = 0.4
"""Share of the voxels below the seabed that are observed."""


def write_map_of(path: Path, megabytes: float) -> int:
    """Write a map file of a flat square; return its bricks.

    Args:
        path: of the file.
        megabytes: memory that the map would take as a whole.
    """
    bricks, brick_bytes = _beds()
    count = max(1, round(megabytes * 1e6 / brick_bytes))
    side = int(np.ceil(np.sqrt(count)))
    keys = [(i % side, i // side, -1) for i in range(count)]
    rows = packed((key, 1, bricks[i % BEDS]) for i, key in enumerate(keys))
    return write_whole(path, CONFIG, 1, rows)


def _beds() -> tuple[list[bytes], float]:
    """Return bricks with a rough seabed under free water, and the memory that one takes."""
    axis = (np.arange(BRICK_VOXELS) + 0.5) * 0.05
    bricks, sizes = [], []
    for number in range(BEDS):
        random = np.random.default_rng(number)
        one = SonarMap(CONFIG)
        empty = one.memory_bytes
        for z_m in axis:
            points = np.stack(np.meshgrid(axis, axis, [z_m]), axis=-1).reshape(-1, 3)
            is_water = z_m > 1.6 + 0.3 * np.sin(points[:, 0] + number)
            log_odds = np.where(is_water, -1.0, 2.5) + random.normal(0, 0.3, len(points))
            seen = is_water | (random.random(len(points)) < SHARE_OF_BED)
            one.core.set_log_odds(points[seen], log_odds[seen])
        [(_, _, brick)] = one.core.bricks_since(0)[1]
        bricks.append(brick)
        sizes.append(one.memory_bytes - empty)
    return bricks, float(np.mean(sizes))


def _results(stored: StoredMap, folder: Path) -> None:
    summary: dict[str, Any] = {"pings_mapped": 0, "pings_total": 0}
    write_results(
        folder, stored, summary | {"map_sha256": stored.sha256()}, TrajectoryWriter(folder)
    )


def _way(name: str, path: Path, folder: Path) -> None:
    """Do one thing with the map file."""
    if name == "save":
        with TileStore(path, SonarMap(CONFIG), tile_size_m=10.0, cache_tiles=1) as store:
            store.check()
        return
    with closing(StoredMap(path, CONFIG)) as stored:
        if name == "results":
            _results(stored, folder)
        else:
            write_map(stored, folder / f"map{name}")


WAYS = ("results", "save", *FORMATS)


def peak_mb(name: str, path: Path, folder: Path) -> tuple[float, float]:
    """Run one way in a process; return its peak memory, MB, and its seconds."""
    began_s = time.perf_counter()
    command = [sys.executable, "-m", "bench.map_size", "--way", name, str(path), str(folder)]
    ran = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603 ours
    return float(ran.stdout), time.perf_counter() - began_s


def _own_peak_mb() -> float:
    text = Path("/proc/self/status").read_text(encoding="ascii")
    found = re.search(r"VmHWM:\s+(\d+) kB", text)
    assert found is not None  # noqa: S101 Linux has it
    return int(found[1]) * 1024 / 1e6


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="bench map-size")
    parser.add_argument("--megabytes", type=float, default=100.0)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=WAYS, default=WAYS)
    parser.add_argument("--way", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.way:
        _way(args.way[0], Path(args.way[1]), Path(args.way[2]))
        print(_own_peak_mb())
        return 0
    with tempfile.TemporaryDirectory(dir=args.folder) as name:
        folder = Path(name)
        bricks = write_map_of(folder / "dive.map", args.megabytes)
        size_mb = (folder / "dive.map").stat().st_size / 1e6
        print(f"{bricks} bricks, {args.megabytes:g} MB in memory, {size_mb:.0f} MB on disk\n")
        print("| way | peak MB | s |\n|---|---|---|")
        for way in args.only:
            peak, seconds = peak_mb(way, folder / "dive.map", folder)
            print(f"| {way} | {peak:.0f} | {seconds:.1f} |", flush=True)
            for path in folder.glob("map.*"):
                path.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
