"""`mapperctl export`: save the live map as a file on this computer."""

import argparse
import asyncio
import contextlib
import json
import ssl
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from mapperd.cli.mapperctl.connection import CtlError, file_error_code, no_daemon, plain, refused
from mapperd.cli.mapperctl.map_output import (
    MapOutput,
    check_suffix,
    make_files,
    missing,
    origin_among,
)
from mapperd.client import (
    Interest,
    LinkChanged,
    MapBox,
    MapChanged,
    MapClient,
    StreamError,
    Want,
)
from mapperd.config.live import occupied_above, with_values
from mapperd.config.tree import Config
from mapperd.errors import ExportError, MapError, os_reason
from mapperd.export.calibration import ProbabilityCalibration, load_calibration
from mapperd.export.formats import check_calibration
from mapperd.foxglove.recording import FoxgloveRecording
from mapperd.geometry.geodesy import Origin
from mapperd.mapping.sonar_map import SonarMap
from oculus_driver.command_line import ExitCode

__all__ = ["run_export"]

MCAP = ".mcap"

MAP_ALONE: tuple[Want, ...] = ("map",)
WITH_VEHICLE: tuple[Want, ...] = ("map", "pose", "path", "fan")

TTY_PERIOD_S = 0.1
LOG_PERIOD_S = 5.0
"""Period of progress lines where the output is not a terminal."""

MIB = 1 << 20


def run_export(
    args: argparse.Namespace,
    config: Config,
    address: str,
    token: bytes | None,
    tls: ssl.SSLContext | None,
) -> Iterator[str]:
    """Wait until the map is complete and write it; yield the lines to print.

    Args:
        args: parsed command line.
        config: heights and origin; the map's own settings are the daemon's.
        address: address of the map stream, as in `MapClient`.
        token: token of the TCP socket.
        tls: TLS context for TCP.

    Raises:
        CtlError: the export failed; no file is left.
        ConfigError: the settings do not allow it.
    """
    try:
        calibration = _checked(args)
        client = MapClient(
            address,
            token=token,
            tls=tls,
            wants=WITH_VEHICLE if args.file.suffix == MCAP else MAP_ALONE,
            interest=Interest(level=args.level, radius_m=args.radius, box=_box(args.box)),
            name="mapperctl export",
        )
        if args.file.suffix == MCAP:
            asyncio.run(_recorded(client, args))
            made = MapOutput({str(args.file): args.file.stat().st_size}, None, _lost(client))
        else:
            asyncio.run(_followed(client, args))
            made = _made(client, args, config, calibration)
    except ExportError as error:
        raise CtlError(str(error), file_error_code(error)) from error
    except StreamError as error:
        raise refused(error) from error
    except (MapError, ValueError) as error:  # ValueError: no address
        raise CtlError(str(error), ExitCode.USAGE) from error
    yield from [json.dumps(made.plain())] if args.json else map(plain, made.lines())


def _checked(args: argparse.Namespace) -> ProbabilityCalibration | None:
    """Check the arguments and read the calibration before waiting for the map."""
    check_suffix(args.file, (MCAP,))
    if args.file.suffix == MCAP and (args.origin or args.min_probability):
        raise ExportError(f"{MCAP} knows neither --origin nor --min-probability")
    calibration = None if args.calibration is None else load_calibration(args.calibration)
    check_calibration(args.file, calibration)
    return calibration


def _box(corners: tuple[float, ...] | None) -> MapBox | None:
    if corners is None:
        return None
    x, y, z, *high = corners
    return MapBox((x, y, z), (high[0], high[1], high[2]))


def _made(
    client: MapClient,
    args: argparse.Namespace,
    config: Config,
    calibration: ProbabilityCalibration | None,
) -> MapOutput:
    mirror = client.mirror
    if mirror is None:
        raise CtlError("the daemon sent no map", ExitCode.PROTOCOL)
    sonar_map = mirror.to_map(config)
    _choose(sonar_map, args.min_probability)
    origin_deg = mirror.info.origin_deg
    origin = origin_among(
        None if args.origin is None else Origin.of_degrees(*args.origin),
        None if origin_deg is None else Origin.of_degrees(*origin_deg),
        config,
    )
    return make_files(sonar_map, args.file, origin, calibration, bricks_lost=_lost(client))


