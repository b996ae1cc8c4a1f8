"""Arguments of the commands that make files."""

import argparse
import math
from pathlib import Path

__all__ = ["add_bag", "add_convert", "add_export"]

SIX = 6
LEVELS = range(4)
MOST = 1e6
HELP_FORMATS = "the suffix says the format: docs/export.md"


def add_convert(command: argparse.ArgumentParser) -> None:
    """Of `convert`."""
    command.add_argument(
        "source", metavar="SOURCE", type=Path, help="a daemon's map, .map, .bt, .ot"
    )
    command.add_argument("file", metavar="FILE", type=Path, help=HELP_FORMATS)
    _add_origin(command)
    _add_probability(command)
    _add_calibration(command)


def add_export(command: argparse.ArgumentParser) -> None:
    """Of `export`."""
    add = command.add_argument
    add("file", metavar="FILE", type=Path, help=f"{HELP_FORMATS}; .mcap too")
    add(
        "--level",
        type=int,
        choices=LEVELS,
        default=0,
        help="cells are cubes of 2**level voxels; default: 0",
    )
    add(
        "--box",
        metavar="X,Y,Z,X,Y,Z",
        type=_box,
        help="inside these two corners alone, metres in the map",
    )
    add(
        "--radius",
        metavar="M",
        type=_metres,
        default=0.0,
        help="around the vehicle alone; default: no limit",
    )
    add(
        "--timeout",
        metavar="S",
        type=_seconds,
        default=0.0,
        help="give up when the map is not complete by then; default: never",
    )
    _add_origin(command)
    _add_probability(command)
    _add_calibration(command)


def add_bag(command: argparse.ArgumentParser) -> None:
    """Of `bag`."""
    add = command.add_argument
    add("source", metavar="SOURCE", type=Path, help="a recording, a folder of them, or a map")
    add("bag", metavar="BAG", type=Path, help="folder that is made")
    add("--storage", choices=("mcap", "sqlite3"), default="mcap", help="default: mcap")
    add("--as-recorded", action="store_true", help="map recordings as they were mapped live")
    add("--pose", metavar="X,Y,Z,ROLL,PITCH,YAW", type=_pose, help="of a vehicle that stood still")
    add(
        "--every",
        metavar="S",
        type=_seconds,
        default=0.0,
        help="tell the map's cloud that often; default: at the end alone",
    )
    _add_probability(command)


def _add_origin(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--origin",
        metavar="LAT,LON",
        type=_origin,
        help="where on Earth the map's zero lies, in degrees; default: what the map says, else "
        "odometry.origin",
    )


def _add_probability(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--min-probability",
        metavar="P",
        type=_probability,
        help="of occupied voxels; default: mapping.occupied_threshold",
    )


def _add_calibration(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--calibration",
        metavar="FILE",
        type=Path,
        help="curve that turns probabilities into shares, such as config/calibration/harbour.yaml; "
        "default: as they are in the map",
    )


def _origin(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        latitude = longitude = math.nan
    if not (abs(latitude) < 90 and abs(longitude) <= 180):  # noqa: PLR2004 degrees
        raise argparse.ArgumentTypeError(f"{text!r}: latitude,longitude in degrees were expected")
    return latitude, longitude


def _pose(text: str) -> tuple[float, ...]:
    """Metres and degrees."""
    return _six(text, "x,y,z,roll,pitch,yaw")


def _box(text: str) -> tuple[float, ...]:
    values = _six(text, "x,y,z,x,y,z")
    low, high = values[:3], values[3:]
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise argparse.ArgumentTypeError(f"{text!r}: the lower corner comes first")
    return values


def _six(text: str, names: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != SIX or not all(abs(value) <= MOST for value in values):
        raise argparse.ArgumentTypeError(f"{text!r}: {names} were expected")
    return values


def _metres(text: str) -> float:
    return _positive(text, "metres")


def _seconds(text: str) -> float:
    return _positive(text, "seconds")


def _positive(text: str, unit: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= MOST:
        raise argparse.ArgumentTypeError(f"{text!r}: {unit} were expected")
    return value


def _probability(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: a probability between 0 and 1 was expected")
    return value
