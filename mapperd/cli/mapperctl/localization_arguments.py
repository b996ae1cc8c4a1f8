"""The commands of localization on the command line, under the published services' names."""

import argparse
import math
from collections.abc import Callable
from typing import Any, Literal

from mapperd.cli.mapperctl.errors import CtlError, Exit
from mapperd.pose_request import STD_XY_M, STD_YAW_RAD

__all__ = ["add_localization", "pose_said"]

MOST_M = 1e6
MOST_DEG = 3600.0
ENTRIES = 6

Add = Callable[..., argparse.ArgumentParser]


def add_localization(add: Add) -> None:
    """Add the commands.

    Args:
        add: makes a command of a name, what it is about, and more about it.
    """
    look = add("localization", "where the vehicle is on the known map")
    look.add_argument("--watch", action="store_true", help="again and again, until interrupted")
    look.add_argument(
        "--particles", metavar="N", type=_particles, default=0, help="with --json: some of them"
    )
    look.set_defaults(every=1.0)
    _add_pose(add("initial_pose", "begin localization at a pose"))
    add("global_localization", "begin localization anywhere on the map")
    add("request_nomotion_update", "have the next scan be an update, even if nothing moves")
    change = add("set_map", "localize on another map; with a pose from there on")
    change.add_argument("name", metavar="FILE", help="in the daemon's folder for maps")
    _add_pose(change, nargs="?")


def pose_said(said: argparse.Namespace) -> dict[str, Any] | None:
    """The pose of a command, as the daemon takes it; None where none is said.

    Raises:
        CtlError: a part of one is.
    """
    if said.yaw_deg is None:
        if any(part is not None for part in (said.x, said.std_xy, said.std_yaw_deg)):
            raise CtlError("a pose is X Y YAW_DEG", Exit.USAGE)
        return None
    pose = {"x_m": said.x, "y_m": said.y, "yaw_rad": math.radians(said.yaw_deg)}
    if said.frame:
        pose["frame"] = said.frame
    if said.covariance:
        xx, xy, xa, yy, ya, aa = said.covariance
        return pose | {"covariance": [[xx, xy, xa], [xy, yy, ya], [xa, ya, aa]]}
    if said.std_xy is not None:
        pose["std_xy_m"] = said.std_xy
    if said.std_yaw_deg is not None:
        pose["std_yaw_rad"] = math.radians(said.std_yaw_deg)
    return pose


def _add_pose(command: argparse.ArgumentParser, nargs: Literal["?"] | None = None) -> None:
    add = command.add_argument
    add("x", metavar="X", type=_metres, help="m, in the map's frame", nargs=nargs)
    add("y", metavar="Y", type=_metres, help="m", nargs=nargs)
    about = "heading, counter-clockwise from x"
    add("yaw_deg", metavar="YAW_DEG", type=_degrees, help=about, nargs=nargs)
    add("--std-xy", metavar="M", type=_deviation_m, help=f"default: {STD_XY_M:g} m")
    default_deg = math.degrees(STD_YAW_RAD)
    add("--std-yaw-deg", metavar="DEG", type=_deviation_deg, help=f"default: {default_deg:g} deg")
    add(
        "--covariance",
        metavar="XX,XY,XA,YY,YA,AA",
        type=_covariance,
        help="instead of both, in m2, m rad and rad2",
    )
    add("--frame", metavar="NAME", default="", help="default: amcl.global_frame_id")


def _metres(text: str) -> float:
    return _number(text, -MOST_M, MOST_M, "m")


def _degrees(text: str) -> float:
    return _number(text, -MOST_DEG, MOST_DEG, "degrees")


def _deviation_m(text: str) -> float:
    return _number(text, 0.0, MOST_M, "m")


def _deviation_deg(text: str) -> float:
    return _number(text, 0.0, MOST_DEG, "degrees")


def _number(text: str, least: float, most: float, unit: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text!r}: {least:g} to {most:g} {unit} were expected")
    return value


def _covariance(text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != ENTRIES or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"{text!r}: six numbers with commas were expected")
    return values


def _particles(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text[:9]) <= 500):  # noqa: PLR2004 written in the message
        raise argparse.ArgumentTypeError(f"{text!r}: 0 to 500 particles were expected")
    return int(text)
