"""The page follows the daemon's own server: its map, its settings, and its restart."""

import asyncio
from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mapperd.client import Interest, MapClient
from mapperd.client import client as client_module
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.listeners import open_unix_listener
from mapperd.server.map_source import MapSource
from mapperd.server.state_feed import StateFeed
from mapperd.server.stream_server import StreamServer
from mapperd.viewer.app import VIEW_WANTS
from tests.mapperd.viewer.view_browser import Serving, chromium
from tests.support.control_server import FakeDaemon

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = [pytest.mark.browser, pytest.mark.slow]


class InMemory:
    store = None


class Daemon:
    """A daemon's settings and stream over a map, which can be ended and begun again.

    It lives in the loop of the page.
    """

    def __init__(self, path: Path) -> None:
        self.map = SonarMap(Config())
        self.settings: Any = None
        self._path = path
        self._stack: AsyncExitStack | None = None

    async def begin(self) -> None:
        daemon = FakeDaemon()
        self.settings = daemon.settings
        self.settings.follow(["processing.frame_skip"], lambda _: None)
        self._stack = AsyncExitStack()
        source = self._stack.enter_context(MapSource(self.map, InMemory(), log_odds_step=0.25))
        feed = StateFeed(daemon, lambda: None, 1000)
        listener = open_unix_listener(self._path, 0o600)
        await self._stack.enter_async_context(
            StreamServer(daemon, [listener], feed, source, now_ns=lambda: 1_700_000_000_000_000_000)
        )

    async def end(self) -> None:
        assert self._stack is not None
        await self._stack.aclose()
        self._stack = None

    def build(self, x: float) -> None:
        """A pile."""
        cells = np.indices((4, 4, 20)).reshape(3, -1).T + 0.5
        at = np.ascontiguousarray(self.map.resolution_m * cells + (x, 0.0, -5.0))
        for _ in range(6):
            self.map.core.observe(at, np.full(len(at), 200.0), np.ones(len(at), bool))


@pytest.fixture
def browser() -> Iterator["Browser"]:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    with chromium() as one:
        yield one


def test_the_page_follows_a_daemon_through_a_restart(
    browser: "Browser", short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "MAX_RETRY_DELAY_S", 0.2)
    path = short / "map.sock"
    daemon = Daemon(path)
    daemon.build(0.0)

    def client() -> MapClient:
        return MapClient(str(path), wants=VIEW_WANTS, interest=Interest())

    with Serving(client, folder=short) as serving:

        def wait(work: Any) -> None:
            asyncio.run_coroutine_threadsafe(work, serving.loop).result(30)

        page = browser.new_page(viewport={"width": 1000, "height": 620})
        page.goto(serving.url)
        banner = page.locator("[data-banner]")
        banner.wait_for(state="attached")
        assert "NO LINK" in banner.inner_text()

        wait(daemon.begin())
        banner.wait_for(state="detached")
        shell_of_pile = 4 * 4 * 20 - 2 * 2 * 18
        serving.until(lambda: serving.view.map.cells == shell_of_pile, page)

        page.get_by_role("tab", name="Settings", exact=True).click(force=True)
        page.get_by_text("processing", exact=True).first.click(force=True)
        box = page.get_by_label("frame_skip (pings)")
        box.wait_for(state="attached")
        box.fill("5")
        page.get_by_role("button", name="Apply processing").first.dispatch_event("click")
        serving.until(lambda: daemon.settings.current.processing.frame_skip == 5, page)
        page.get_by_text("processing.frame_skip: 1 is now 5").wait_for(state="attached")

        wait(daemon.end())
        banner.wait_for(state="attached")
        assert "LINK LOST" in banner.inner_text()
        assert serving.view.map.cells == shell_of_pile, "the map stays while there is no link"
        daemon.build(3.0)
        wait(daemon.begin())
        banner.wait_for(state="detached")
        serving.until(lambda: serving.view.map.cells == 2 * shell_of_pile, page)
        wait(daemon.end())
