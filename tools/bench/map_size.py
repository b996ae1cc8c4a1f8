"""Peak memory of what is done with a map on disk: a map of any size, made within seconds.

A brick of a seabed is repeated over a square. Each way then runs in a process of its own, with one
tile in memory. `daemon` starts a daemon on the file, which maps a moving sonar while a client
follows the map, saves it on request and ends; its memory is the daemon's. Prints the table of
docs/reports/performance.md; 2000 MB take some ten minutes and 1 GB of disk.

Usage: python -m bench map-size [--megabytes N] [--folder FOLDER] [--only WAY ...] [--most MB]
       [--seconds S]
"""

import argparse
import asyncio
import contextlib
import itertools
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from mapperd.client import AskError, MapClient
from mapperd.config.daemon import OutOfCoreConfig
from mapperd.config.tree import Config, OctreeConfig
from mapperd.daemon.map_folder import write_results
from mapperd.export.formats import FORMATS, write_map
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.mapping.sonar_map import BRICK_VOXELS, SonarMap
from mapperd.odometry.native import NativeRecord, encode_native
from mapperd.store.maintenance import packed, write_whole
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore
from oculus_driver import PlaybackSonar
from oculus_driver.encode import encode_ping

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


SETTINGS = """
octree: {{voxel_resolution: 0.05}}
mounting: {{orientation: {{pitch: 0}}}}
device: {{address: 127.0.0.1, port: {sonar}, ping_rate: highest}}
odometry: {{sources: [{{link: 'udp://127.0.0.1:{odometry}'}}]}}
outofcore: {{use: true, map_path: {map}, cache_size: 1}}
recording: {{folder: {folder}/recordings, free_floor: 0, budget: 0}}
server: {{socket: {folder}/socket}}
"""

ODOMETRY_S = 0.02
SPEED_MPS = 1.0
POLL_INTERVAL_S = 0.02
START_S, SAVE_S, END_S = 300.0, 3600.0, 3600.0
"""Timeouts of a daemon on a busy machine."""


async def _daemon_peak_mb(path: Path, folder: Path, seconds: float) -> float:
    """Let a daemon map into the file, save it and end; return its peak memory."""
    pings = [_ping(number) for number in range(1, 200)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    async with PlaybackSonar(pings, standby=True, loops=None) as sonar:
        settings = folder / "live.yaml"
        text = SETTINGS.format(sonar=sonar.port, odometry=port, map=path, folder=folder)
        settings.write_text(text, encoding="utf-8")
        words = ("--config", settings, "--out", folder / "out")
        daemon = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "mapperd",
            *map(str, words),
            stdout=sys.stderr,
            env=os.environ | {"STATE_DIRECTORY": str(folder)},  # of the saved map
        )
        driving = asyncio.create_task(_drive(port))
        watching = asyncio.create_task(_peak_of(daemon.pid))
        try:
            async with MapClient(f"{folder}/socket") as client:
                following = asyncio.create_task(_follow(client))
                await _mapped(client, seconds)
                print(f"{_peak_mb(daemon.pid):.0f} MB after mapping", file=sys.stderr)
                await _save(client)
                print(f"{_peak_mb(daemon.pid):.0f} MB after saving", file=sys.stderr)
                following.cancel()
            daemon.terminate()
            async with asyncio.timeout(END_S):
                code = await daemon.wait()
        finally:
            if daemon.returncode is None:
                daemon.kill()
            driving.cancel()
    if code:
        raise SystemExit(f"the daemon ended with exit code {code}")
    return await watching


def _ping(number: int) -> bytes:
    """Return a ping that sees a wall 3 m away."""
    image = np.zeros((50, 65), dtype=np.uint8)
    image[30:32] = 200
    return encode_ping(
        ping_id=number,
        mode=1,
        frequency_hz=750e3,
        range_m=5.0,
        gain_percent=50.0,
        speed_of_sound_mps=1500.0,
        salinity_ppt=35.0,
        start_time=100 + 0.1 * number,
        range_resolution_m=0.1,
        bearings_cdeg=np.linspace(-6000, 6000, 65).round().astype(np.int16),
        image=image,
        source_id=7,
    )


