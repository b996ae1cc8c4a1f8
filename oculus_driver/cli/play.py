"""`oculus play`: a recording served as a sonar."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from ipaddress import IPv4Address
from pathlib import Path
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import address, count, port, positive, share
from oculus_driver.cli.output import Exit, Output, run_until_stopped
from oculus_driver.virtual_sonar.device import Identity
from oculus_driver.virtual_sonar.faults import SHARES, Faults
from oculus_driver.virtual_sonar.playback import PlaybackSonar
from oculus_driver.virtual_sonar.server import broadcast_of
from oculus_driver.wire import STATUS_PORT, TCP_PORT

if TYPE_CHECKING:
    import argparse

NAME = "play"
HELP = "serve a recording as a sonar: status broadcasts, pings, fire messages obeyed"

_FAULT_HELP = {
    "cut": "pings that end in the middle, with the connection",
    "flip": "pings with one to eight flipped bits",
    "stall": "pings before which nothing comes for a while",
    "lose": "pings that are never sent",
    "garbage": "pings with noise in front",
    "restart": "pings before which the sonar restarts",
    "restart_ids": "pings before which ids and device time begin anew",
    "reorder_statuses": "statuses sent after the next one",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help="a recording of any kind")
    add("--listen", metavar="ADDRESS", type=address, default="127.0.0.1")
    add("--port", type=port, default=TCP_PORT, help="TCP port (default: %(default)s)")
    add("--address", type=address, help="the sonar's address as statuses tell it")
    add("--status-to", metavar="ADDRESS", type=address, help="instead of a broadcast")
    add("--status-port", type=port, default=STATUS_PORT, help="UDP port (default: %(default)s)")
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument("--speed", metavar="FACTOR", type=positive, default=1.0, help="of time")
    pace.add_argument("--unthrottled", action="store_true", help="as fast as the client takes it")
    ends = parser.add_mutually_exclusive_group()
    ends.add_argument("--loop", action="store_true", help="begin again for ever")
    ends.add_argument("--loops", metavar="N", type=count, default=1, help="play it N times")
    add("--duration", metavar="S", type=positive, help="stop after S seconds")
    add("--stay", action="store_true", help="go on with signs of life when all is played")
    add("--standby", action="store_true", help="be silent until a client asks for pings")
    add("--remade", action="store_true", help="make pings with the settings asked for")
    add("--serial", metavar="ID", type=count, help="serial number (default: from the recording)")
    add("--part", metavar="NUMBER", type=count, help="part number (default: from the recording)")
    faults = parser.add_argument_group("misbehaviour; SHARE is 0 to 1 of all pings")
    for name in SHARES:
        option = "--" + name.replace("_", "-")
        faults.add_argument(
            option, metavar="SHARE", type=share, default=0.0, help=_FAULT_HELP[name]
        )
    faults.add_argument("--stall-s", metavar="S", type=positive, default=2.0)
    faults.add_argument("--refuse-second", action="store_true", help="close a second client")
    faults.add_argument(
        "--silent-after", metavar="S", type=positive, help="needs a fire message this often"
    )
    faults.add_argument("--deaf-to-version", type=int, choices=(1, 2), help="of fire messages")
    faults.add_argument("--dice", metavar="N", type=int, default=0, help="another N, other faults")


def run(args: argparse.Namespace, output: Output) -> Exit:
    """Play until everything was played or somebody stops it."""
    run_until_stopped(_play(args, output), args.duration)
    return Exit.OK


async def _play(args: argparse.Namespace, output: Output) -> None:
    target = args.status_to or broadcast_of(args.listen)
    sonar = PlaybackSonar(
        args.file,
        host=args.listen,
        port=args.port,
        speed=None if args.unthrottled else args.speed,
        loops=None if args.loop else args.loops,
        status_to=[(target, args.status_port)],
        identity=Identity(args.serial, args.part, IPv4Address(_told_address(args))),
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
                f"a sonar at {sonar.host}:{sonar.port}, statuses to {target}:{args.status_port}",
            )
            await sonar.finished.wait()
            if args.stay:
                await asyncio.Event().wait()
    finally:
        counters = asdict(sonar.counters)
        words = ", ".join(f"{name} {value}" for name, value in counters.items() if value)
        output.report({"event": "played", **counters}, f"played: {words or 'nothing'}")


def _told_address(args: argparse.Namespace) -> str:
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
        number=args.dice,
    )
