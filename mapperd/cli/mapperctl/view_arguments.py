"""Arguments of `mapperctl view`."""

import argparse
import math

__all__ = ["MOST_LEVEL", "add_view"]

MOST_LEVEL = 3


def add_view(command: argparse.ArgumentParser) -> None:
    """Of `view`."""
    add = command.add_argument
    add("--port", metavar="N", type=_port, default=8080, help="of the page; default: 8080")
    add(
        "--host",
        metavar="NAME",
        default="127.0.0.1",
        help="address that the page is served on; default: 127.0.0.1, for this computer alone",
    )
    add(
        "--allow-changes",
        action="store_true",
        help="browsers of other computers may change settings too",
    )
    add(
        "--level",
        metavar="N",
        type=int,
        choices=range(MOST_LEVEL + 1),
        default=0,
        help="cells of 2**N voxels along an edge, 0 to 3: less data",
    )
    add("--radius", metavar="M", type=_radius, default=0.0, help="of the map around the vehicle")
    add("--open", action="store_true", help="open the page in a browser")


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) < 1 << 16):
        raise argparse.ArgumentTypeError(f"{text!r}: a port was expected")
    return int(text)


def _radius(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= 1e6:  # noqa: PLR2004 as the stream allows
        raise argparse.ArgumentTypeError(f"{text!r}: metres were expected")
    return value
