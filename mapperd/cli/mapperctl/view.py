"""`mapperctl view` and `mapperd --view`: serve the page, by default to this computer alone."""

import argparse
import asyncio
import contextlib
import errno
import functools
import ipaddress
import json
import shlex
import signal
import socket
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

from mapperd.cli.mapperctl.connection import CtlError, file_error_code
from mapperd.client import Interest, LinkChanged, MapClient, StreamError
from mapperd.config.tree import Config
from mapperd.daemon.map_server import MapServer, saved_map
from mapperd.daemon.supervisor import deferred_interrupt
from mapperd.errors import MapperdError, missing_extra, os_reason
from mapperd.export.formats import PROBABILITY_FORMATS
from mapperd.foxglove.recording import FoxgloveRecording
from mapperd.localization.status import LocalizationSnapshot
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.worker import StatusSnapshot
from mapperd.viewer.app import VIEW_WANTS, ViewerPage
from mapperd.wire.auth import is_loopback
from oculus_driver.command_line import ExitCode

if TYPE_CHECKING:
    import ssl

    from viser import ViserServer

__all__ = ["ReplayView", "open_page", "run_file_view", "run_view", "same_origin"]


def open_page(host: str, port: int) -> "ViserServer":
    """Serve an empty page.

    Raises:
        CtlError: viser is missing, or the port is taken.
    """
    try:
        import rich  # noqa: PLC0415 of the extra `topside`
        import viser  # noqa: PLC0415
    except ImportError as error:
        text = missing_extra(error.name or "viser", "topside")
        raise CtlError(text, ExitCode.BAD_CONFIG) from error
    _require_free(host, port)
    rich.reconfigure(quiet=True)  # it prints boxes
    _push_from_any_thread()
    with _only_from_here():
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if port not in (0, server.get_port()):  # taken since then: it goes on to the next one
        server.stop()
        raise _taken(host, port)
    server.request_share_url = _never_shared  # type: ignore[method-assign]
    server.gui.configure_theme(
        dark_mode=True, show_logo=False, show_share_button=False, brand_color=(14, 116, 144)
    )
    server.gui.set_panel_label("mapperd")
    server.scene.configure_default_lights(enabled=False)
    server.scene.configure_environment_map(None)  # colours are to be those of the legend
    server.scene.add_light_ambient("/light/all", intensity=1.5)
    server.scene.add_light_directional(
        "/light/sun", intensity=2.0, position=(6.0, -9.0, 14.0), cast_shadow=False
    )
    return server


MAX_PORT = 65535


def _require_free(host: str, port: int) -> None:
    """Refuse where viser would wait without end: it tries 1000 ports, and does not say why."""
    if not 0 <= port <= MAX_PORT:
        raise CtlError(f"port {port}: ports go from 0 to {MAX_PORT}", ExitCode.USAGE)
    try:
        place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        socket.create_server(place[4][:2], family=place[0]).close()
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise _taken(host, port) from error
        text = f"{host}: the page cannot be served there: {os_reason(error)}"
        raise CtlError(text, ExitCode.UNAVAILABLE) from error


def _taken(host: str, port: int) -> CtlError:
    text = f"{host}:{port}: another program listens there: choose another --port"
    return CtlError(text, ExitCode.UNAVAILABLE)


@functools.cache
def _push_from_any_thread() -> None:
    """Keep a message whose event could not be set.

    viser 1.1 sets the event of a buffer in our thread while its own thread may change the list of
    who waits for it: "deque mutated during iteration". The message is in the buffer by then.
    """
    from viser.infra._async_message_buffer import AsyncMessageBuffer  # noqa: PLC0415 as above

    plain = AsyncMessageBuffer.push

    @functools.wraps(plain)
    def push(buffer: AsyncMessageBuffer, message: Any) -> None:  # noqa: ANN401 of viser
        try:
            plain(buffer, message)
        except RuntimeError:
            with contextlib.suppress(RuntimeError):  # its loop has ended
                buffer.event_loop.call_soon_threadsafe(buffer.message_event.set)

    AsyncMessageBuffer.push = push  # type: ignore[assignment, method-assign]


def same_origin(origin: str | None, host: str | None) -> bool:
    """Return whether a connection comes from our own page; browsers let no page forge this.

    Args:
        origin: header of the request; None where it comes from no browser.
        host: header of the request.
    """
    if origin is None:
        return True
    return host is not None and urlsplit(origin).netloc == host and _is_near(host)