async def _drive(port: int) -> None:
    """Send the odometry of a vehicle that drives over the map, until cancelled."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for number in itertools.count():
            place = (SPEED_MPS * ODOMETRY_S * number, 5.0, -1.0)
            record = NativeRecord(
                v=1, clk="arrival", w="enu", b="flu", p=place, q=(1.0, 0.0, 0.0, 0.0)
            )
            link.sendto(encode_native(record), ("127.0.0.1", port))
            await asyncio.sleep(ODOMETRY_S)


async def _mapped(client: MapClient, seconds: float) -> None:
    """Wait until a daemon maps, and then so long."""
    async with asyncio.timeout(START_S):
        while client.link.state != "connected":  # noqa: ASYNC110 it becomes true once
            await asyncio.sleep(0.1)
        while not (await client.ask("status"))["pings"]["mapped"]:  # noqa: ASYNC110 as above
            await asyncio.sleep(0.5)
    await asyncio.sleep(seconds)
    pings = (await client.ask("status"))["pings"]
    print(f"{pings['mapped']} of {pings['total']} pings mapped", file=sys.stderr)


async def _save(client: MapClient) -> None:
    """Save the map; a daemon whose recording waits for a busy disk refuses for a moment."""
    async with asyncio.timeout(SAVE_S):
        while True:
            try:
                await client.ask("save", name="map.ply", timeout_s=SAVE_S)
            except AskError as error:
                print(f"not saved: {error}", file=sys.stderr)
                await asyncio.sleep(1.0)
            else:
                return


async def _follow(client: MapClient) -> None:
    async for _ in client.changes():
        pass


async def _peak_of(process: int) -> float:
    """Watch the peak memory of a process until its end."""
    peak = 0.0
    with contextlib.suppress(OSError, AttributeError):  # it has ended
        while True:
            peak = _peak_mb(process)
            await asyncio.sleep(POLL_INTERVAL_S)
    return peak


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


DAEMON = "daemon"
WAYS = ("results", "save", *FORMATS, DAEMON)
"""The daemon comes last: it changes the map."""

DAEMON_S = 60.0
"""How long the daemon maps."""


def peak_mb(name: str, path: Path, folder: Path, seconds: float = DAEMON_S) -> tuple[float, float]:
    """Run one way in a process; return its peak memory, MB, and its seconds."""
    began_s = time.perf_counter()
    if name == DAEMON:
        peak = asyncio.run(_daemon_peak_mb(path, folder, seconds))
        return peak, time.perf_counter() - began_s
    command = [sys.executable, "-m", "bench.map_size", "--way", name, str(path), str(folder)]
    ran = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603 ours
    return float(ran.stdout), time.perf_counter() - began_s


def _peak_mb(process: int | str = "self") -> float:
    """Return the peak memory of a process; AttributeError if it has just ended."""
    text = Path(f"/proc/{process}/status").read_text(encoding="ascii")
    found = re.search(r"VmHWM:\s+(\d+) kB", text)
    if found is None:
        raise AttributeError(process)
    return int(found[1]) * 1024 / 1e6


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="bench map-size")
    parser.add_argument("--megabytes", type=float, default=100.0)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=WAYS, default=WAYS)
    parser.add_argument("--most", type=float, default=np.inf, help="MB; exit code 1 above")
    parser.add_argument("--seconds", type=float, default=DAEMON_S, help="that the daemon maps")
    parser.add_argument("--way", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.way:
        _way(args.way[0], Path(args.way[1]), Path(args.way[2]))
        print(_peak_mb())
        return 0
    with tempfile.TemporaryDirectory(dir=args.folder) as name:
        folder = Path(name)
        bricks = write_map_of(folder / "dive.map", args.megabytes)
        size_mb = (folder / "dive.map").stat().st_size / 1e6
        print(f"{bricks} bricks, {args.megabytes:g} MB in memory, {size_mb:.0f} MB on disk\n")
        print("| way | peak MB | s |\n|---|---|---|")
        peaks = {}
        for way in args.only:
            peaks[way], seconds = peak_mb(way, folder / "dive.map", folder, args.seconds)
            print(f"| {way} | {peaks[way]:.0f} | {seconds:.1f} |", flush=True)
            for path in folder.glob("map.*"):
                path.unlink()
    above = [way for way, peak in peaks.items() if peak > args.most]
    if above:
        print(f"\nabove {args.most:g} MB: {', '.join(above)}")
    return int(bool(above))


if __name__ == "__main__":
    sys.exit(main())
