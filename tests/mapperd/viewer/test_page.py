"""The page in a real browser: it shows the map, changes settings, and outlives the link."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mapperd.client import ConnectionStatus
from mapperd.viewer.colours import Scale, colours_of
from mapperd.viewer.map_layer import POINT_RADIUS
from tests.mapperd.viewer.view_browser import Serving, chromium, downloads
from tests.mapperd.viewer.view_fakes import FakePageClient, mirror_of, pose_at, some_map
from tests.mapperd.viewer.view_pictures import camera_towards, picture_of, quaternion_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.browser

WIDTH, HEIGHT = 1000, 620
FRAMES = """async () => {
    for (let n = 0; n < 5; n++) await new Promise(done => requestAnimationFrame(done));
}"""

SIZE = (200, 320)
FROM = np.array([-0.32, -0.5, 0.35])
"""A camera's way from the middle of the map, by the map's size."""

SAME_COLOUR = 24
"""Of 255: at edges the browser mixes neighbours."""


@pytest.fixture(scope="module")
def browser() -> Iterator["Browser"]:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    with chromium() as one:
        yield one


@pytest.fixture(scope="module")
def serving(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    folder = tmp_path_factory.mktemp("kept")
    with Serving(lambda: FakePageClient(some_map()), folder=folder) as one:
        one.do(one.client.connect)
        yield one


@pytest.fixture(scope="module")
def page(browser: "Browser", serving: Serving) -> "Page":
    """Opened once, for all tests: each of them leaves it as it was."""
    page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    page.set_default_timeout(30_000)
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.goto(serving.url)
    serving.until(lambda: serving.server.get_clients() and not serving.view.map.stale, page)
    elsewhere = [url for url in requests if not url.startswith((serving.url, "blob:", "data:"))]
    assert elsewhere == []
    return page


def press(page: "Page", name: str, role: Any = "button") -> None:
    page.get_by_role(role, name=name, exact=True).first.click(force=True)


def draw_points(serving: Serving, page: "Page") -> None:
    """Without shading; cubes take a computer without a graphics card seconds."""
    panel, view = serving.view._panel, serving.view
    serving.do(lambda: setattr(panel._handles.shape, "value", "points"))
    serving.do(lambda: setattr(panel._handles.shading, "value", False))
    serving.do(view._look_changed)
    serving.until(lambda: not view.map.stale and not view.map._nodes.leaving, page)


def settled(render: Callable[[], Any], patience: int = 20) -> Any:
    """A picture that is as the one before: a busy browser mounts what it was sent frames later."""
    before = render()
    for _ in range(patience):
        now = render()
        if np.array_equal(now, before):
            return now
        before = now
    raise AssertionError(f"the picture still changes after {patience} renderings")


def test_the_picture_is_that_of_the_map(serving: Serving, page: "Page") -> None:
    draw_points(serving, page)
    serving.do(lambda: serving.view._show("grid", shown=False))
    panel = serving.view._panel
    cells = mirror_of(some_map()).cells("occupied")
    low, high = cells.centres_m.min(axis=0), cells.centres_m.max(axis=0)
    at = (low + high) / 2 + FROM * np.linalg.norm(high - low)
    rotation = camera_towards(at, (low + high) / 2)
    (client,) = serving.server.get_clients().values()
    size, fov = (client.camera.image_height, client.camera.image_width), client.camera.fov
    theirs = settled(  # as large as the window: of that viser sizes points
        lambda: client.get_render(
            *size,
            wxyz=quaternion_of(rotation),
            position=tuple(at),
            fov=fov,
            transport_format="png",
            timeout=60.0,
        )
    )
    scale = Scale("height", *panel._span.ends_m)
    ours, covered = picture_of(
        cells.centres_m,
        colours_of(cells.centres_m[:, 2], scale),
        at=at,
        rotation=rotation,
        fov=fov,
        size=size,
        edge_m=2 * POINT_RADIUS * 0.1,
    )
    opaque = theirs[..., 3] > 127
    assert covered.mean() > 0.1
    assert (covered & opaque).sum() / (covered | opaque).sum() > 0.97
    apart = np.abs(theirs[..., :3].astype(int) - ours)[covered & opaque].max(axis=1)
    assert (apart <= SAME_COLOUR).mean() > 0.9


def seen(serving: Serving, client: Any) -> Any:
    """What a browser shows of the whole map, (rows, columns, 4)."""
    low, high = serving.view.map.bounds_m or ((), ())
    middle = np.add(low, high) / 2
    at = middle + FROM * np.linalg.norm(np.subtract(high, low))
    turn = quaternion_of(camera_towards(at, middle))
    return client.get_render(
        *SIZE, wxyz=turn, position=tuple(at), transport_format="png", timeout=60.0
    )


def test_a_browser_that_comes_late_sees_what_the_others_see(
    serving: Serving, page: "Page", browser: "Browser"
) -> None:
    draw_points(serving, page)
    (first,) = serving.server.get_clients().values()
    late = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    late.goto(serving.url)
    serving.until(lambda: len(serving.server.get_clients()) == 2, late)
    second = serving.server.get_clients()[max(serving.server.get_clients())]
    theirs = seen(serving, first)
    assert (theirs[..., 3] > 127).mean() > 0.1
    for _ in range(50):
        ours = seen(serving, second)
        if (ours == theirs).all():
            break
        late.wait_for_timeout(100)
    np.testing.assert_array_equal(ours, theirs)
    late.close()
    serving.until(lambda: len(serving.server.get_clients()) == 1, page)


def test_a_setting_arrives_at_the_daemon_and_a_refusal_is_shown(
    serving: Serving, page: "Page"
) -> None:
    press(page, "Settings", "tab")
    page.get_by_text("processing", exact=True).first.click(force=True)
    box = page.get_by_label("frame_skip (pings)")
    box.wait_for(state="attached")
    box.fill("5")
    press(page, "Apply processing")
    serving.until(lambda: serving.client.values == {"processing.frame_skip": 5}, page)
    page.get_by_text("is now 5").wait_for(state="attached")
    serving.client.refuses = {"processing.frame_skip": "not while the moon is full"}
    box.fill("7")
    press(page, "Apply processing")
    page.get_by_text("not while the moon is full").wait_for(state="attached")
    assert serving.client.values == {"processing.frame_skip": 5}
    serving.client.refuses = {}
    press(page, "View", "tab")


def test_a_lost_link_is_reported_and_found_again(serving: Serving, page: "Page") -> None:
    serving.do(lambda: serving.client.lose("connection refused"))
    banner = page.locator("[data-banner]")
    banner.wait_for(state="attached")
    assert "LINK LOST" in banner.inner_text()
    assert "connection refused" in banner.inner_text()
    assert serving.view.map.nodes > 0, "the map stays"
    serving.do(serving.client.connect)
    banner.wait_for(state="detached")
    serving.until(lambda: serving.view.map.nodes and not serving.view.map.stale, page)
    assert isinstance(serving.client.link, ConnectionStatus)


def test_the_map_is_exported_and_kept(page: "Page", tmp_path: Path) -> None:
    path = downloads(page, lambda: press(page, "Export map"), tmp_path)
    assert path.suffix == ".ply"
    cells = len(mirror_of(some_map()).cells("occupied"))
    assert f"element vertex {cells}\n".encode() in path.read_bytes()[:400]


def test_a_screenshot_is_a_png(page: "Page", tmp_path: Path) -> None:
    path = downloads(page, lambda: press(page, "Screenshot"), tmp_path)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_cameras_follow_the_vehicle_and_two_clicks_measure(serving: Serving, page: "Page") -> None:
    (client,) = serving.server.get_clients().values()
    serving.do(lambda: serving.client.feed(pose_at(0, 0, -4, 0.0)))
    serving.until(lambda: serving.view._pose is not None, page)
    press(page, "follow")
    behind = np.array([-7.0, -4.0, 1.0])
    serving.until(lambda: np.allclose(client.camera.position, behind, atol=0.05), page)
    time.sleep(0.11)  # poses are drawn ten times a second
    serving.do(lambda: serving.client.feed(pose_at(2, 1, -4, 0.5)))
    serving.until(
        lambda: np.allclose(client.camera.position, np.add(behind, (2, 1, 0)), atol=0.05), page
    )
    press(page, "free")
    serving.until(lambda: serving.view._cameras.mode(client) == "free", page)
    measure(serving, page, client)


def measure(serving: Serving, page: "Page", client: Any) -> None:
    page.get_by_label("Measure", exact=True).first.click(force=True)
    tools = serving.view._tools._browsers[client.client_id]
    serving.until(lambda: tools.measured.visible, page)
    parts = [one for one in serving.view.map.drawn if len(one)]
    top = [
        one.origin_m + (one.local[np.argmax(one.local[:, 2])] + 0.5) * one.cell_m for one in parts
    ]
    for number, target in enumerate((top[0], top[-1]), 1):
        serving.do(partial(look_down_at, client, target))
        page.wait_for_timeout(500)
        page.evaluate(FRAMES)  # however slowly they are drawn, some show the new place
        page.mouse.click(WIDTH / 2, HEIGHT / 2)
        serving.until(lambda: len(tools.measuring.points_m) == number, page)  # noqa: B023 now
        assert np.abs(tools.measuring.points_m[-1] - target)[:2].max() < 0.15
    page.get_by_text("dx ").first.wait_for(state="attached")
    page.get_by_label("Measure", exact=True).first.click(force=True)
    serving.until(lambda: not tools.marks, page)


def look_down_at(client: Any, target: Any) -> None:
    client.camera.position = np.add(target, (0.0, -0.01, 5.0))
    client.camera.look_at = target