def _is_near(host: str) -> bool:
    """An address, or a name that nobody on the Internet owns, and so cannot point at us."""
    name = urlsplit(f"//{host}").hostname or ""
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    return "." not in name or name.endswith(".local")


@contextlib.contextmanager
def _only_from_here() -> Iterator[None]:
    """Connections that pages of others make are refused: the page may change settings."""
    from websockets.asyncio import server as sockets  # noqa: PLC0415 of the extra `topside`

    plain = sockets.serve

    def serve(*args: Any, process_request: Callable[..., Any], **more: Any) -> Any:  # noqa: ANN401
        @functools.wraps(process_request)
        def checked(connection: Any, request: Any) -> Any:  # noqa: ANN401
            if not same_origin(request.headers.get("Origin"), request.headers.get("Host")):
                return connection.respond(403, "another page's connection\n")
            return process_request(connection, request)

        return plain(*args, process_request=checked, **more)

    sockets.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        sockets.serve = plain  # type: ignore[misc]


def _never_shared(*_: object, **__: object) -> None:
    """Never share the page with other computers."""
    return


UPDATE_S = 0.2
"""Period of the status of a replay."""

REFUSED = ("wrong_token", "needs_token", "no_permission", "not_trusted")


def run_view(
    args: argparse.Namespace, address: str, token: bytes | None, tls: "ssl.SSLContext | None"
) -> Iterator[str]:
    """Serve the page; yields where it is, and ends with the command.

    Args:
        args: parsed command line.
        address: address of the map stream, as in `MapClient`.
        token: token of the TCP socket.
        tls: TLS context for TCP.

    Raises:
        CtlError: the page cannot be served, or the daemon will not have us.
    """
    may_change = is_loopback(args.host) or args.allow_changes
    with _page(args) as (server, line):
        yield line
        asyncio.run(_follow(server, _client(args, address, token, tls), may_change=may_change))


def run_file_view(args: argparse.Namespace, config: Config) -> Iterator[str]:
    """Serve the page for a map file, and follow the file while it is written.

    Args:
        args: parsed command line.
        config: settings that the file does not contain.

    Raises:
        CtlError: the page cannot be served, or the file is no map.
    """
    if args.socket or args.address:
        raise CtlError("a file needs neither --socket nor --address", ExitCode.USAGE)
    try:
        sonar_map, store = saved_map(args.file, config)
        shown = MapServer(sonar_map, store, str(args.file), "file")
    except MapperdError as error:
        if args.file.is_dir():
            text = f"{args.file}: is a folder; to show its recordings: {_replayed(args.file)}"
            raise CtlError(text, ExitCode.NO_INPUT) from error
        raise CtlError(f"{error}{_hint(args.file)}", file_error_code(error)) from error
    with _page(args) as (server, line):
        yield line
        if store is not None and store.remarks and not args.json:
            yield f"{args.file}: {store.remarks}"
        asyncio.run(_show(server, shown, args))


def _replayed(path: Path) -> str:
    return f"mapperd --replay {shlex.quote(str(path))} --view"


def _hint(path: Path) -> str:
    """Return what shows a file that is no map."""
    if not path.exists():
        return ""
    if path.suffix in (*PROBABILITY_FORMATS, ".xyz"):
        return "; it is a point cloud: open it with CloudCompare or MeshLab"
    return f"; if it is a recording: {_replayed(path)}"


