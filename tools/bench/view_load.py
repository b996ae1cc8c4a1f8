"""What a map of many cells costs the page of `mapperctl view`, and the browser that shows it.

    python -m bench view-load [--cells 2000000] [--chromium /usr/bin/chromium]

A rough sea floor with walls is mirrored and shown; then blocks near a vehicle change as while it
maps. The report has the bytes that a browser gets, the processor time of the page's server, and,
with a browser, the frames a second that it draws without a graphics card.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapperd.cli.mapperctl.view import open_page
from mapperd.client.mirror import MapMirror
from mapperd.viewer.chunks import Filter
from mapperd.viewer.colours import Scale
from mapperd.viewer.map_layer import MapLayer, MapStyle
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet
from mapperd.wire.messages import Interest, MapInfo

if TYPE_CHECKING:
    from playwright.sync_api import Page

ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--disable-background-networking --no-first-run --disable-component-update --disable-sync"
)
MAP_INFO = MapInfo("load", 0.1, 0.25, 0.85, 0.0)
THICK = 3
"""Cells of the floor, one above the other."""

UPDATES = 40
BLOCKS_AN_UPDATE = 60
"""About what a ping a quarter of a second changes."""

SOLID, FREE = 12, -12
FRAMES_JS = """(seconds) => new Promise(done => {
  let frames = 0; const begun = performance.now();
  const next = () => { frames++;
    if (performance.now() - begun < seconds * 1000) requestAnimationFrame(next);
    else done(frames / ((performance.now() - begun) / 1000)); };
  requestAnimationFrame(next); })"""


def main() -> None:
    """Run it, and print what it costs."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=2_000_000)
    parser.add_argument("--shape", choices=("auto", "cubes", "points"), default="auto")
    parser.add_argument("--chromium", help="of a browser; none measures the server alone")
    parser.add_argument("--picture", help="PNG of the page")
    args = parser.parse_args()
    mirror = MapMirror(MAP_INFO, Interest(detail="log_odds"))
    mirror.put(floor_blocks(args.cells), time.time_ns())
    occupied = len(mirror.cells("occupied"))
    server = open_page("127.0.0.1", 0)
    view = MapLayer(server.scene, MapStyle(Filter(), Scale("height", -10.0, 0.0), args.shape))
    try:
        if args.chromium:
            with _page(args.chromium, f"http://127.0.0.1:{server.get_port()}") as page:
                print(f"frames a second of an empty page: {page.evaluate(FRAMES_JS, 5):.1f}")
                begun = time.monotonic()
                _show(mirror, view, occupied)
                page.evaluate(FRAMES_JS, 0.1)
                print(f"the browser had drawn it after {time.monotonic() - begun:.1f} s")
                print(f"frames a second: {page.evaluate(FRAMES_JS, 10):.1f}")
                begun = time.monotonic()
                updated = _update(mirror, view, page)
                print(f"{UPDATES} updates took {time.monotonic() - begun:.1f} s with the browser")
                if args.picture:
                    page.screenshot(path=args.picture, timeout=120_000)
        else:
            _show(mirror, view, occupied)
            updated = _update(mirror, view, None)
        print(updated)
    finally:
        server.stop()


def _show(mirror: MapMirror, view: MapLayer, occupied: int) -> None:
    began_s = time.process_time()
    view.touch(mirror.keys())
    longest = 0.0
    while view.stale:
        slice_s = time.process_time()
        view.draw(mirror, (0.0, 0.0, -5.0), 0, 1 << 40, 4)
        longest = max(longest, time.process_time() - slice_s)
        if not view.stale:
            view.refine((0.0, 0.0, -5.0), mirror.cell_m)
    passed_s = time.process_time() - began_s
    print(f"{occupied:,} occupied cells; {view.cells:,} are drawn, in {view.nodes} nodes")
    print(f"shown for {view.sent_bytes / 1e6:.1f} MB and {passed_s:.1f} s of one core")
    print(f"longest without a turn for others: {longest * 1e3:.0f} ms")


def _update(mirror: MapMirror, view: MapLayer, page: "Page | None") -> str:
    """Blocks around a vehicle that moves change; what each update is."""
    generator = np.random.default_rng(7)
    keys = mirror.keys()
    sizes, spent_s = [], 0.0
    for number in range(UPDATES):
        vehicle = np.array([0.1 * number, 0.0, -5.0])
        near = np.linalg.norm(keys * 0.8 - vehicle, axis=1) < 12.0  # noqa: PLR2004 of a fan
        changed = generator.choice(keys[near], BLOCKS_AN_UPDATE, replace=False)
        blocks = _again(mirror, changed, generator)
        mirror.put(blocks, time.time_ns())
        begun_s = time.process_time()
        view.touch(changed)
        view.refine(vehicle, mirror.cell_m)
        sent = 0
        while view.stale:
            sent += view.draw(mirror, vehicle, 0, 1 << 40, 4)
        sizes.append(sent)
        spent_s += (time.process_time() - begun_s) / UPDATES
        if page is not None:
            page.wait_for_timeout(250)
    return (
        f"an update of {BLOCKS_AN_UPDATE} blocks: {np.median(sizes) / 1e3:.0f} kB (median), "
        f"{max(sizes) / 1e3:.0f} kB (most), {spent_s * 1e3:.0f} ms of one core; "
        f"all of the map is {view.cells * 9 / 1e6:.1f} MB"
    )


def _again(mirror: MapMirror, keys: NDArray[np.int32], generator: np.random.Generator) -> BlockSet:
    """Blocks of the mirror with a few cells turned over."""
    held = mirror.blocks()
    rows = {tuple(key): row for row, key in enumerate(held.keys.tolist())}
    cells = held.cells[[rows[tuple(key)] for key in keys.tolist()]].copy()
    turned = generator.random(cells.shape) < 0.01  # noqa: PLR2004 a share
    cells[turned] = np.where(cells[turned] == SOLID, FREE, SOLID)
    return BlockSet(keys, np.zeros(len(keys), np.uint32), cells)


def floor_blocks(number: int) -> BlockSet:
    """A floor with dunes and a few walls: about so many occupied cells."""
    edge = round((number / THICK) ** 0.5)
    x, y = np.meshgrid(np.arange(edge) - edge // 2, np.arange(edge) - edge // 2, indexing="ij")
    dune = np.round(12 * np.sin(x / 40.0) * np.cos(y / 55.0) - 70).astype(np.int64)
    dune += np.where((x % 211 < 4) & (y % 160 < 60), 40, 0)  # noqa: PLR2004 walls
    cells = np.concatenate(
        [np.stack([x, y, dune - depth], axis=-1).reshape(-1, 3) for depth in range(THICK)]
    )
    keys, row = np.unique(cells >> 3, axis=0, return_inverse=True)
    at = cells & 7
    held = np.full((len(keys), CELLS), UNKNOWN, np.int8)
    held[row.ravel(), at[:, 0] + 8 * (at[:, 1] + 8 * at[:, 2])] = SOLID
    return BlockSet(keys.astype(np.int32), np.zeros(len(keys), np.uint32), held)


@contextmanager
def _page(chromium: str, url: str) -> Iterator["Page"]:
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 only with a browser

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS.split())
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(f"{url}/?initialCameraPosition=-25,-30,15&initialCameraLookAt=0,0,-7")
        page.wait_for_selector("canvas")
        yield page
        browser.close()


if __name__ == "__main__":
    main()
