"""What the bridges, and the watch for changes, cost beside a daemon with a large map.

    python -m bench bridges [--cells 2000000] [--seconds 60]

This process serves a map of so many occupied cells, ten pings a second with images, poses and
returns, and localization with 500 particles; blocks near the vehicle change five times a second.
Each bridge is a process of its own, with a peer that takes everything. Prints the processor time of
each bridge as a share of one core, once it has the map.
"""

import argparse
import asyncio
import math
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import zstandard

from bench.view_load import floor_blocks
from mapperd.client.mirror import MapMirror
from mapperd.wire.blocks import BlockSet, encode_blocks
from mapperd.wire.framing import framed, server_inbox
from mapperd.wire.messages import (
    AnswerMessage,
    AskMessage,
    BlocksMessage,
    ChangeMessage,
    FanMessage,
    FromServer,
    GreetingMessage,
    HelloMessage,
    ImageMessage,
    Interest,
    LocalizationMessage,
    MapInfo,
    PoseMessage,
    ReturnsMessage,
    StatusMessage,
    WelcomeMessage,
)

MAP_INFO = MapInfo("load", 0.1, 0.25, 0.85, 0.0)
PING_HZ = 10
BEAMS, ROWS, PARTICLES = 256, 512, 500
PIECE = 1000
CHANGED = 60
TICKS = os.sysconf("SC_CLK_TCK")
DOMAIN = 97
WARM_UP_S = 15.0
STATUS = {
    "phase": "mapping",
    "problems": [],
    "localization": {"mode": "track", "state": "localized", "sure": True},
}
COMMAND = "import sys; from mapperd.cli.mapperctl.command import main; sys.exit(main())"
LISTENER = f"""
import time
from mapperd.bridges.dds import DdsNode
from mapperd.bridges.ros2 import TOPICS
node = DdsNode({DOMAIN}, "")
named = {{"sonar": "/sonar", "cloud": "/cloud", "markers": "/markers"}}
readers = [
    node.subscriber(named.get(key) or name, kind, profile)
    for key, (name, kind, profile, _) in TOPICS.items()
]
while True:
    for one in readers:
        one._reader.take(100)
    time.sleep(0.02)
"""
SETTINGS = f"""
ros2: {{domain: {DOMAIN}}}
topics: {{sonar: /sonar, pointcloud: /cloud, marker: /markers}}
mavlink: {{address: "udp://127.0.0.1:14699"}}
"""


