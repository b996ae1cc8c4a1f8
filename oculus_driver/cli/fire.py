"""`oculus fire`: take one ping with given settings and compare it with them."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import (
    add_settings_arguments,
    add_sonar_arguments,
    open_sonar,
    positive,
    settings_of,
)
from oculus_driver.command_line import ExitCode
from oculus_driver.errors import ExtraMissingError, LinkError, missing_extra
from oculus_driver.link.confirmation import differences
from oculus_driver.link.state import LinkState
from oculus_driver.ping import caption_lines

if TYPE_CHECKING:
    import argparse

    from oculus_driver.cli.output import Output
    from oculus_driver.link.confirmation import Confirmation, Difference
    from oculus_driver.ping import Ping
    from oculus_driver.settings import FireSettings

NAME = "fire"
HELP = "take one ping with given settings and compare it with them: only under water"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_sonar_arguments(parser)
    add = parser.add_argument
    add(
        "--trigger",
        action="store_true",
        help="use the network trigger, which corrupts the stream of some sonars",
    )
    add("--picture", metavar="PNG", type=Path, help="save an image of the ping")
    add("--patience", metavar="S", type=positive, default=8.0, help="timeout (default: 8)")
    add("--keep-pinging", action="store_true", help="do not put the sonar into standby at the end")
    add_settings_arguments(parser, rate="lowest")


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Take a ping, report, and leave the sonar in standby."""
    settings = settings_of(args, triggered=args.trigger)
    ping, confirmation = asyncio.run(_take_ping(args, settings))
    if args.picture is not None:
        _draw(args.picture, ping)
    changed = [asdict(difference) for difference in confirmation.changed]
    fields = {
        "ping_id": ping.ping_id,
        "rows": ping.rows,
        "beams": ping.beams,
        "bits_per_sample": ping.bits_per_sample,
        "range_m": ping.max_range_m,
        "frequency_hz": ping.frequency_hz,
        "speed_of_sound_mps": ping.speed_of_sound_mps,
        "gain_percent": ping.gain_percent,
        "version": ping.version,
        "warnings": ping.warnings,
        "confirmed": confirmation.confirmed,
        "reason": confirmation.reason,
        "changed": changed,
        "picture": args.picture,
    }
    verdict = "confirmed" if confirmation.confirmed else f"not confirmed: {confirmation.reason}"
    lines = [*caption_lines(ping)[:2], f"settings {verdict}", *map(str, confirmation.changed)]
    output.report(fields, "\n".join(lines))
    return ExitCode.OK if confirmation.confirmed else ExitCode.FAULT


async def _take_ping(args: argparse.Namespace, settings: FireSettings) -> tuple[Ping, Confirmation]:
    async with open_sonar(args, settings.in_standby(), keep_pinging=args.keep_pinging) as sonar:
        try:
            async with asyncio.timeout(args.patience):
                await sonar.wait_for(LinkState.STANDBY, LinkState.PINGING)
        except TimeoutError:
            link = sonar.link
            raise LinkError(
                f"{link.state} for {args.patience:g} s: {link.reason}; run `oculus doctor`"
            ) from None
        confirmation = await sonar.apply(settings, args.patience)
        if args.trigger:
            ping = await sonar.fire(args.patience)
            return ping, _judged(confirmation, differences(settings, ping))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(args.patience):
                async for ping in sonar.pings():
                    return ping, confirmation
    raise LinkError(f"no ping within {args.patience:g} s; run `oculus doctor`")


def _judged(asked: Confirmation, changed: tuple[Difference, ...]) -> Confirmation:
    """Return the confirmation of a triggered ping: no earlier ping could confirm the settings."""
    decisive = ", ".join(str(one) for one in changed if one.decisive)
    reason = decisive or "the triggered ping shows the settings"
    return replace(asked, confirmed=not decisive, reason=reason, pings=1, changed=changed)


def _draw(path: Path, ping: Ping) -> None:
    try:
        from oculus_driver.render import Painter  # noqa: PLC0415 - an extra
        from oculus_driver.render.files import write_png  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ExtraMissingError(f"images: {missing_extra('OpenCV', 'render')}") from error
    write_png(path, Painter().paint(ping))
