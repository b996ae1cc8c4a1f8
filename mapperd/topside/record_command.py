"""`mapperctl record`: what the map stream says, into a file, until it is told to stop."""

import argparse
import asyncio
import contextlib
import json
import ssl
import sys
import time
from collections.abc import Iterator
from typing import TextIO

from mapperd.client import Interest, MapClient
from mapperd.ctl.errors import CtlError, Exit, plain
from mapperd.errors import ExportError
from mapperd.stream.framing import StreamError
from mapperd.topside.recording import Recording
from mapperd.topside.refusals import refused
from mapperd.topside.stopping import told_to_stop

__all__ = ["run_record"]

MIB = 1 << 20
TTY_PERIOD_S = 0.5
LOG_PERIOD_S = 10.0
"""Where nobody looks on (a file, a pipe), a line every now and then is enough."""


def run_record(
    said: argparse.Namespace, address: str, token: bytes | None, tls: ssl.SSLContext | None
) -> Iterator[str]:
    """Record; yields what became of it.

    Args:
        said: on the command line.
        address: of the map stream, as `MapClient` takes it.
        token: that its TCP socket asks for.
        tls: encrypts TCP.

    Raises:
        CtlError: it cannot be written, or no daemon would have us.
    """
    if said.file.suffix != ".mcap":
        raise CtlError(f"{said.file}: recordings are .mcap", Exit.USAGE)
    try:
        client = MapClient(
            address,
            token=token,
            tls=tls,
            wants=said.wants,
            interest=Interest(level=said.level, radius_m=said.radius),
            name="mapperctl record",
        )
        began_s = time.monotonic()
        recording = asyncio.run(_record(said, client))
    except ExportError as error:
        raise CtlError(str(error), Exit.CANNOT_WRITE) from error
    except StreamError as error:
        raise refused(error) from error
    except ValueError as error:
        raise CtlError(str(error), Exit.USAGE) from error
    if not client.link.connects:
        said.file.unlink()
        raise CtlError(f"{client.link.address}: no daemon answered", Exit.UNAVAILABLE)
    passed_s = time.monotonic() - began_s
    done = {"path": str(said.file), "bytes": recording.bytes, "messages": recording.messages}
    text = f"{said.file}: {_how_far(recording, passed_s)}"
    yield json.dumps(done | {"seconds": passed_s}) if said.json else plain(text)


async def _record(said: argparse.Namespace, client: MapClient) -> Recording:
    async with client:
        recording = Recording(client, said.file)
        recording.start()
        parts = [
            asyncio.create_task(told_to_stop()),
            asyncio.create_task(recording.wait()),
            asyncio.create_task(_show(recording, client, sys.stderr)),
        ]
        await asyncio.wait(parts, timeout=said.duration, return_when=asyncio.FIRST_COMPLETED)
        for part in parts:
            part.cancel()
        await asyncio.wait(parts)
        await recording.stop()
    return recording


async def _show(recording: Recording, client: MapClient, out: TextIO) -> None:
    """How it goes, on one line of a terminal, or now and then elsewhere."""
    began_s = time.monotonic()
    tty = out.isatty()
    try:
        while True:
            await asyncio.sleep(TTY_PERIOD_S if tty else LOG_PERIOD_S)
            link = client.link
            state = "" if link.state == "connected" else f"  {link.state}: {link.reason}"
            text = plain(_how_far(recording, time.monotonic() - began_s) + state)
            _write(out, f"\r{text}\x1b[K" if tty else f"mapperctl: {text}\n")
    finally:
        if tty:
            _write(out, "\r\x1b[K")


def _write(out: TextIO, text: str) -> None:
    with contextlib.suppress(OSError):  # nobody can look on: no reason to stop
        out.write(text)
        out.flush()


def _how_far(recording: Recording, passed_s: float) -> str:
    minutes, seconds = divmod(int(passed_s), 60)
    size = f"{recording.bytes / MIB:.1f} MiB"
    return f"{minutes}:{seconds:02}  {size}  {recording.messages} messages"
