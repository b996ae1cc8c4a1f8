"""`mapperctl foxglove`: serve viewers until stopped."""

import argparse
import asyncio
import json
import ssl

from mapperd.cli.mapperctl.errors import CtlError, CtlExit, refused
from mapperd.cli.mapperctl.record import stop_requested
from mapperd.client import Interest, MapClient
from mapperd.errors import LiveError
from mapperd.foxglove.recording import foxglove_missing
from mapperd.wire.framing import StreamError

__all__ = ["run_foxglove"]


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
        CtlError: nobody can listen there, or the daemon will not have us.
    """
    try:
        asyncio.run(_serve(args, address, token, tls))
    except ModuleNotFoundError as error:
        raise CtlError(foxglove_missing(error), CtlExit.USAGE) from error
    except LiveError as error:
        raise CtlError(str(error), CtlExit.USAGE) from error
    except StreamError as error:
        raise refused(error) from error
    except ValueError as error:
        raise CtlError(str(error), CtlExit.USAGE) from error


async def _serve(
    args: argparse.Namespace, address: str, token: bytes | None, tls: ssl.SSLContext | None
) -> None:
    from mapperd.foxglove.server import FIRST_WANTS, serve  # noqa: PLC0415 an extra

    def ready(port: int) -> None:
        host = f"[{args.host}]" if ":" in args.host else args.host
        url = f"ws://{host}:{port}"
        text = f"Foxglove and Lichtblick: open a connection to {url}"
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
            serve(client, args.host, args.port, ready, may_change=args.allow_changes)
        )
        stopping = asyncio.create_task(stop_requested())
        await asyncio.wait((serving, stopping), return_when=asyncio.FIRST_COMPLETED)
        ended = serving.done()
        for task in (serving, stopping):
            task.cancel()
        await asyncio.wait((serving, stopping))
        if ended:
            serving.result()