class ReplayView:
    """The page of a running replay, in a thread of its own, `with`; use from one other thread.

    Args:
        port: of the page.
        sonar_map: create this before mapping begins.
        what: what is replayed, for people.

    Raises:
        CtlError: the page cannot be served.

    Attributes:
        put: takes the results of pings.
        line: text with the address of the page.
    """

    def __init__(self, port: int, sonar_map: SonarMap, what: str) -> None:
        self._shown = MapServer(sonar_map, None, what, "replay")
        self.put = self._shown.feed.put
        self._args = argparse.Namespace(
            host="127.0.0.1", port=port, level=0, radius=0.0, open=False, json=False
        )
        self._updated_s = 0.0
        self._stop: Callable[[], object] = lambda: None
        self._left = False
        self._ended = threading.Event()
        with contextlib.ExitStack() as undo:
            self._server, self.line = undo.enter_context(_page(self._args))
            self._open = undo.pop_all()

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._serve, name="page")
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._left = True  # its loop may not run yet
        with self._open:
            with contextlib.suppress(RuntimeError):  # its loop has ended
                self._stop()
            self._ended.wait()  # an interrupted `join` would take the thread for ended

    def update(self, counters: PipelineCounters, localization: LocalizationSnapshot | None) -> None:
        """Show how far the replay is; now and then."""
        now_s = time.monotonic()
        if now_s - self._updated_s < UPDATE_S:
            return
        self._updated_s = now_s
        pings = {
            "total": counters.pings_total,
            "mapped": counters.pings_mapped,
            "dropped": dict(counters.pings_dropped),
        }
        self._shown.replayed = StatusSnapshot(
            pings, None, {}, {"source": "odometry"}, [], None, None, {}, {}, 0, localization
        )

    def wait(self, announce: Callable[[], object]) -> None:
        """Keep the page open until Ctrl-C.

        Args:
            announce: is called once Ctrl-C ends the page.
        """
        self._shown.phase = "replay finished"
        with contextlib.suppress(KeyboardInterrupt):
            announce()
            self._ended.wait()

    def _serve(self) -> None:
        try:
            asyncio.run(self._run())
        finally:
            self._ended.set()

    async def _run(self) -> None:
        task = asyncio.ensure_future(_show(self._server, self._shown, self._args))
        self._stop = partial(asyncio.get_running_loop().call_soon_threadsafe, task.cancel)
        if self._left:
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def _show(server: "ViserServer", shown: MapServer, args: argparse.Namespace) -> None:
    """Serve the map and the page in one event loop."""
    async with shown.serving() as address:
        await _follow(server, _client(args, address, None, None), may_change=False)


@contextlib.contextmanager
def _page(args: argparse.Namespace) -> Iterator[tuple["ViserServer", str]]:
    """Serve an empty page; yields it and the line that names it."""
    with contextlib.ExitStack() as stack:
        with deferred_interrupt():
            server = open_page(args.host, args.port)
            stack.callback(server.stop)
        url = f"http://{_named(args.host)}:{server.get_port()}"
        if args.open:
            webbrowser.open(url)
        try:
            yield server, json.dumps({"url": url}) if args.json else f"the map is shown at {url}"
        except StreamError as error:
            code = ExitCode.NO_PERMISSION if error.reason in REFUSED else ExitCode.PROTOCOL
            raise CtlError(str(error), code) from error


def _client(
    args: argparse.Namespace, address: str, token: bytes | None, tls: "ssl.SSLContext | None"
) -> MapClient:
    return MapClient(
        address,
        token=token,
        tls=tls,
        wants=VIEW_WANTS,
        interest=Interest(level=args.level, radius_m=args.radius),
        name="mapperctl view",
    )


async def _follow(server: "ViserServer", client: MapClient, *, may_change: bool) -> None:
    loop = asyncio.get_running_loop()
    with contextlib.suppress(NotImplementedError, RuntimeError):  # a thread, or no Unix
        loop.add_signal_handler(signal.SIGTERM, lambda: loop.create_task(client.close()))
    async with client:
        page = ViewerPage(server, client, may_change=may_change, recorder=FoxgloveRecording)
        reporting = asyncio.create_task(_report_link(client))
        try:
            await page.run()
        finally:
            reporting.cancel()


async def _report_link(client: MapClient) -> None:
    """Report each outage of the link in one line; the page shows it, too."""
    is_reported = False
    with contextlib.suppress(StreamError):  # the page raises it
        async for change in client.changes():
            if not isinstance(change, LinkChanged):
                continue
            link = change.link
            if link.state == "connected":
                if is_reported:
                    sys.stderr.write(f"mapperctl: {link.address}: connected\n")
                is_reported = False
            elif link.reason and not is_reported:
                text = f"{link.address}: no daemon answers: {link.reason}; trying again"
                sys.stderr.write(f"mapperctl: {text}\n")
                is_reported = True


def _named(host: str) -> str:
    """Return an address as it stands in a URL."""
    if host in ("0.0.0.0", "::"):  # noqa: S104 it is compared, not opened
        return "localhost"
    return f"[{host}]" if ":" in host else host
