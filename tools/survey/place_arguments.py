"""Arguments that exporting and reporting share: the survey's folder, where it lies, settings."""

import argparse
import contextlib
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path

from mapperd.config import Config
from mapperd.config_file import load_config
from mapperd.errors import MapperdError
from mapperd.geodesy import Origin
from survey.errors import SurveyError
from survey.export import Progress

__all__ = ["MERGED", "USAGE", "add_place", "config_of", "shown", "told"]

MERGED = "map.db"
"""The merged map in a survey's folder."""

USAGE = 2
PERIOD_S = 5.0


def add_place(parser: argparse.ArgumentParser, folder: str) -> None:
    """Add the survey's folder, `--out`, `--origin` and `--config`."""
    parser.add_argument("survey", type=Path, help=f"the survey's folder, with {MERGED}")
    parser.add_argument("--out", type=Path, help=f"folder of what is written; default: {folder}/")
    parser.add_argument(
        "--origin",
        metavar="LAT,LON",
        type=_origin,
        help="where on Earth the map's zero lies, in degrees; default: nobody knows",
    )
    parser.add_argument(
        "--config", type=Path, help="settings, whose thresholds say what is occupied"
    )


def config_of(path: Path | None) -> Config | None:
    """The settings of a file.

    Raises:
        ConfigError: they are not allowed, or cannot be read.
    """
    return None if path is None else load_config(path)


def told(does: Callable[[], None]) -> int:
    """Do something; what a person can mend is one line and exit code 2."""
    try:
        does()
    except (SurveyError, MapperdError) as error:
        sys.stderr.write(f"mapper-survey: {error}\n")
        return USAGE
    return 0


def shown(what: str, clock: Callable[[], float] = time.monotonic) -> Progress:
    """Progress as a line every few seconds, with the time left."""
    began_s = shown_s = clock()

    def show(done: int, total: int) -> None:
        nonlocal shown_s
        now_s = clock()
        if now_s - shown_s >= PERIOD_S:
            shown_s = now_s
            left_s = (now_s - began_s) * (total - done) / done
            with contextlib.suppress(OSError):  # nobody can look on: no reason to stop
                sys.stderr.write(f"{what}: {100 * done / total:.0f} %, {left_s:.0f} s left\n")

    return show


def _origin(text: str) -> Origin:
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        latitude = longitude = math.nan
    if not (abs(latitude) < 90 and abs(longitude) <= 180):  # noqa: PLR2004 degrees
        raise argparse.ArgumentTypeError(f"{text!r}: latitude,longitude in degrees were expected")
    return Origin.of_degrees(latitude, longitude)
