"""`mapperctl foxglove`, `ros2`, `mavlink` and `changes`: serve others until stopped."""

import argparse
import asyncio
import json
import ssl
import sys
from collections.abc import Callable, Coroutine, Mapping
from contextlib import closing
from types import MappingProxyType
from typing import Any

import msgspec

from mapperd.cli.mapperctl.connection import CtlError, file_error_code, plain, refused
from mapperd.cli.mapperctl.record import stop_requested
from mapperd.client import Interest, MapClient
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, LiveError, MapError, StoreError, missing_extra
from mapperd.foxglove.proxy import ORIGINS, ViewerAccess
from mapperd.wire.auth import is_loopback, read_token
from mapperd.wire.framing import StreamError
from oculus_driver.command_line import ExitCode

__all__ = ["run_bridge"]

EXTRAS = {
    "foxglove": ("foxglove", "foxglove-sdk", "foxglove"),
    "mavlink": ("pymavlink", "pymavlink", "mavlink"),
    "ros2": ("cyclonedds", "cyclonedds", "ros2"),
}
"""Module, library and extra of each bridge."""

MAX_REPORTS = 100
"""Refused viewers that are reported; a page may try again and again."""


def run_bridge(
    args: argparse.Namespace,
    config: Config,
    address: str,
    token: bytes | None,
    tls: ssl.SSLContext | None,
) -> None:
    """Serve another program until stopped.

    Args:
        args: parsed command line.
        config: settings of this computer.
        address: address of the map stream, as in `MapClient`.
        token: token of the TCP socket.
        tls: TLS context for TCP.

    Raises:
        CtlError: nobody can listen there, a setting, a token or an extra is missing, or the daemon
            refuses the client.
    """
    bridge = _BRIDGES[args.command]
    try:
        asyncio.run(bridge(args, config, address, token, tls))
    except ModuleNotFoundError as error:
        raise CtlError(_missing(args.command, error), ExitCode.BAD_CONFIG) from error
    except ConfigError as error:
        raise CtlError(str(error), ExitCode.BAD_CONFIG) from error
    except (MapError, StoreError) as error:
        raise CtlError(str(error), file_error_code(error)) from error
    except LiveError as error:
        raise CtlError(str(error), ExitCode.USAGE) from error
    except StreamError as error:
        raise refused(error) from error
    except ValueError as error:
        raise CtlError(str(error), ExitCode.USAGE) from error


def _missing(command: str, error: ModuleNotFoundError) -> str:
    """Return what to install; another missing module is a defect of ours."""
    module, library, extra = EXTRAS.get(command, ("", "", ""))
    if not module or (error.name or "").partition(".")[0] != module:
        raise error
    return missing_extra(library, extra)


def _access(args: argparse.Namespace) -> ViewerAccess:
    """Return who may watch; other computers need a token, as those of the daemon do."""
    if args.viewer_token_file is None and not is_loopback(args.host):
        raise CtlError(
            f"--host {args.host}: other computers need a token: --viewer-token-file FILE",
            ExitCode.USAGE,
        )
    try:
        token = None if args.viewer_token_file is None else read_token(args.viewer_token_file, "")
    except ConfigError as error:
        raise CtlError(str(error), ExitCode.USAGE) from error
    reported: set[str] = set()

    def report(text: str) -> None:
        if text not in reported and len(reported) < MAX_REPORTS:
            reported.add(text)
            print(f"mapperctl: {text}", file=sys.stderr, flush=True)  # noqa: T201 a command

    return ViewerAccess((*ORIGINS, *args.allow_origin), token, report)


async def _foxglove(
    args: argparse.Namespace,
    _: Config,
    address: str,
    token: bytes | None,
    tls: ssl.SSLContext | None,
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
    await _until_stopped(
        client,
        serve(client, args.host, args.port, ready, access=access, may_change=args.allow_changes),
    )


async def _until_stopped(client: MapClient, work: Coroutine[Any, Any, None]) -> None:
    """Connect the client and work until a signal, or until the work ends."""
    async with client:
        serving = asyncio.create_task(work)
        stopping = asyncio.create_task(stop_requested())
        await asyncio.wait((serving, stopping), return_when=asyncio.FIRST_COMPLETED)
        ended = serving.done()
        for task in (serving, stopping):
            task.cancel()
        await asyncio.wait((serving, stopping))
        if ended:
            serving.result()


MARGIN_M = 5.0
"""The map is followed this far beyond the range of obstacles: it moves with the vehicle."""


async def _mavlink(
    args: argparse.Namespace,
    config: Config,
    address: str,
    token: bytes | None,
    tls: ssl.SSLContext | None,
) -> None:
    from mapperd.bridges.mavlink import WANTS, serve  # noqa: PLC0415 an extra

    settings = config.mavlink
    if args.to is not None:
        settings = msgspec.structs.replace(settings, address=args.to)
    client = MapClient(
        address,
        token=token,
        tls=tls,
        wants=WANTS,
        interest=Interest(radius_m=settings.obstacle_range + MARGIN_M),
        name="mapperctl mavlink",
    )
    await _until_stopped(client, serve(client, settings, _reporter(json_lines=args.json)))


async def _ros2(
    args: argparse.Namespace,
    config: Config,
    address: str,
    token: bytes | None,
    tls: ssl.SSLContext | None,
) -> None:
    from mapperd.bridges.ros2 import WANTS, serve  # noqa: PLC0415 an extra

    given = {"domain": args.domain, "namespace": args.namespace}
    changes = {name: value for name, value in given.items() if value is not None}
    settings = msgspec.structs.replace(config.ros2, **changes)
    client = MapClient(
        address,
        token=token,
        tls=tls,
        wants=WANTS,
        interest=Interest(level=args.level, radius_m=args.radius),
        name="mapperctl ros2",
    )
    config = msgspec.structs.replace(config, ros2=settings)
    await _until_stopped(client, serve(client, config, _reporter(json_lines=args.json)))


async def _changes(
    args: argparse.Namespace,
    config: Config,
    address: str,
    token: bytes | None,
    tls: ssl.SSLContext | None,
) -> None:
    from mapperd.bridges.changes import WANTS, in_memory, serve  # noqa: PLC0415 needs the core
    from mapperd.store.map_files import map_in  # noqa: PLC0415 as above

    found = map_in(args.known, config, allow_damaged=args.allow_damaged)
    with closing(found.map):
        known = in_memory(found.map)
    client = MapClient(
        address,
        token=token,
        tls=tls,
        wants=WANTS,
        interest=Interest(radius_m=args.radius),
        name="mapperctl changes",
    )
    report = _reporter(json_lines=args.json)
    work = serve(client, known, args.known.name[-100:], config.changes, report)
    await _until_stopped(client, work)


def _reporter(*, json_lines: bool) -> Callable[[str], None]:
    """Return what prints the lines of a bridge."""

    def report(text: str) -> None:
        print(  # noqa: T201 a command
            json.dumps({"text": text}) if json_lines else plain(text), flush=True
        )

    return report


Bridge = Callable[
    [argparse.Namespace, Config, str, bytes | None, ssl.SSLContext | None],
    Coroutine[Any, Any, None],
]

_BRIDGES: Mapping[str, Bridge] = MappingProxyType(
    {"changes": _changes, "foxglove": _foxglove, "mavlink": _mavlink, "ros2": _ros2}
)
