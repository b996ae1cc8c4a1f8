"""Arguments that export and report share, completed from the record of the run."""

import argparse
import contextlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from mapper_survey.errors import SurveyError, SurveyMissingError
from mapper_survey.export import Progress
from mapper_survey.folder import Folder
from mapper_survey.request import SurveyOrigin
from mapper_survey.running import MAP, RECORD, was_begun
from mapperd.config.loader import load_config
from mapperd.config.tree import Config
from mapperd.geometry.geodesy import Origin

__all__ = [
    "SurveyArguments",
    "SurveyRecord",
    "add_survey_arguments",
    "progress_lines",
    "read_record",
    "resolve_arguments",
]


class DiveAccuracy(msgspec.Struct, frozen=True):
    """The part of a dive's record about its poses.

    Attributes:
        name: of the dive.
        deviation_mean_m, deviation_max_m: as in `DivePlan`.
    """

    name: str = ""
    deviation_mean_m: float | None = None
    deviation_max_m: float | None = None

    def __str__(self) -> str:
        """For people."""
        if self.deviation_mean_m is None or self.deviation_max_m is None:
            return f"{self.name}: not stated"
        return (
            f"{self.name}: mean {self.deviation_mean_m:.3f} m, at most {self.deviation_max_m:.3f} m"
        )


class SurveyRecord(msgspec.Struct, frozen=True):
    """The part of `survey.json` for exports and reports.

    Attributes:
        origin: geographic position of the survey's origin; None if unknown.
        settings: settings that the map was made with; None without a record.
        outputs: products that the survey requests; empty means all that are possible.
        dives: accuracy of their poses.
    """

    origin: SurveyOrigin | None = None
    settings: Config | None = None
    outputs: list[str] = []
    dives: list[DiveAccuracy] = []


def read_record(folder: Folder) -> SurveyRecord:
    """Read the record; empty if maps were assembled without one.

    Raises:
        SurveyError: the record is invalid, or a run is unfinished.
    """
    data = folder.read(RECORD)
    if data is None:
        if was_begun(folder):
            raise SurveyError(
                f"{folder.url}: no {RECORD} in it: its run has not come to its end; "
                "the same mapper-survey run resumes it"
            )
        return SurveyRecord()
    try:
        return msgspec.json.decode(data, type=SurveyRecord)
    except msgspec.DecodeError as error:
        raise SurveyError(
            f"{folder.url}/{RECORD}: no record of a survey ({error}): run the survey again"
        ) from error


PERIOD_S = 5.0


@dataclass(frozen=True, slots=True)
class SurveyArguments:
    """The arguments; missing ones come from the record of the survey.

    Attributes:
        folder: folder of the survey.
        out: folder of the results.
        origin: geographic position of the map's origin; None if unknown.
        altitude_m: altitude of that origin, from the survey; 0 by default.
        config: its thresholds decide what is occupied.
        outputs: products that the survey requests; empty means all that are possible.
        accuracy: horizontal standard deviation of each dive's poses, for people.
    """

    folder: Folder
    out: Path
    origin: Origin | None
    altitude_m: float
    config: Config | None
    outputs: list[str]
    accuracy: list[str]


def add_survey_arguments(parser: argparse.ArgumentParser, part: str) -> None:
    """Add the survey's folder, `--out` (default: `part` of it), `--origin` and `--config`."""
    parser.add_argument(
        "survey", metavar="FOLDER", help="folder of the survey: a path or an fsspec URL"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help=f"what is written; default: {part}/ in FOLDER"
    )
    parser.add_argument(
        "--origin",
        metavar="LAT,LON",
        type=_origin,
        help="where on Earth the map's zero lies, in degrees; default: that of the survey",
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="settings, whose thresholds determine what is occupied; default: those of the survey",
    )


def resolve_arguments(args: argparse.Namespace, part: str) -> SurveyArguments:
    """Return the arguments, completed by the survey's record.

    Raises:
        SurveyError: no survey was run there, its record is damaged, or nothing can be written.
        ConfigError: the settings are not allowed, or cannot be read.
    """
    folder = Folder(args.survey)
    if not folder.has(MAP):
        raise SurveyMissingError(f"{folder.url}: no {MAP} in it: run the survey first")
    record = read_record(folder)
    out = args.out or (folder.local and folder.local / part)
    if out is None:
        raise SurveyError(
            f"{folder.url}: lies elsewhere; allowed: --out DIR, a folder of this disk"
        )
    zero = record.origin
    known = None if zero is None else Origin.of_degrees(zero.latitude, zero.longitude)
    return SurveyArguments(
        folder=folder,
        out=out,
        origin=args.origin or known,
        altitude_m=0.0 if zero is None else zero.altitude,
        config=record.settings if args.config is None else load_config(args.config),
        outputs=record.outputs,
        accuracy=[str(dive) for dive in record.dives],
    )


def progress_lines(what: str, clock: Callable[[], float] = time.monotonic) -> Progress:
    """Progress as a line every few seconds, with the time left."""
    began_s = shown_s = clock()

    def show(done: int, total: int) -> None:
        nonlocal shown_s
        now_s = clock()
        if now_s - shown_s >= PERIOD_S:
            shown_s = now_s
            left_s = (now_s - began_s) * (total - done) / done
            with contextlib.suppress(OSError):  # nobody reads the output: go on
                sys.stderr.write(f"{what}: {100 * done / total:.0f} %, {left_s:.0f} s left\n")

    return show


def _origin(text: str) -> Origin:
    try:
        latitude, longitude = (float(part) for part in text.split(","))
        values = {"latitude": latitude, "longitude": longitude}
        origin = msgspec.convert(values, SurveyOrigin)  # as in survey.yaml, by the same limits
    except ValueError as error:
        expected = "latitude,longitude in degrees were expected"
        raise argparse.ArgumentTypeError(f"{text!r}: {expected}: {error}") from error
    return Origin.of_degrees(origin.latitude, origin.longitude)