class LoadedDaemon:
    """Serves a map and its pings to any number of clients."""

    def __init__(self, cells: int) -> None:
        self._blocks = floor_blocks(cells)
        self._random = np.random.default_rng(3)
        pixels = self._random.integers(0, 255, (ROWS, BEAMS)).astype(np.uint8)
        self._image = zstandard.ZstdCompressor(level=1).compress(pixels.tobytes())
        self._began_s = time.monotonic()

    def save(self, path: Path) -> None:
        """Save the map as it is at the beginning."""
        mirror = MapMirror(MAP_INFO, Interest())
        mirror.put(self._blocks, time.time_ns())
        mirror.to_map().save(path)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until it leaves."""
        self._send(writer, GreetingMessage())
        wanted = asyncio.Event()
        reading = asyncio.create_task(_read(reader, writer, wanted))
        welcome = WelcomeMessage(
            version=1,
            server="bench",
            vehicle="load",
            session="s",
            map=MAP_INFO,
            revision=1,
            resumed=False,
        )
        self._send(writer, welcome)
        try:
            await self._pings(writer, wanted)
        except ConnectionError:
            return
        finally:
            reading.cancel()

    def _pieces(self) -> Iterator[FromServer]:
        held = self._blocks
        for begin in range(0, len(held), PIECE):
            rows = slice(begin, begin + PIECE)
            body = encode_blocks(BlockSet(held.keys[rows], held.ages_ms[rows], held.cells[rows]))
            last = begin + PIECE >= len(held)
            yield BlocksMessage(
                revision=1, stamp_ns=time.time_ns(), complete=1 if last else None, body=body
            )

    async def _pings(self, writer: asyncio.StreamWriter, wants_map: asyncio.Event) -> None:
        number, next_s, has_map = 0, time.monotonic(), False
        while True:
            if wants_map.is_set() and not has_map:
                has_map = True
                for piece in self._pieces():
                    self._send(writer, piece)
                    await writer.drain()
            for message in self._ping(number):
                if has_map or not isinstance(message, BlocksMessage):
                    self._send(writer, message)
            await writer.drain()
            number, next_s = number + 1, next_s + 1 / PING_HZ
            await asyncio.sleep(max(next_s - time.monotonic(), 0))

    def _ping(self, number: int) -> Iterator[FromServer]:
        stamp_ns, angle = time.time_ns(), number / 200
        place = (10 * math.cos(angle), 10 * math.sin(angle), -5.0)
        turn = (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))
        if number % PING_HZ == 0:
            yield StatusMessage(stamp_ns=stamp_ns, status=STATUS)
        if number % 2 == 0:
            yield self._localization(stamp_ns)
            yield self._change(stamp_ns)
        if number % PING_HZ == 0:
            yield FanMessage(
                bearings_rad=(-1.1, 1.1),
                vertical_aperture_rad=0.35,
                min_range_m=0.5,
                max_range_m=20.0,
            )
        yield PoseMessage(
            stamp_ns=stamp_ns,
            position_m=place,
            orientation_xyzw=turn,
            sonar_position_m=place,
            sonar_orientation_xyzw=turn,
            velocity_mps=(0.5, 0.0, 0.0),
            covariance=tuple((0.01 * np.eye(6)).ravel().tolist()),
            source="localization",
            odom_position_m=place,
            odom_orientation_xyzw=turn,
        )
        points = self._random.normal(size=(BEAMS, 3)).astype("<f4")
        yield ReturnsMessage(
            stamp_ns=stamp_ns,
            ping_id=number,
            sonar_position_m=place,
            sonar_orientation_xyzw=turn,
            points=points.tobytes(),
            intensities=bytes(BEAMS),
        )
        yield ImageMessage(
            stamp_ns=stamp_ns,
            ping_id=number,
            rows=ROWS,
            beams=BEAMS,
            range_resolution_m=0.04,
            bearings_rad=np.linspace(-1.1, 1.1, BEAMS).astype("<f4").tobytes(),
            body=self._image,
        )

    def _localization(self, stamp_ns: int) -> LocalizationMessage:
        pose = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0, "covariance": (0.01 * np.eye(3)).tolist()}
        report = {
            "state": "localized",
            "sure": True,
            "t_s": stamp_ns / 1e9,
            "pose": pose,
            "map_odom": {
                "position_m": [0.0, 0.0, 0.0],
                "orientation_wxyz": [1.0, 0.0, 0.0, 0.0],
                "t_s": stamp_ns / 1e9,
            },
        }
        particles = self._random.normal(size=(PARTICLES, 4)).astype("<f4").tobytes()
        return LocalizationMessage(report=report, particles=particles)

    def _change(self, stamp_ns: int) -> BlocksMessage:
        held = self._blocks
        rows = self._random.choice(len(held), CHANGED, replace=False)
        cells = held.cells[rows].copy()
        cells[self._random.random(cells.shape) < 0.01] = 12  # noqa: PLR2004 a share
        body = encode_blocks(BlockSet(held.keys[rows], held.ages_ms[rows], cells))
        return BlocksMessage(revision=2, stamp_ns=stamp_ns, complete=2, body=body)

    @staticmethod
    def _send(writer: asyncio.StreamWriter, message: FromServer) -> None:
        writer.write(framed(message))


async def _read(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, wants_map: asyncio.Event
) -> None:
    """Read what a client sends: note when it wants the map, and answer its requests."""
    inbox = server_inbox()
    while data := await reader.read(1 << 16):
        for message in inbox.feed(data):
            if isinstance(message, HelloMessage | ChangeMessage) and "map" in (message.wants or ()):
                wants_map.set()
            elif isinstance(message, AskMessage):
                number = msgspec.msgpack.decode(message.ask)["id"]
                writer.write(framed(AnswerMessage(id=number, result={})))


def cpu_s(pid: int) -> float:
    """Return the processor time of a process and its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


async def measure(name: str, cells: int, seconds: float, listener: str = "") -> float:
    """Return the share of a core that a bridge takes."""
    with TemporaryDirectory(prefix="bridges-") as folder:
        daemon = LoadedDaemon(cells)
        known = Path(folder) / "known.map"
        if name == "changes":
            daemon.save(known)
        path = Path(folder) / "map.sock"
        server = await asyncio.start_unix_server(daemon.serve, path)
        settings = Path(folder) / "bridge.yaml"
        settings.write_text(SETTINGS)
        words = [sys.executable, "-c", COMMAND, name, "--config", str(settings)]
        words += [str(known)] if name == "changes" else []
        program = await asyncio.create_subprocess_exec(*words, "--socket", str(path))
        peer = None
        if listener:
            peer = await asyncio.create_subprocess_exec(sys.executable, "-c", listener)
        try:
            await asyncio.sleep(WARM_UP_S)
            before_s, began_s = cpu_s(program.pid), time.monotonic()
            await asyncio.sleep(seconds)
            return (cpu_s(program.pid) - before_s) / (time.monotonic() - began_s)
        finally:
            for process in filter(None, (peer, program)):
                process.terminate()
                await process.wait()
            server.close()


def main() -> None:
    """Run it, and print what the bridges cost."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=2_000_000)
    parser.add_argument("--seconds", type=float, default=60.0)
    args = parser.parse_args()
    runs = (
        ("ros2", LISTENER, "`ros2`, every topic subscribed"),
        ("ros2", "", "`ros2`, nobody subscribes"),
        ("mavlink", "", "`mavlink`, defaults"),
        ("changes", "", "`changes`, defaults"),
    )
    for name, listener, what in runs:
        share = asyncio.run(measure(name, args.cells, args.seconds, listener))
        print(f"| {what} | {100 * share:.1f} % |", flush=True)


if __name__ == "__main__":
    main()
