"""`mapperctl view`: serve the page, open to this computer's browsers alone."""

import argparse
import asyncio
import contextlib
import functools
import ipaddress
import json
import signal
import webbrowser
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from mapperd.cli.mapperctl.errors import CtlError, CtlExit
from mapperd.client import Interest, MapClient, StreamError
from mapperd.errors import missing_extra
from mapperd.foxglove.recording import FoxgloveRecording
from mapperd.viewer.app import VIEW_WANTS, ViewerPage
from mapperd.wire.auth import is_loopback

if TYPE_CHECKING:
    import ssl

    from viser import ViserServer

__all__ = ["open_page", "run_view", "same_origin"]


def open_page(host: str, port: int) -> "ViserServer":
    """Serve an empty page.

    Raises:
        CtlError: viser is missing, or the port is taken.
    """
    try:
        import rich  # noqa: PLC0415 of the extra `topside`
        import viser  # noqa: PLC0415
    except ImportError as error:
        raise CtlError(missing_extra(error.name or "viser", "topside"), CtlExit.USAGE) from error
    rich.reconfigure(quiet=True)  # it prints boxes
    with _only_from_here():
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if port not in (0, server.get_port()):  # it takes the next one that is free
        server.stop()
        raise CtlError(f"{host}:{port}: somebody else listens there: --port", CtlExit.UNAVAILABLE)
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
    server = open_page(args.host, args.port)
    try:
        url = f"http://{_named(args.host)}:{server.get_port()}"
        if args.open:
            webbrowser.open(url)
        yield json.dumps({"url": url}) if args.json else f"the map is shown at {url}"
        client = MapClient(
            address,
            token=token,
            tls=tls,
            wants=VIEW_WANTS,
            interest=Interest(level=args.level, radius_m=args.radius),
            name="mapperctl view",
        )
        asyncio.run(
            _follow(server, client, may_change=is_loopback(args.host) or args.allow_changes)
        )
    except StreamError as error:
        code = CtlExit.NO_PERMISSION if error.reason in REFUSED else CtlExit.PROTOCOL
        raise CtlError(str(error), code) from error
    finally:
        server.stop()


async def _follow(server: "ViserServer", client: MapClient, *, may_change: bool) -> None:
    loop = asyncio.get_running_loop()
    with contextlib.suppress(NotImplementedError, RuntimeError):  # a thread, or no Unix
        loop.add_signal_handler(signal.SIGTERM, lambda: loop.create_task(client.close()))
    async with client:
        await ViewerPage(server, client, may_change=may_change, recorder=FoxgloveRecording).run()


def _named(host: str) -> str:
    """As it stands in an address of the web."""
    if host in ("0.0.0.0", "::"):  # noqa: S104 it is compared, not opened
        return "localhost"
    return f"[{host}]" if ":" in host else host
