"""`oculus play`: serve a recording as a sonar."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from ipaddress import IPv4Address
from pathlib import Path
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import address, count, port, positive, share
from oculus_driver.cli.output import Output, run_until_stopped
from oculus_driver.command_line import ExitCode
from oculus_driver.virtual_sonar.device import Identity
from oculus_driver.virtual_sonar.faults import SHARES, Faults
from oculus_driver.virtual_sonar.playback import PlaybackSonar
from oculus_driver.virtual_sonar.server import broadcast_of
from oculus_driver.wire import STATUS_PORT, TCP_PORT

if TYPE_CHECKING:
    import argparse

NAME = "play"
HELP = "serve a recording as a sonar: status broadcasts, pings, fire messages"

_FAULT_HELP = {
    "cut": "pings cut in the middle; the connection ends, too",
    "flip": "pings with one to eight flipped bits",
    "stall": "pings preceded by a pause",
    "lose": "pings that are not sent",
    "garbage": "pings preceded by noise",
    "restart": "pings preceded by a restart of the sonar",
    "restart_ids": "pings at which ids and device time start again",
    "reorder_statuses": "statuses sent after the next one",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help="recording of any format")
    add(
        "--listen",
        metavar="ADDRESS",
        type=address,
        default="127.0.0.1",
        help="local address (default: %(default)s)",
    )
    add("--port", type=port, default=TCP_PORT, help="TCP port (default: %(default)s)")
    add("--address", type=address, help="the sonar's address in its statuses")
    add(
        "--status-to",
        metavar="ADDRESS",
        type=address,
        help="destination of statuses (default: broadcast)",
    )
    add("--status-port", type=port, default=STATUS_PORT, help="UDP port (default: %(default)s)")
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        "--speed", metavar="FACTOR", type=positive, default=1.0, help="factor on the recorded time"
    )
    pace.add_argument("--unthrottled", action="store_true", help="as fast as the client reads")
    ends = parser.add_mutually_exclusive_group()
    ends.add_argument("--loop", action="store_true", help="repeat endlessly")
    ends.add_argument(
        "--loops", metavar="N", type=count, default=1, help="play N times (default: 1)"
    )
    add("--duration", metavar="S", type=positive, help="stop after S seconds")
    add("--stay", action="store_true", help="continue with dummy messages at the end")
    add("--standby", action="store_true", help="start in standby")
    add("--remade", action="store_true", help="convert pings to the requested settings")
    add("--serial", metavar="ID", type=count, help="serial number (default: from the recording)")
    add("--part", metavar="NUMBER", type=count, help="part number (default: from the recording)")
    faults = parser.add_argument_group("faults; SHARE is 0 to 1 of all pings")
    for name in SHARES:
        option = "--" + name.replace("_", "-")
        faults.add_argument(
            option, metavar="SHARE", type=share, default=0.0, help=_FAULT_HELP[name]
        )
    faults.add_argument(
        "--stall-s",
        metavar="S",
        type=positive,
        default=2.0,
        help="duration of a stall (default: 2)",
    )
    faults.add_argument("--refuse-second", action="store_true", help="reject a second client")
    faults.add_argument(
        "--silent-after",
        metavar="S",
        type=positive,
        help="timeout of a client without fire messages",
    )
    faults.add_argument(
        "--deaf-to-version", type=int, choices=(1, 2), help="ignore this version of fire messages"
    )
    faults.add_argument(
        "--dice", metavar="N", type=int, default=0, help="seed of the faults (default: 0)"
    )


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Play to the end or until stopped."""
    run_until_stopped(_play(args, output), args.duration)
    return ExitCode.OK


async def _play(args: argparse.Namespace, output: Output) -> None:
    target = args.status_to or broadcast_of(args.listen)
    sonar = PlaybackSonar(
        args.file,
        host=args.listen,
        port=args.port,
        speed=None if args.unthrottled else args.speed,
        loops=None if args.loop else args.loops,
        status_to=[(target, args.status_port)],
        identity=Identity(args.serial, args.part, IPv4Address(_advertised_address(args))),
        resampled=args.remade,
        standby=args.standby,
        faults=_faults(args),
    )
    try:
        async with sonar:
            fields = {"event": "listening", "address": sonar.host, "port": sonar.port}
            fields |= {"status_to": target, "status_port": args.status_port}
            output.report(
                fields,
                f"sonar at {sonar.host}:{sonar.port}, statuses to {target}:{args.status_port}",
            )
            await sonar.finished.wait()
            if args.stay:
                await asyncio.Event().wait()
    finally:
        counters = asdict(sonar.counters)
        words = ", ".join(f"{name} {value}" for name, value in counters.items() if value)
        output.report({"event": "played", **counters}, f"played: {words or 'nothing'}")


def _advertised_address(args: argparse.Namespace) -> str:
    if args.address is not None:
        return str(args.address)
    return "127.0.0.1" if IPv4Address(args.listen).is_unspecified else str(args.listen)


def _faults(args: argparse.Namespace) -> Faults:
    return Faults(
        **{name: getattr(args, name) for name in SHARES},
        stall_s=args.stall_s,
        refuse_second=args.refuse_second,
        silent_after_s=args.silent_after,
        ignored_fire_version=args.deaf_to_version,
        seed=args.dice,
    )
