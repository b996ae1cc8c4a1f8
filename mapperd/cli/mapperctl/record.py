"""`mapperctl record`: write the map stream to a file until stopped."""

import argparse
import asyncio
import contextlib
import json
import signal
import ssl
import sys
import time
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, TextIO

from mapperd.cli.mapperctl.connection import CtlError, file_error_code, no_daemon, plain, refused
from mapperd.cli.mapperctl.map_output import check_suffix, make_files, origin_among
from mapperd.client import Interest, MapClient, Want
from mapperd.config.tree import Config
from mapperd.errors import ExportError, MapError
from mapperd.foxglove.recording import FoxgloveRecording
from mapperd.geometry.geodesy import Origin
from mapperd.wire.framing import StreamError
from oculus_driver.command_line import ExitCode

__all__ = ["run_record", "stop_requested"]


async def stop_requested() -> None:
    """Wait for SIGINT or SIGTERM; they have no other effect meanwhile."""
    loop = asyncio.get_running_loop()
    stopped = asyncio.Event()
    handled = []
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            try:
                loop.add_signal_handler(number, stopped.set)
            except (NotImplementedError, RuntimeError, ValueError):  # a thread, or no Unix
                continue
            handled.append(number)
        await stopped.wait()
    finally:
        for number in handled:
            loop.remove_signal_handler(number)


MIB = 1 << 20
TTY_PERIOD_S = 0.5
LOG_PERIOD_S = 10.0
"""Period of progress lines where the output is not a terminal."""

MCAP = ".mcap"
MAP_ALONE: tuple[Want, ...] = ("map",)


def run_record(
    args: argparse.Namespace,
    config: Config,
    address: str,
    token: bytes | None,
    tls: ssl.SSLContext | None,
) -> Iterator[str]:
    """Record the stream; yield the lines to print.

    Args:
        args: parsed command line.
        config: heights and origin of a map file; its other settings are the daemon's.
        address: address of the map stream, as in `MapClient`.
        token: token of the TCP socket.
        tls: TLS context for TCP.

    Raises:
        CtlError: the file cannot be written, or no daemon accepts the client.
    """
    try:
        check_suffix(args.file, (MCAP,))
        client = MapClient(
            address,
            token=token,
            tls=tls,
            wants=args.wants if args.file.suffix == MCAP else MAP_ALONE,
            interest=Interest(level=args.level, radius_m=args.radius),
            name="mapperctl record",
        )
        record = _all if args.file.suffix == MCAP else _map
        yield from record(args, config, client)
    except ExportError as error:
        raise CtlError(str(error), file_error_code(error)) from error
    except StreamError as error:
        raise refused(error) from error
    except (MapError, ValueError) as error:  # ValueError: no address
        raise CtlError(str(error), ExitCode.USAGE) from error


def _all(args: argparse.Namespace, _: Config, client: MapClient) -> Iterator[str]:
    """Record everything."""
    began_s = time.monotonic()
    recording = FoxgloveRecording(client, args.file)
    try:
        asyncio.run(_record(args, client, recording))
        if not client.link.connects:
            raise _nobody(client)
    except (CtlError, StreamError):
        if not client.link.connects:  # the file is empty
            args.file.unlink()
        raise
    passed_s = time.monotonic() - began_s
    done = {"path": str(args.file), "bytes": recording.bytes, "messages": recording.messages}
    text = f"{args.file}: {_time(passed_s)}  {_how_much(recording)}"
    yield json.dumps(done | {"seconds": passed_s}) if args.json else plain(text)


def _map(args: argparse.Namespace, config: Config, client: MapClient) -> Iterator[str]:
    """Save the map at the end."""
    asyncio.run(_follow(args, client))
    mirror = client.mirror
    if mirror is None:
        raise _nobody(client)
    origin_deg = mirror.info.origin_deg
    own = None if origin_deg is None else Origin.of_degrees(*origin_deg)
    made = make_files(mirror.to_map(config), args.file, origin_among(None, own, config))
    yield from [json.dumps(made.plain())] if args.json else map(plain, made.lines())


def _nobody(client: MapClient) -> CtlError:
    return no_daemon(client.link.address, client.link.reason or "no answer")


async def _record(
    args: argparse.Namespace, client: MapClient, recording: FoxgloveRecording
) -> None:
    async with client:
        recording.start()
        try:
            await _until_stopped(args, client, recording.wait(), lambda: _how_much(recording))
        finally:
            await recording.stop()


async def _follow(args: argparse.Namespace, client: MapClient) -> None:
    async with client:
        await _until_stopped(
            args, client, _ended(client), lambda: f"{len(client.mirror or ())} blocks"
        )


async def _until_stopped(
    args: argparse.Namespace,
    client: MapClient,
    ended: Coroutine[Any, Any, None],
    how_much: Callable[[], str],
) -> None:
    """Wait for a signal, the end of the duration, or `ended`, whose error is raised."""
    parts = [
        asyncio.create_task(ended),
        asyncio.create_task(stop_requested()),
        asyncio.create_task(_show(client, how_much, sys.stderr)),
    ]
    done, _ = await asyncio.wait(parts, timeout=args.duration, return_when=asyncio.FIRST_COMPLETED)
    for part in parts:
        part.cancel()
    await asyncio.wait(parts)
    for part in done:
        part.result()


async def _ended(client: MapClient) -> None:
    async for _ in client.changes():
        pass


async def _show(client: MapClient, how_much: Callable[[], str], out: TextIO) -> None:
    """Show the progress, on one line of a terminal or as lines now and then."""
    began_s = time.monotonic()
    tty = out.isatty()
    try:
        while True:
            await asyncio.sleep(TTY_PERIOD_S if tty else LOG_PERIOD_S)
            link = client.link
            state = "" if link.state == "connected" else f"  {link.state}: {link.reason}"
            text = plain(f"{_time(time.monotonic() - began_s)}  {how_much()}{state}")
            _write(out, f"\r{text}\x1b[K" if tty else f"mapperctl: {text}\n")
    finally:
        if tty:
            _write(out, "\r\x1b[K")


def _write(out: TextIO, text: str) -> None:
    with contextlib.suppress(OSError):  # output closed: not a reason to stop
        out.write(text)
        out.flush()


def _time(passed_s: float) -> str:
    minutes, seconds = divmod(int(passed_s), 60)
    return f"{minutes}:{seconds:02}"


def _how_much(recording: FoxgloveRecording) -> str:
    return f"{recording.bytes / MIB:.1f} MiB  {recording.messages} messages"
