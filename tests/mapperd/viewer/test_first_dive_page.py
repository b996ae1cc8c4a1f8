"""The page as a reader of the first dive sees it: real daemon, simulated sonar, real browser.

With the environment variable MAPPERD_PICTURES the pictures of the documentation are written into
that folder: `MAPPERD_PICTURES=docs/images pytest -n0 tests/mapperd/viewer/test_first_dive_page.py`.
"""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.mapperd.viewer.view_browser import chromium
from tests.support.shell_blocks import Block, Reader, follow

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.net,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(
        "MAPPERD_PICTURES" not in os.environ,
        reason="a browser without a GPU draws for minutes: set MAPPERD_PICTURES to a folder",
    ),
]

FIRST_DIVE = Path(__file__).resolve().parents[3] / "docs" / "getting-started" / "first-dive.md"
PATIENCE_MS = 180_000.0
MIN_CELLS = 500
BLANK_LETTERS = 8000
"""Length of the sonar image's address without an image, at most."""

PICTURE_S = 60.0
"""Of mapping, before pictures for the documentation are taken."""


@contextmanager
def page_of(reader: Reader) -> Iterator["Page"]:
    """Yield the page in a browser of the reader's network."""
    with chromium(reader.network, reader.folder) as browser:
        # The smaller the page, the less a processor draws.
        wide = "MAPPERD_PICTURES" in os.environ
        size = {"width": 1280, "height": 800} if wide else {"width": 640, "height": 400}
        page = browser.new_page(viewport=size)  # type: ignore[arg-type]
        page.set_default_timeout(PATIENCE_MS)
        page.goto("http://127.0.0.1:8080")
        page.wait_for_selector("canvas")
        yield page


def cells_of(page: "Page") -> int:
    """Return the number of map cells that the page shows."""
    found = re.search(r"cells\s*([\d,]+)", page.evaluate("document.body.textContent"))
    return int(found[1].replace(",", "")) if found else 0


def shows_an_image(page: "Page") -> bool:
    """Return whether the sonar's picture has more in it than the background."""
    sources = page.eval_on_selector_all("img", "all => all.map(one => one.src)")
    return any(len(source) > BLANK_LETTERS for source in sources)


def wait_until_mapped(page: "Page", cells: int) -> None:
    """Wait for map cells and a sonar image."""
    for _ in range(int(PATIENCE_MS / 500)):
        if cells_of(page) >= cells and shows_an_image(page):
            return
        page.wait_for_timeout(500)
    raise AssertionError(f"{cells_of(page)} cells, image: {shows_an_image(page)}")


def draw_changes(cloud: Path, out: Path) -> None:
    """Draw the coloured cloud of `mapperctl diff` from above and from the side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 for pictures only
    from matplotlib.figure import Figure  # noqa: PLC0415
    from plyfile import PlyData  # noqa: PLC0415

    points = PlyData.read(cloud)["vertex"]
    x, y, z = (np.asarray(points[name]) for name in "xyz")
    colours = np.stack([points[name] for name in ("red", "green", "blue")], axis=1) / 255
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    for place, (up, name) in enumerate(((y, "y (m), from above"), (z, "z (m), from the side"))):
        axes = figure.add_subplot(1, 2, place + 1)
        axes.scatter(x, up, c=colours, s=2, linewidths=0)
        axes.set_aspect("equal")
        axes.set_xlabel("x (m)")
        axes.set_ylabel(name)
    figure.savefig(out, dpi=90)


def test_a_reader_of_the_first_dive_sees_map_and_sonar(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    wanted = os.environ.get("MAPPERD_PICTURES")
    pictures = Path(wanted or tmp_path / "pictures").absolute()
    pictures.mkdir(exist_ok=True)
    home = tmp_path / "reader"
    home.mkdir()
    looked = []

    def look(block: Block, reader: Reader) -> bool:
        if "mapperctl view" in block.code:
            with page_of(reader) as page:
                wait_until_mapped(page, MIN_CELLS)
                if wanted:
                    page.wait_for_timeout(1000 * PICTURE_S)
                page.screenshot(path=pictures / "first-dive.png", timeout=PATIENCE_MS)
                page.get_by_role("tab", name="Sonar", exact=True).click(force=True)
                page.get_by_text("Threshold").first.wait_for(timeout=PATIENCE_MS)
                page.wait_for_timeout(2000)
                page.screenshot(path=pictures / "first-dive-sonar.png", timeout=PATIENCE_MS)
                looked.append(cells_of(page))
        if wanted and "changes.ply" in block.code:
            draw_changes(reader.folder / "changes.ply", pictures / "first-dive-diff.png")
        if wanted and "calibrate" in block.code:
            shutil.copy(reader.folder / "calibration" / "calibration.png", pictures)
        return bool(wanted) or not looked

    follow(FIRST_DIVE, home, after=look)
    assert looked
    assert looked[0] >= MIN_CELLS
