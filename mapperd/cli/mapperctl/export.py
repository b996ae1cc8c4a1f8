"""`mapperctl export`: the live map becomes a file on this computer."""

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

from mapperd.cli.mapperctl.errors import CtlError, Exit, plain, refused
from mapperd.cli.mapperctl.map_output import MapOutput, check_suffix, make_files, origin_among
from mapperd.client import (
    Box,
    Interest,
    LinkChanged,
    MapChanged,
    MapClient,
    StreamError,
    Want,
)
from mapperd.config.changes import with_values
from mapperd.config.tree import Config
from mapperd.errors import ExportError, MapError
from mapperd.export.calibration import Calibration, load_calibration
from mapperd.export.formats import check_calibration
from mapperd.foxglove.recording import Recording
from mapperd.geometry.geodesy import Origin
from mapperd.mapping.sonar_map import SonarMap

__all__ = ["run_export"]

MCAP = ".mcap"

MAP_ALONE: tuple[Want, ...] = ("map",)
WITH_VEHICLE: tuple[Want, ...] = ("map", "pose", "path", "fan")

TTY_PERIOD_S = 0.1
LOG_PERIOD_S = 5.0
"""Where nobody looks on (a file, a pipe), a line every now and then is enough."""

MIB = 1 << 20


def run_export(
    said: argparse.Namespace,
    config: Config,
    address: str,
    token: bytes | None,
    tls: ssl.SSLContext | None,
) -> Iterator[str]:
    """Wait until all of the map is here, and write it; yields what there is to say.

    Args:
        said: the arguments.
        config: heights and origin; the map's own settings are the daemon's.
        address: of the map stream, as `MapClient` takes it.
        token: that its TCP socket asks for.
        tls: encrypts TCP.

    Raises:
        CtlError: it is not done; no file is made.
        ConfigError: the settings do not allow it.
    """
    try:
        calibration = _checked(said)
        client = MapClient(
            address,
            token=token,
            tls=tls,
            wants=WITH_VEHICLE if said.file.suffix == MCAP else MAP_ALONE,
            interest=Interest(level=said.level, radius_m=said.radius, box=_box(said.box)),
            name="mapperctl export",
        )
        if said.file.suffix == MCAP:
            asyncio.run(_recorded(client, said.file, said.timeout or None))
            made = MapOutput({str(said.file): said.file.stat().st_size})
        else:
            asyncio.run(_followed(client, said.timeout or None))
            made = _made(client, said, config, calibration)
    except ExportError as error:
        raise CtlError(str(error), Exit.CANNOT_WRITE) from error
    except StreamError as error:
        raise refused(error) from error
    except (MapError, ValueError) as error:  # ValueError: no address
        raise CtlError(str(error), Exit.USAGE) from error
    yield from [json.dumps(made.plain())] if said.json else map(plain, made.lines())


def _checked(said: argparse.Namespace) -> Calibration | None:
    """Refuse what cannot be done before the map is waited for; the calibration is read by then."""
    check_suffix(said.file, (MCAP,))
    if said.file.suffix == MCAP and (said.origin or said.min_probability):
        raise ExportError(f"{MCAP} knows neither --origin nor --min-probability")
    calibration = None if said.calibration is None else load_calibration(said.calibration)
    check_calibration(said.file, calibration)
    return calibration


def _box(corners: tuple[float, ...] | None) -> Box | None:
    if corners is None:
        return None
    x, y, z, *high = corners
    return Box((x, y, z), (high[0], high[1], high[2]))


def _made(
    client: MapClient, said: argparse.Namespace, config: Config, calibration: Calibration | None
) -> MapOutput:
    mirror = client.mirror
    if mirror is None:
        raise CtlError("the daemon told no map", Exit.PROTOCOL)
    sonar_map = mirror.to_map(config)
    _choose(sonar_map, said.min_probability)
    origin_deg = mirror.facts.origin_deg
    origin = origin_among(
        None if said.origin is None else Origin.of_degrees(*said.origin),
        None if origin_deg is None else Origin.of_degrees(*origin_deg),
        config,
    )
    return make_files(sonar_map, said.file, origin, calibration)


def _choose(sonar_map: SonarMap, least: float | None) -> None:
    """Have another probability decide what is occupied."""
    if least is not None:
        free = min(sonar_map.config.mapping.free_threshold, least)
        values = {"mapping.occupied_threshold": least, "mapping.free_threshold": free}
        sonar_map.reconfigure(with_values(sonar_map.config, values))


async def _followed(client: MapClient, timeout_s: float | None) -> None:
    """Be connected until the map is complete."""
    async with client:
        await _complete(client, timeout_s)


async def _recorded(client: MapClient, path: Path, timeout_s: float | None) -> None:
    """Record what is told until the map is complete; nothing stays of a file that is not whole."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.unlink(missing_ok=True)  # of somebody who was killed
        async with client:
            recording = Recording(client, partial)
            recording.start()
            try:
                await _complete(client, timeout_s)
            finally:
                await recording.stop()
        partial.replace(path)
    except OSError as error:
        raise ExportError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


async def _complete(client: MapClient, timeout_s: float | None) -> None:
    """Wait until the map is complete, and show how far it is."""
    progress = _Progress(sys.stderr)
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
            f"the map is not complete after {timeout_s:g} s: {progress.told()}", Exit.TRY_AGAIN
        ) from None
    finally:
        for part in parts:
            part.cancel()
        await asyncio.gather(*parts, return_exceptions=True)
        progress.end()


async def _watch(client: MapClient, progress: "_Progress") -> None:
    """Show how far it is; where nobody answers at first, there is nothing to wait for."""
    async for change in client.changes():
        if isinstance(change, LinkChanged):
            link = change.link
            if link.state == "waiting" and not link.connects:
                raise CtlError(f"{link.address}: {link.reason}", Exit.UNAVAILABLE)
            progress.link = "" if link.state == "connected" else f"  {link.state}: {link.reason}"
        elif isinstance(change, MapChanged):
            progress.came += len(change.keys)
            progress.left = change.left
        progress.show(client.link.bytes)


class _Progress:
    """A line that says how far it is, redrawn on a terminal.

    Args:
        out: where to.

    Attributes:
        came: blocks that are here.
        left: that are still to come; None while nobody said.
        link: what is wrong with the connection.
    """

    def __init__(self, out: TextIO) -> None:
        self.came = 0
        self.left: int | None = None
        self.link = ""
        self._out = out
        self._tty = out.isatty()
        self._shown_s = time.monotonic()
        self._bytes = 0

    def told(self) -> str:
        """How far it is."""
        if self.left is None:
            return f"nothing came{self.link}"
        whole = self.came + self.left
        percent = 100 * self.came / whole if whole else 100.0
        size = f"{self._bytes / MIB:.1f} MiB"
        return f"{percent:.0f} %, {self.left} blocks left, {size}{self.link}"

    def show(self, size: int) -> None:
        """Say it, if it is time to; `size` is bytes received."""
        self._bytes = size
        now_s = time.monotonic()
        if now_s - self._shown_s >= (TTY_PERIOD_S if self._tty else LOG_PERIOD_S):
            self._shown_s = now_s
            text = plain(self.told())
            self._write(f"\r{text}\x1b[K" if self._tty else f"mapperctl: {text}\n")

    def end(self) -> None:
        """Leave the line."""
        if self._tty:
            self._write("\r\x1b[K")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # nobody can look on: no reason to stop
            self._out.write(text)
            self._out.flush()
