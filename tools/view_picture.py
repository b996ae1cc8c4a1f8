"""Draw docs/images/view.png: the page of `mapperctl view` with the demo's map, in a real browser.

    make demo && python tools/view_picture.py [--chromium /usr/bin/chromium] [--out PNG]

The map is that of `make demo`, the vehicle and its path are those of the simulated dive.
"""

import argparse
import asyncio
import io
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from ply_points import read_voxels
from sonar_sim import load_scenario
from sonar_sim.poses import Pose as SimPose

from mapperd.client import (
    ClientChange,
    LinkChanged,
    LinkStatus,
    MapChanged,
    MapClient,
    MapMirror,
    MapReset,
)
from mapperd.stream.blocks import CELLS, UNKNOWN, BlockSet
from mapperd.stream.messages import Fan, Interest, MapFacts, Pose, Status
from mapperd.stream.messages import Path as Way
from mapperd.topside.view import View
from mapperd.topside.view_page import open_page

ROOT = Path(__file__).resolve().parent.parent
STEP = 0.25
OCCUPIED = 12
WIDTH, HEIGHT = 1280, 800
AT_S = 14.0
SETTLED = 12
CAMERA_M = (-7.6, -11.0, 2.5)
TOWARDS_M = (0.9, -2.2, -5.6)
CLOSE_NOTES_JS = (
    "document.querySelectorAll('.mantine-Notification-closeButton').forEach(one => one.click())"
)
ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--disable-background-networking --no-first-run --disable-component-update --disable-sync"
)


class DemoClient:
    """A client that is told of the demo's map and dive."""

    def __init__(self, folder: Path) -> None:
        cloud = read_voxels(folder / "map.ply")
        facts = MapFacts("demo", cloud.edge_m, STEP, 0.85, 0.0)
        self.link = LinkStatus("connected", "192.168.2.2:7471", "", time.monotonic(), 1)
        self.welcome = None
        self.mirror = MapMirror(facts, Interest())
        self._keys = self._fill(cloud.centres_m)
        self._dive = load_scenario("harbour")
        times = np.arange(0.0, AT_S, 0.1)
        self.path = np.array([self._at(t).position_m for t in times], np.float32)
        self.told: asyncio.Queue[ClientChange | None] = asyncio.Queue()
        for change in (
            LinkChanged(self.link),
            MapReset(facts),
            MapChanged(self._keys, time.time_ns(), 0),
            Way(first=0, points=self.path.tobytes()),
            Fan(
                bearings_rad=(-1.13, 1.13),
                vertical_aperture_rad=np.radians(20.0),
                min_range_m=0.5,
                max_range_m=6.0,
            ),
        ):
            self.told.put_nowait(change)

    async def changes(self) -> AsyncIterator[ClientChange]:
        """As `MapClient` tells them."""
        while (change := await self.told.get()) is not None:
            yield change

    def pulse(self, pings: int) -> None:
        """What comes all the time."""
        self.told.put_nowait(self._at(AT_S))
        status = {"phase": "mapping", "pings": {"mapped": pings, "dropped": {}}}
        link = {"round_trip_s": 0.021, "left": 0, "skipped": {}}
        self.told.put_nowait(Status(stamp_ns=time.time_ns(), status=status, link=link))
        self.told.put_nowait(MapChanged(self._keys[:0], time.time_ns(), 0))

    def _at(self, time_s: float) -> Pose:
        base = self._dive.trajectory.pose(time_s)
        sonar = base @ self._dive.mounting.pose
        return Pose(
            stamp_ns=time.time_ns(),
            position_m=tuple(base.position_m.tolist()),
            orientation_xyzw=_xyzw(base),
            sonar_position_m=tuple(sonar.position_m.tolist()),
            sonar_orientation_xyzw=_xyzw(sonar),
        )

    def _fill(self, centres_m: NDArray[np.float64]) -> NDArray[np.int32]:
        cell = np.floor(centres_m / self.mirror.cell_m).astype(np.int64)
        keys, row = np.unique(cell >> 3, axis=0, return_inverse=True)
        x, y, z = (cell & 7).T
        cells = np.full((len(keys), CELLS), UNKNOWN, np.int8)
        cells[row.ravel(), x + 8 * (y + 8 * z)] = OCCUPIED
        blocks = BlockSet(keys.astype(np.int32), np.zeros(len(keys), np.uint32), cells)
        self.mirror.put(blocks, time.time_ns())
        return blocks.keys


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    parser.add_argument("--demo", type=Path, default=ROOT / "out" / "demo")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "view.png")
    said = parser.parse_args()
    png = asyncio.run(_draw(said.demo, said.chromium))
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    picture.save(said.out, optimize=True)
    print(f"{said.out}: {said.out.stat().st_size / 1e3:.0f} kB")


async def _draw(demo: Path, chromium: str) -> bytes:
    from playwright.async_api import async_playwright  # noqa: PLC0415 of the extra `dev`

    server = open_page("127.0.0.1", 0)
    client = DemoClient(demo)
    view = View(server, cast("MapClient", client))
    running = asyncio.create_task(view.run())
    try:
        async with async_playwright() as playwright:
            browser = await playwright.chromium.launch(
                executable_path=chromium, args=ARGUMENTS.split()
            )
            page = await browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            await page.goto(f"http://127.0.0.1:{server.get_port()}")
            await page.wait_for_selector("canvas")
            shown = "getComputedStyle(document.querySelector('canvas')).opacity"
            pulses = asyncio.create_task(_pulse(client))
            for seconds in range(400):
                await asyncio.sleep(1.0)
                await page.evaluate(CLOSE_NOTES_JS)
                for watcher in server.get_clients().values():
                    watcher.camera.position = CAMERA_M
                    watcher.camera.look_at = TOWARDS_M
                settled = seconds > SETTLED and not view.map.stale
                if settled and await page.evaluate(shown) == "1":
                    break
            png = await page.screenshot(timeout=120_000)
            pulses.cancel()
            await browser.close()
            return png
    finally:
        client.told.put_nowait(None)
        await running
        server.stop()


async def _pulse(client: DemoClient) -> None:
    for number in range(100_000):
        client.pulse(number)
        await asyncio.sleep(0.2)


def _xyzw(pose: SimPose) -> tuple[float, float, float, float]:
    w, x, y, z = pose.quaternion.tolist()
    return x, y, z, w


if __name__ == "__main__":
    main()
