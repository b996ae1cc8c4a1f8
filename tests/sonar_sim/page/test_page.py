"""The page of a served scene in a real browser: it shows pings and is driven by keys."""

import asyncio
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from sonar_sim.device.server import ServedScenario, ServeSettings
from sonar_sim.geometry.live_path import LivePath
from sonar_sim.geometry.trajectory import Route
from sonar_sim.scene.scenario import Scenario

from tests.mapperd.viewer.view_browser import chromium
from tests.sonar_sim.device.conftest import floor_scenario

if TYPE_CHECKING:
    from playwright.sync_api import Page

__all__ = ["floor_scenario"]

pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.net, pytest.mark.timeout(600)]

MakeScenario = Callable[..., Scenario]
PATIENCE_S = 120


@contextmanager
def page_of(scenario: Scenario) -> Iterator[tuple[str, ServedScenario]]:
    """A scenario served with its page, in a thread of its own: the page's address."""
    app = pytest.importorskip("sonar_sim.page.app")
    helm_module = pytest.importorskip("sonar_sim.page.helm")
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    ready, over = threading.Event(), asyncio.Event()
    found: dict[str, Any] = {}

    async def serve() -> None:
        path = LivePath(scenario.trajectory.pose(0.0))
        settings = ServeSettings(follow={scenario.vehicle.name: path})
        async with ServedScenario(scenario, settings) as served:
            route = Route(scenario.trajectory, "stay")
            helm = helm_module.Helm(route, path, served.route_s)
            server = app.open_scene_page("127.0.0.1", 0)
            page = asyncio.create_task(app.ScenePage(server, served, helm).run())
            found.update(loop=asyncio.get_running_loop(), served=served, helm=helm)
            found["url"] = f"http://127.0.0.1:{server.get_port()}"
            ready.set()
            await over.wait()
            page.cancel()
            await asyncio.gather(page, return_exceptions=True)
            server.stop()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        assert ready.wait(PATIENCE_S)
        yield found["url"], found["served"]
    finally:
        found["loop"].call_soon_threadsafe(over.set)
        thread.join(PATIENCE_S)


def number(page: "Page", pattern: str) -> float:
    """A number of the page's text; NaN where it is not there."""
    match = re.search(pattern, page.evaluate("document.body.textContent"))
    return float(match[1]) if match else float("nan")


def wait_for(page: "Page", true: Callable[[], bool]) -> None:
    for _ in range(PATIENCE_S * 5):
        if true():
            return
        page.wait_for_timeout(200)
    raise AssertionError(page.evaluate("document.body.textContent"))


def test_the_page_shows_pings_and_drives_the_vehicle(floor_scenario: MakeScenario) -> None:
    with page_of(floor_scenario()) as (url, served), chromium() as browser:
        page = browser.new_page(viewport={"width": 900, "height": 600})
        page.set_default_timeout(1000 * PATIENCE_S)
        page.goto(url)
        page.wait_for_selector("canvas")
        wait_for(page, lambda: number(page, r"([\d.]+) pings/s") > 0.0)
        wait_for(page, lambda: page.locator("img[src^='blob:']").count() > 0)
        page.keyboard.press("h")
        wait_for(page, lambda: number(page, r"([\d.]+) m deep") > 2.5)
        page.keyboard.press("Space")
        wait_for(page, lambda: number(page, r", ([\d.]+) m/s") < 0.02)
        assert page.get_by_label("Drive by keys").is_checked()
        page.get_by_text("turn to port [J]").dispatch_event("click")
        wait_for(page, lambda: 180.0 < number(page, r"heading ([\d.]+)") < 350.0)
        assert served.sonar.device.simulated == 0, "no client asked for a ping"
