"""Arguments of `mapperctl foxglove` and `mapperctl record`."""

import argparse
import math
from pathlib import Path

from mapperd.wire.messages import MAX_LEVEL, WANTS

__all__ = ["add_foxglove", "add_record"]

MOST_S = 1e9
MOST_M = 1e6


def add_foxglove(command: argparse.ArgumentParser) -> None:
    """Of `foxglove`."""
    add = command.add_argument
    add("--port", metavar="N", type=_port, default=8765, help="default: 8765")
    add(
        "--host",
        metavar="NAME",
        default="127.0.0.1",
        help="address to listen on; default: 127.0.0.1, for this computer alone",
    )
    add(
        "--allow-changes",
        action="store_true",
        help="viewers may change settings; so may any page in a browser that reaches the port",
    )
    _add_interest(command)


def add_record(command: argparse.ArgumentParser) -> None:
    """Of `record`."""
    add = command.add_argument
    add(
        "file",
        metavar="FILE",
        type=Path,
        help=".mcap: all that happens; another suffix: the map as it is at the end",
    )
    add("--duration", metavar="S", type=_seconds, help="default: until interrupted")
    add(
        "--wants",
        metavar="KIND,...",
        type=_wants,
        default=WANTS,
        help=f"some of {', '.join(WANTS)}; default: all",
    )
    _add_interest(command)


def _add_interest(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add(
        "--level",
        metavar="N",
        type=int,
        choices=range(MAX_LEVEL + 1),
        default=0,
        help=f"cells of 2**N voxels along an edge, 0 to {MAX_LEVEL}: less data",
    )
    add("--radius", metavar="M", type=_radius, default=0.0, help="of the map around the vehicle")


def _wants(text: str) -> tuple[str, ...]:
    wants = tuple(filter(None, text.split(",")))
    if not wants or (strange := set(wants) - set(WANTS)):
        what = ", ".join(sorted(strange)) if wants else "nothing"
        raise argparse.ArgumentTypeError(f"{what}: some of {', '.join(WANTS)} were expected")
    return wants


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) < 1 << 16):
        raise argparse.ArgumentTypeError(f"{text!r}: a port was expected")
    return int(text)


def _seconds(text: str) -> float:
    return _number(text, 0.001, MOST_S, "seconds were")


def _radius(text: str) -> float:
    return _number(text, 0.0, MOST_M, "metres were")


def _number(text: str, least: float, most: float, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text!r}: {what} expected")
    return value
