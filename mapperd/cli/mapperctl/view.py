"""`mapperctl view`: serves the page until it is told to stop."""

import argparse
import asyncio
import contextlib
import json
import signal
import webbrowser
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mapperd.cli.mapperctl.errors import CtlError, Exit
from mapperd.cli.mapperctl.hosts import is_local
from mapperd.cli.mapperctl.view_page import open_page
from mapperd.client import Interest, MapClient, StreamError
from mapperd.foxglove.recording import Recording
from mapperd.viewer.app import VIEW_WANTS, View

if TYPE_CHECKING:
    import ssl

    from viser import ViserServer

__all__ = ["run_view"]

REFUSED = ("wrong_token", "needs_token", "no_permission", "not_trusted")


def run_view(
    said: argparse.Namespace, address: str, token: bytes | None, tls: "ssl.SSLContext | None"
) -> Iterator[str]:
    """Serve the page; yields where it is, and ends with the command.

    Args:
        said: on the command line.
        address: of the map stream, as `MapClient` takes it.
        token: that its TCP socket asks for.
        tls: encrypts TCP.

    Raises:
        CtlError: the page cannot be served, or the daemon will not have us.
    """
    server = open_page(said.host, said.port)
    try:
        url = f"http://{_named(said.host)}:{server.get_port()}"
        if said.open:
            webbrowser.open(url)
        yield json.dumps({"url": url}) if said.json else f"the map is shown at {url}"
        client = MapClient(
            address,
            token=token,
            tls=tls,
            wants=VIEW_WANTS,
            interest=Interest(level=said.level, radius_m=said.radius),
            name="mapperctl view",
        )
        asyncio.run(_follow(server, client, may_change=is_local(said.host) or said.allow_changes))
    except StreamError as error:
        code = Exit.NO_PERMISSION if error.reason in REFUSED else Exit.PROTOCOL
        raise CtlError(str(error), code) from error
    finally:
        server.stop()


async def _follow(server: "ViserServer", client: MapClient, *, may_change: bool) -> None:
    loop = asyncio.get_running_loop()
    with contextlib.suppress(NotImplementedError, RuntimeError):  # a thread, or no Unix
        loop.add_signal_handler(signal.SIGTERM, lambda: loop.create_task(client.close()))
    async with client:
        await View(server, client, may_change=may_change, recorder=Recording).run()


def _named(host: str) -> str:
    """As it stands in an address of the web."""
    if host in ("0.0.0.0", "::"):  # noqa: S104 it is compared, not opened
        return "localhost"
    return f"[{host}]" if ":" in host else host
