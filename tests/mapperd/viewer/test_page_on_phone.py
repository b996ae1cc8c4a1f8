"""The page on a phone: its layout, the sonar image and the controls of the sonar."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import zstandard

from mapperd.client import MapClient
from mapperd.viewer.app import VIEW_WANTS
from mapperd.wire.messages import ImageMessage, StatusMessage
from tests.mapperd.viewer.view_browser import Serving, chromium
from tests.mapperd.viewer.view_fakes import FakePageClient, pose_at, some_map

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [pytest.mark.browser, pytest.mark.slow]

WIDTH, HEIGHT = 375, 812


@pytest.fixture(scope="module")
def serving() -> Iterator[Serving]:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    with Serving(lambda: FakePageClient(some_map())) as one:
        one.do(one.client.connect)
        yield one


@pytest.fixture(scope="module")
def phone(serving: Serving) -> Iterator["Page"]:
    with chromium() as browser:
        page = browser.new_page(
            viewport={"width": WIDTH, "height": HEIGHT}, has_touch=True, is_mobile=True
        )
        page.set_default_timeout(60_000)
        page.goto(serving.url)
        serving.until(lambda: "image" in serving.client.wants, page)
        yield page


def box_of(page: "Page", selector: str) -> Any:
    box = page.locator(selector).first.bounding_box()
    assert box is not None, selector
    return box


def test_map_image_and_vehicle_are_in_sight(serving: Serving, phone: "Page") -> None:
    serving.do(lambda: serving.client.feed(pose_at(1.5, -2.0, -3.25, 0.0)))
    vehicle = phone.locator("[data-phone] [data-vehicle]")
    vehicle.wait_for(state="visible")
    assert "depth 3.25 m" in vehicle.inner_text()
    assert "yaw +0" in vehicle.inner_text()
    sheet = box_of(phone, ".mantine-ScrollArea-root")
    canvas = box_of(phone, "canvas")
    assert sheet["width"] == WIDTH
    assert canvas["y"] == 0
    assert canvas["height"] > HEIGHT / 3
    assert canvas["y"] + canvas["height"] <= sheet["y"] + 1, "the sheet hides nothing of the map"
    image = phone.locator("img[style*='max-width']").first
    image.wait_for(state="visible")
    for place in (image.bounding_box(), vehicle.bounding_box()):
        assert place is not None
        assert sheet["y"] < place["y"] < place["y"] + place["height"] < HEIGHT
        assert place["x"] >= 0
        assert place["x"] + place["width"] <= WIDTH
    assert phone.evaluate("document.documentElement.scrollWidth") <= WIDTH


def test_the_folded_sheet_leaves_the_screen_to_the_map(phone: "Page") -> None:
    title = phone.get_by_text("mapperd", exact=True).first
    title.dispatch_event("click")
    phone.wait_for_function(
        f"document.querySelector('canvas').getBoundingClientRect().height > {0.9 * HEIGHT}"
    )
    title.dispatch_event("click")
    phone.wait_for_function(
        f"document.querySelector('canvas').getBoundingClientRect().height < {0.5 * HEIGHT}"
    )


def test_the_sonar_is_shown_and_controlled(serving: Serving, phone: "Page") -> None:
    image = ImageMessage(
        stamp_ns=1,
        ping_id=1,
        rows=50,
        beams=64,
        range_resolution_m=0.2,
        bearings_rad=np.linspace(-1.1, 1.1, 64).astype("<f4").tobytes(),
        body=zstandard.compress(np.full((50, 64), 250, np.uint8).tobytes()),
    )
    picture = phone.locator("img[style*='max-width']").first
    before = picture.get_attribute("src")
    serving.do(lambda: serving.client.feed(image))
    serving.until(lambda: serving.view._sonar._view.image.max() > 200, phone)
    while picture.get_attribute("src") == before:
        phone.wait_for_timeout(100)

    phone.get_by_role("tab", name="Sonar", exact=True).first.click(force=True)
    box = phone.get_by_label("Range (m)", exact=True)
    box.wait_for(state="visible")
    place = box.bounding_box()
    assert place is not None
    assert 0 < place["x"] < place["x"] + place["width"] <= WIDTH
    box.fill("8")
    serving.until(lambda: serving.client.values.get("device.range") == 8.0, phone)
    phone.get_by_text("device.range: None is now 8.0").wait_for(state="attached")
    serving.client.refuses = {"device.range": "M750d reaches 120 m in mode 1"}
    box.fill("150")
    phone.get_by_text("M750d reaches 120 m in mode 1").wait_for(state="attached")
    serving.until(lambda: serving.view._sonar._handles["device.range"].value == 10.0, phone)
    serving.client.refuses = {}
    for shown in (False, True):
        phone.get_by_label("Live image", exact=True).click(force=True)
        serving.until(lambda: ("image" in serving.client.wants) == shown, phone)  # noqa: B023 now


@pytest.fixture
def browser(phone: "Page") -> "Browser":
    assert phone.context.browser is not None
    return phone.context.browser


def test_without_a_daemon_the_banner_fits_and_names_the_remedy(
    browser: "Browser",
) -> None:
    path = f"/nonexistent/{'long-name-' * 7}/mapperd.sock"  # a socket's path has 107 bytes
    with Serving(lambda: MapClient(path, wants=VIEW_WANTS)) as serving:
        page = browser.new_page(
            viewport={"width": 390, "height": HEIGHT}, has_touch=True, is_mobile=True
        )
        page.set_default_timeout(60_000)
        page.goto(serving.url)
        # The page draws the banner anew at each attempt to connect: measure it in one look.
        place = page.wait_for_function(
            "() => { const e = document.querySelector('[data-banner] > span');"
            "if (!e?.textContent.includes('no daemon answers: start mapperd, or give --address'))"
            " return null;"
            "const { left, right } = e.getBoundingClientRect();"
            "return right > left && { left, right, cut: e.scrollWidth > e.clientWidth }; }"
        ).json_value()
        assert 0 < place["left"] < place["right"] < 390
        assert not place["cut"]


def test_a_file_is_named_and_has_no_sonar_image(serving: Serving, browser: "Browser") -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(60_000)
    page.goto(serving.url)
    page.get_by_text("CONNECTED").first.wait_for()
    image = page.locator("img[style*='max-width']")
    image.first.wait_for(state="visible")
    status = {"phase": "file", "reason": "/home/me/maps/harbour.map", "problems": []}
    serving.do(lambda: serving.client.feed(StatusMessage(stamp_ns=1, status=status, link={})))
    page.get_by_text("harbour.map", exact=True).first.wait_for()
    image.first.wait_for(state="hidden")
