"""Arguments of the commands that make files."""

import argparse
import math
from pathlib import Path

__all__ = ["add_convert", "add_origin"]

HELP_FORMATS = "the suffix says the format: docs/export.md"


def add_convert(command: argparse.ArgumentParser) -> None:
    """Of `convert`."""
    command.add_argument(
        "source", metavar="SOURCE", type=Path, help="a daemon's map, .map, .bt, .ot"
    )
    command.add_argument("file", metavar="FILE", type=Path, help=HELP_FORMATS)
    add_origin(command)


def add_origin(command: argparse.ArgumentParser) -> None:
    """Of all that write maps."""
    command.add_argument(
        "--origin",
        metavar="LAT,LON",
        type=_origin,
        help="where on Earth the map's zero lies, in degrees; default: what the map says, else "
        "odometry.origin",
    )
    command.add_argument(
        "--min-probability",
        metavar="P",
        type=_probability,
        help="of occupied voxels; default: mapping.occupied_threshold",
    )


def _origin(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        latitude = longitude = math.nan
    if not (abs(latitude) < 90 and abs(longitude) <= 180):  # noqa: PLR2004 degrees
        raise argparse.ArgumentTypeError(f"{text!r}: latitude,longitude in degrees were expected")
    return latitude, longitude


def _probability(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: a probability between 0 and 1 was expected")
    return value
