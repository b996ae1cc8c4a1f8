"""The page in a real browser, and the thread that serves it."""

import asyncio
import contextlib
import shlex
import shutil
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

import pytest

from mapperd.cli.mapperctl.view import open_page
from mapperd.viewer.app import ViewerPage

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

Result = TypeVar("Result")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-component-update",
    "--disable-sync",
]
PATIENCE_S = 30.0


@contextmanager
def chromium(network: Sequence[str] = (), folder: Path | None = None) -> Iterator["Browser"]:
    """A headless browser that draws without a graphics card.

    Args:
        network: words before a command that run it in another network.
        folder: for a script that does; needed with `network`.
    """
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("chromium is not installed")
    with sync_api.sync_playwright() as playwright:
        program = CHROMIUM
        if network and folder is not None:
            script = folder / "chromium"
            script.write_text(f'#!/bin/sh\nexec {shlex.join(network)} {CHROMIUM} "$@"\n')
            script.chmod(0o755)
            program = str(script)
        browser = playwright.chromium.launch(executable_path=program, args=ARGUMENTS)
        try:
            yield browser
        finally:
            browser.close()


class Serving:
    """A page that follows a client, in a thread of its own, `with`.

    Args:
        client: makes the client, in the thread.
        more: of `ViewerPage`.
    """

    def __init__(self, client: Callable[[], Any], **more: Any) -> None:
        self._make = client
        self._more = more
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))
        self.client: Any = None
        self.faults: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        self.server = open_page("127.0.0.1", 0)
        self._thread.start()
        assert self._ready.wait(PATIENCE_S)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.loop.call_soon_threadsafe(self._over.set)
        self._thread.join(PATIENCE_S)
        self.server.stop()
        assert self.faults == []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.get_port()}"

    def do(self, work: Callable[[], Result]) -> Result:
        """Something in the thread of the client."""

        async def done() -> Result:
            return work()

        return asyncio.run_coroutine_threadsafe(done(), self.loop).result(PATIENCE_S)

    def until(self, true: Callable[[], Any], page: "Page") -> None:
        """Wait until something is true, while the browser goes on."""
        for _ in range(int(PATIENCE_S * 10)):
            if self.do(true):
                return
            page.wait_for_timeout(100)
        raise AssertionError(f"it never became true; {self.faults}")

    async def _run(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.loop.set_exception_handler(lambda _, fault: self.faults.append(fault))
        self._over = asyncio.Event()
        self.client = self._make()
        async with contextlib.AsyncExitStack() as stack:
            if hasattr(self.client, "__aenter__"):
                await stack.enter_async_context(self.client)
            await self._show()

    async def _show(self) -> None:
        self.view = ViewerPage(self.server, self.client, **self._more)
        running = asyncio.create_task(self.view.run())
        over = asyncio.create_task(self._over.wait())
        self._ready.set()
        await asyncio.wait((running, over), return_when=asyncio.FIRST_COMPLETED)
        failed = running.done() and not running.cancelled() and running.exception()
        running.cancel()
        over.cancel()
        await asyncio.gather(running, over, return_exceptions=True)
        if failed:
            raise failed


def downloads(page: "Page", press: Callable[[], object], folder: Path) -> Path:
    """The file that the browser keeps when something is pressed."""
    with page.expect_download() as waiting:
        press()
    path = folder / waiting.value.suggested_filename
    waiting.value.save_as(path)
    return path