def _lost(client: MapClient) -> int:
    """Return the number of damaged bricks that are missing in the daemon's map."""
    return 0 if client.mirror is None else client.mirror.info.bricks_lost


def _choose(sonar_map: SonarMap, min_probability: float | None) -> None:
    """Change the probability threshold of occupied voxels."""
    if min_probability is not None:
        values = occupied_above(sonar_map.config, min_probability)
        sonar_map.reconfigure(with_values(sonar_map.config, values))


async def _followed(client: MapClient, args: argparse.Namespace) -> None:
    """Stay connected until the map is complete."""
    async with client:
        await _complete(client, args)


async def _recorded(client: MapClient, args: argparse.Namespace) -> None:
    """Record until the map is complete; an incomplete file is removed."""
    path = Path(args.file)
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.unlink(missing_ok=True)  # of a killed process
        async with client:
            recording = FoxgloveRecording(client, partial)
            recording.start()
            try:
                await _complete(client, args)
            finally:
                await recording.stop()
        partial.replace(path)
    except OSError as error:
        raise ExportError(f"{path}: cannot be written: {os_reason(error)}") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


async def _complete(client: MapClient, args: argparse.Namespace) -> None:
    """Wait until the map is complete and show the progress; refuse a damaged map."""
    timeout_s = args.timeout or None
    progress = _ExportProgress(sys.stderr)
    parts = [
        asyncio.create_task(client.complete(timeout_s)),
        asyncio.create_task(_watch(client, progress)),
    ]
    try:
        done, _ = await asyncio.wait(parts, return_when=asyncio.FIRST_COMPLETED)
        for part in done:
            part.result()
    except TimeoutError:
        raise CtlError(
            f"the map is not complete after {timeout_s:g} s: {progress.text()}", ExitCode.TRY_AGAIN
        ) from None
    finally:
        for part in parts:
            part.cancel()
        await asyncio.gather(*parts, return_exceptions=True)
        progress.end()
    if (lost := _lost(client)) and not args.allow_damaged:
        text = f"{missing(lost)}; nothing was written. --allow-damaged writes the rest"
        raise CtlError(text, ExitCode.FAULT)


async def _watch(client: MapClient, progress: "_ExportProgress") -> None:
    """Show the progress; fail if no daemon answers the first attempt."""
    async for change in client.changes():
        if isinstance(change, LinkChanged):
            link = change.link
            if link.state == "waiting" and not link.connects:
                raise no_daemon(link.address, link.reason)
            progress.link = "" if link.state == "connected" else f"  {link.state}: {link.reason}"
        elif isinstance(change, MapChanged):
            progress.received += len(change.keys)
            progress.left = change.left
        progress.show(client.link.bytes)


class _ExportProgress:
    """A progress line, redrawn on a terminal.

    Args:
        out: output stream.

    Attributes:
        received: blocks received.
        left: blocks still to come; None if unknown.
        link: problem of the connection.
    """

    def __init__(self, out: TextIO) -> None:
        self.received = 0
        self.left: int | None = None
        self.link = ""
        self._out = out
        self._tty = out.isatty()
        self._shown_s = time.monotonic()
        self._bytes = 0

    def text(self) -> str:
        """The line."""
        if self.left is None:
            return f"nothing received{self.link}"
        whole = self.received + self.left
        percent = 100 * self.received / whole if whole else 100.0
        size = f"{self._bytes / MIB:.1f} MiB"
        return f"{percent:.0f} %, {self.left} blocks left, {size}{self.link}"

    def show(self, size: int) -> None:
        """Show the line if it is due; `size` is bytes received."""
        self._bytes = size
        now_s = time.monotonic()
        if now_s - self._shown_s >= (TTY_PERIOD_S if self._tty else LOG_PERIOD_S):
            self._shown_s = now_s
            text = plain(self.text())
            self._write(f"\r{text}\x1b[K" if self._tty else f"mapperctl: {text}\n")

    def end(self) -> None:
        """Clear the line."""
        if self._tty:
            self._write("\r\x1b[K")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # output closed: not a reason to stop
            self._out.write(text)
            self._out.flush()
