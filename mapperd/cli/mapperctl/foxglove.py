"""`mapperctl foxglove`: serve viewers until stopped."""

import argparse
import asyncio
import json
import ssl
import sys

from mapperd.cli.mapperctl.connection import CtlError, refused
from mapperd.cli.mapperctl.record import stop_requested
from mapperd.client import Interest, MapClient
from mapperd.errors import ConfigError, LiveError
from mapperd.foxglove.proxy import ORIGINS, ViewerAccess
from mapperd.foxglove.recording import foxglove_missing
from mapperd.wire.auth import is_loopback, read_token
from mapperd.wire.framing import StreamError
from oculus_driver.command_line import ExitCode

__all__ = ["run_foxglove"]

MAX_REPORTS = 100
"""Refused viewers that are reported; a page may try again and again."""


def run_foxglove(
    args: argparse.Namespace, address: str, token: bytes | None, tls: ssl.SSLContext | None
) -> None:
    """Serve viewers; print the address.

    Args:
        args: parsed command line.
        address: address of the map stream, as in `MapClient`.
        token: token of the TCP socket.
        tls: TLS context for TCP.

    Raises:
        CtlError: nobody can listen there, a token is needed, or the daemon refuses the client.
    """
    try:
        asyncio.run(_serve(args, address, token, tls))
    except ModuleNotFoundError as error:
        raise CtlError(foxglove_missing(error), ExitCode.BAD_CONFIG) from error
    except (LiveError, ConfigError) as error:
        raise CtlError(str(error), ExitCode.USAGE) from error
    except StreamError as error:
        raise refused(error) from error
    except ValueError as error:
        raise CtlError(str(error), ExitCode.USAGE) from error


def _access(args: argparse.Namespace) -> ViewerAccess:
    """Return who may watch; other computers need a token, as those of the daemon do."""
    if args.viewer_token_file is None and not is_loopback(args.host):
        raise CtlError(
            f"--host {args.host}: other computers need a token: --viewer-token-file FILE",
            ExitCode.USAGE,
        )
    token = None if args.viewer_token_file is None else read_token(args.viewer_token_file, "")
    reported: set[str] = set()

    def report(text: str) -> None:
        if text not in reported and len(reported) < MAX_REPORTS:
            reported.add(text)
            print(f"mapperctl: {text}", file=sys.stderr, flush=True)  # noqa: T201 a command

    return ViewerAccess((*ORIGINS, *args.allow_origin), token, report)


async def _serve(
    args: argparse.Namespace, address: str, token: bytes | None, tls: ssl.SSLContext | None
) -> None:
    from mapperd.foxglove.server import FIRST_WANTS, serve  # noqa: PLC0415 an extra

    access = _access(args)

    def ready(port: int) -> None:
        host = f"[{args.host}]" if ":" in args.host else args.host
        url = f"ws://{host}:{port}"
        shown = url if access.token is None else f"{url}/?token=TOKEN"
        text = f"Foxglove and Lichtblick: open a connection to {shown}"
        print(json.dumps({"url": url}) if args.json else text, flush=True)  # noqa: T201 a command

    client = MapClient(
        address,
        token=token,
        tls=tls,
        wants=FIRST_WANTS,
        interest=Interest(level=args.level, radius_m=args.radius),
        name="mapperctl foxglove",
    )
    async with client:
        serving = asyncio.create_task(
            serve(client, args.host, args.port, ready, access=access, may_change=args.allow_changes)
        )
        stopping = asyncio.create_task(stop_requested())
        await asyncio.wait((serving, stopping), return_when=asyncio.FIRST_COMPLETED)
        ended = serving.done()
        for task in (serving, stopping):
            task.cancel()
        await asyncio.wait((serving, stopping))
        if ended:
            serving.result()
