"""The page as a reader of the first dive sees it: real daemon, simulated sonar, real browser.

With the environment variable MAPPERD_PICTURES the pictures of the documentation are written into
that folder: `MAPPERD_PICTURES=docs/images pytest -n0 tests/mapperd/viewer/test_first_dive_page.py`.
"""

import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mapperd.export.clouds import DIFFERENCE_CLASSES
from tests.mapperd.viewer.view_browser import chromium
from tests.support.shell_blocks import Block, Reader, follow

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.net,
    pytest.mark.timeout(7200),
    pytest.mark.skipif(
        "MAPPERD_PICTURES" not in os.environ,
        reason="a browser without a GPU draws for minutes: set MAPPERD_PICTURES to a folder",
    ),
]

FIRST_DIVE = Path(__file__).resolve().parents[3] / "docs" / "getting-started" / "first-dive.md"
PATIENCE_S = 1200.0
MIN_CELLS = 500
SETTLE_S = 5.0
"""For labels of buttons to vanish, and for what waits for the browser to be drawn."""

MAPPED_S = 45.0
"""Of mapping before the page is opened: the vehicle has seen the quay."""

HAS_CONTRAST_JS = """
images => images.some(image => {
  const canvas = new OffscreenCanvas(190, 80), pen = canvas.getContext("2d");
  pen.drawImage(image, 0, 0, 190, 80);
  const levels = pen.getImageData(0, 0, 190, 80).data.filter((_, at) => at % 4 == 0);
  return Math.max(...levels) > 100;
})
"""
"""Whether an image is brighter somewhere than the background of the sonar's picture."""


WIDE: dict[str, Any] = {"viewport": {"width": 1280, "height": 800}}
PHONE: dict[str, Any] = {
    "viewport": {"width": 390, "height": 844},
    "has_touch": True,
    "is_mobile": True,
}


@contextmanager
def page_of(reader: Reader, device: dict[str, Any]) -> Iterator["Page"]:
    """Yield the page in a browser of the reader's network, once it shows map and sonar."""
    with chromium(reader.network, reader.folder) as browser:
        page = browser.new_page(**device)
        page.set_default_timeout(1000 * PATIENCE_S)
        page.goto("http://127.0.0.1:8080")
        page.wait_for_selector("canvas")
        wait_until_mapped(page)
        notes = page.locator(".mantine-Notification-closeButton")
        notes.evaluate_all("buttons => buttons.forEach(button => button.click())")
        page.wait_for_timeout(1000 * SETTLE_S)
        yield page


def cells_of(page: "Page") -> int:
    """Return the number of map cells that the page shows."""
    found = re.search(r"cells\s*([\d,]+)", page.evaluate("document.body.textContent"))
    return int(found[1].replace(",", "")) if found else 0


def shows_an_image(page: "Page") -> bool:
    """Return whether the sonar's picture has more in it than the background."""
    return bool(page.eval_on_selector_all("img[src^='blob:']", HAS_CONTRAST_JS))


def wait_until_mapped(page: "Page") -> None:
    """Wait for map cells and a sonar image."""
    end_s = time.monotonic() + PATIENCE_S
    while cells_of(page) < MIN_CELLS or not shows_an_image(page):
        assert time.monotonic() < end_s, f"{cells_of(page)} cells, {shows_an_image(page)=}"
        page.wait_for_timeout(500)


def draw_changes(cloud: Path, out: Path) -> None:
    """Draw the coloured cloud of `mapperctl diff` from above and from the side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 for pictures only
    from matplotlib.figure import Figure  # noqa: PLC0415
    from plyfile import PlyData  # noqa: PLC0415

    points = PlyData.read(cloud)["vertex"]
    x, y, z = (np.asarray(points[name]) for name in "xyz")
    figure = Figure(figsize=(10, 9), layout="constrained")
    FigureCanvasAgg(figure)
    views = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    for axes, up, name in zip(
        views, (y, z), ("y (m), from above", "z (m), from the side"), strict=True
    ):
        for kind, (label, colour) in enumerate(DIFFERENCE_CLASSES.items()):
            shown = np.asarray(points["class"]) == kind
            at = [x[shown], up[shown]]
            axes.scatter(
                *at, c=[np.divide(colour, 255)], marker="s", s=9, linewidths=0, label=label
            )
        axes.set_aspect("equal")
        axes.set_ylabel(name)
    views[1].set_xlabel("x (m)")
    views[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), markerscale=2)
    figure.savefig(out, dpi=80)


def draw_page(reader: Reader, folder: Path) -> None:
    """Save pictures of the page: with the map, with the controls of the sonar, and on a phone."""
    with page_of(reader, WIDE) as page:
        page.screenshot(path=folder / "first-dive.png")
        page.get_by_role("tab", name="Sonar", exact=True).dispatch_event(
            "keydown", {"key": "Enter"}
        )
        page.get_by_label("Range (m)", exact=True).wait_for()
        page.wait_for_timeout(1000 * SETTLE_S)
        page.screenshot(path=folder / "first-dive-sonar.png")
    with page_of(reader, PHONE) as page:
        page.screenshot(path=folder / "view-phone.png")


def with_usual_sockets(reader: Reader, _: ExitStack) -> None:
    """Have the address of the daemon on the page be that of a reader's computer."""
    folder = "/run/user/1000"
    if reader.network:
        reader.run(f"mount -t tmpfs tmpfs /run && mkdir -p {folder}")
        reader.environment["XDG_RUNTIME_DIR"] = folder


def test_a_reader_of_the_first_dive_sees_map_and_sonar(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    pictures = Path(os.environ["MAPPERD_PICTURES"]).absolute()
    pictures.mkdir(exist_ok=True)
    drawn = []

    def look(block: Block, reader: Reader) -> bool:
        if "mapperctl view" in block.code:
            time.sleep(MAPPED_S)
            draw_page(reader, pictures)
            drawn.append("page")
        if block.ended == "mapperd":
            shutil.copy(reader.folder / "dive" / "map.png", pictures / "first-dive-map.png")
        if "changes.ply" in block.code:
            draw_changes(reader.folder / "changes.ply", pictures / "first-dive-diff.png")
            drawn.append("changes")
        return True

    follow(FIRST_DIVE, tmp_path, stage=with_usual_sockets, after=look)
    assert drawn == ["page", "changes"]
