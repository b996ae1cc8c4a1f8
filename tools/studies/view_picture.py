"""Draw out/view.png: the page of `mapperctl view` while a daemon maps the demo's dive.

    make demo && python tools/studies/view_picture.py [--chromium /usr/bin/chromium] [--out PNG]

All that it shows is what the daemon sends: the dive is played to it as if it happened now.
"""

import argparse
import asyncio
import io
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from mapperd.cli.mapperctl.view import open_page
from mapperd.client import MapClient
from mapperd.foxglove.recording import FoxgloveRecording
from mapperd.viewer.app import VIEW_WANTS, ViewerPage
from mapperd.wire.auth import read_token
from studies.stream.world import StreamWorld

if TYPE_CHECKING:
    from viser import ViserServer

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT = 1280, 800
MAPPED = 200
"""Pings until the picture is taken: the vehicle has turned, and most of the map is there."""

CAMERA_M = (-7.6, -11.0, 2.5)
TOWARDS_M = (0.9, -2.2, -5.6)
SHOWN_JS = "getComputedStyle(document.querySelector('canvas')).opacity"
CLOSE_NOTES_JS = (
    "document.querySelectorAll('.mantine-Notification-closeButton').forEach(one => one.click())"
)
ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--disable-background-networking --no-first-run --disable-component-update --disable-sync"
)


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    parser.add_argument("--demo", type=Path, default=ROOT / "out" / "demo")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "view.png")
    args = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as folder,
        StreamWorld(Path(folder), args.demo / "capture.bin") as world,
    ):
        world.start_daemon()
        world.start_dive()
        png = asyncio.run(_draw(world, args.chromium))
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    picture.save(args.out, optimize=True)
    print(f"{args.out}: {args.out.stat().st_size / 1e3:.0f} kB")


async def _draw(world: StreamWorld, chromium: str) -> bytes:
    server = open_page("127.0.0.1", 0)
    client = MapClient(world.address, token=read_token(world.token), wants=VIEW_WANTS)
    try:
        async with client:
            view = ViewerPage(server, client, recorder=FoxgloveRecording)
            running = asyncio.create_task(view.run())
            try:
                return await _picture(server, client, chromium)
            finally:
                running.cancel()
                await asyncio.gather(running, return_exceptions=True)
    finally:
        server.stop()


async def _picture(server: "ViserServer", client: MapClient, chromium: str) -> bytes:
    """Of the page, once so much of the dive is mapped."""
    from playwright.async_api import async_playwright  # noqa: PLC0415 of the extra `dev`

    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS.split())
        page = await browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        await page.goto(f"http://127.0.0.1:{server.get_port()}")
        await page.wait_for_selector("canvas")
        await page.get_by_role("button", name="free", exact=True).click(force=True)
        await page.mouse.move(WIDTH / 2, HEIGHT - 5)  # hints cover the panel
        while _mapped(client) < MAPPED or await page.evaluate(SHOWN_JS) != "1":
            await asyncio.sleep(1.0)
            await page.evaluate(CLOSE_NOTES_JS)
            for watcher in server.get_clients().values():
                watcher.camera.position = CAMERA_M
                watcher.camera.look_at = TOWARDS_M
        png = await page.screenshot(timeout=120_000)
        await browser.close()
        return png


def _mapped(client: MapClient) -> int:
    """Pings, as the daemon counts them."""
    status = client.status
    return 0 if status is None else int(status.status.get("pings", {}).get("mapped", 0))


if __name__ == "__main__":
    main()
