"""Aligns the dives of a survey in one frame, and writes a survey of the aligned dives."""

import math
import os
import re
from collections import Counter
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import yaml
from numpy.typing import NDArray

from mapper_survey.errors import SurveyError, SurveyMissingError, SurveySettingsError
from mapper_survey.request import Request, Survey, SurveyDive, read_survey
from mapperd.config.layers import load_files
from mapperd.errors import ExportExtraError, ReplayError, missing_extra
from mapperd.io import atomic_file, make_folder, remove
from mapperd.odometry.trajectory_files import FixFile
from mapperd.session.recordings import RecordedSession, files_in, sessions_of
from mapperd.session.replay import odometry_of, require_overlap
from oculus_driver.errors import RecordingError

if TYPE_CHECKING:
    from mapperd.alignment.align import Fix
    from mapperd.alignment.report import AlignmentRecord

__all__ = ["SURVEY", "align_survey", "dives_of"]

SURVEY = "survey.yaml"
YAML = (".yaml", ".yml")

Progress = Callable[[float, str], None]


def dives_of(
    given: Sequence[Path], config: Path | None = None, odometry: Sequence[Path] = ()
) -> Request:
    """Return the dives to align.

    Args:
        given: one survey.yaml, or recordings: files, or folders of files.
        config: settings of recordings; None uses the defaults.
        odometry: a file for each recording, in place of its odometry; empty uses that.

    Raises:
        SurveyError: a file is missing or wrong, or the arguments contradict each other.
        ConfigError: the settings are wrong.
    """
    if len(given) == 1 and given[0].suffix in YAML:
        if config is not None or odometry:
            raise SurveyError(
                f"--config and --odometry are for recordings; {given[0]} states both itself"
            )
        request = read_survey(given[0])
        _check(request.survey)
        return request
    if odometry and len(odometry) != len(given):
        raise SurveyError(
            f"--odometry: {len(odometry)} files for {len(given)} recordings; allowed: one for each"
        )
    for path in [*given, *odometry]:
        if not path.exists():
            raise SurveyMissingError(f"{path}: there is no such file")
    names = _names(given)
    files: list[list[str]] = [[str(path.absolute())] for path in odometry] or [[] for _ in given]
    survey = Survey(
        dives=[
            SurveyDive(name, str(path.absolute()), odometry=own)
            for name, path, own in zip(names, given, files, strict=True)
        ],
        configuration="" if config is None else str(config.absolute()),
    )
    return Request(survey, load_files([] if config is None else [config]).config, Path.cwd())


def _names(paths: Sequence[Path]) -> list[str]:
    """Names of files, with numbers where they are equal."""
    stems = [re.sub(r"[^A-Za-z0-9._-]", "-", path.stem).lstrip("._-")[:50] for path in paths]
    stems = [stem or "dive" for stem in stems]
    counts, seen = Counter(stems), Counter[str]()
    names = []
    for stem in stems:
        seen[stem] += 1
        names.append(f"{stem}-{seen[stem]}" if counts[stem] > 1 else stem)
    return names


def _check(survey: Survey) -> None:
    localized = next((dive.name for dive in survey.dives if dive.localization is not None), None)
    if localized is not None:
        raise SurveySettingsError(
            f"dive {localized}: its poses come from localization, so it cannot be aligned; leave "
            "the dive or its localization out"
        )


def align_survey(
    request: Request, out: Path, threads: int, progress: Progress = lambda *_: None
) -> "AlignmentRecord":
    """Align the dives, and write trajectories, the report and, if corrected, a survey of them.

    Dives with a transform, and all dives of a survey with an origin, have a known frame. Dives with
    position fixes are placed by these.

    Args:
        request: of `dives_of`.
        out: folder of the results.
        threads: that register submaps.
        progress: receives the share that is done, and what is being done.

    Returns:
        the figures, with the verdict.

    Raises:
        ExportError: a file cannot be written, or an extra is missing.
        ReplayError: a dive has no poses, no sonar data, or more than one session.
    """
    missing = next((name for name in ("scipy", "matplotlib") if find_spec(name) is None), None)
    if missing is not None:
        raise ExportExtraError(missing_extra(missing, "align"))
    from mapperd.alignment.align import AlignOptions, DiveInput, align  # noqa: PLC0415 an extra
    from mapperd.alignment.report import maps_of, write_alignment  # noqa: PLC0415
    from mapperd.alignment.submaps import DiveReader  # noqa: PLC0415

    make_folder(out)
    readers, inputs = [], []
    for dive in request.survey.dives:
        lift_m = 0.0 if dive.transform is None else dive.transform.z
        readers.append(DiveReader(_session_of(request, dive), request.config, lift_m))
        known = _fixes_of(request, dive)
        inputs.append(DiveInput(dive.name, readers[-1], _frame_of(request, dive), known))
    try:
        alignment = align(inputs, AlignOptions(threads=threads), progress)
    except RecordingError as error:
        raise ReplayError(str(error)) from error
    maps = maps_of(alignment, readers)
    record = write_alignment(alignment, out, maps)
    if record.corrected:
        with atomic_file(out / SURVEY) as file:
            file.write(_survey_text(request, out, record).encode())
    else:
        remove(out / SURVEY)
    return record


def _session_of(request: Request, dive: SurveyDive) -> RecordedSession:
    """Return the only session of a dive, with its odometry."""
    path = request.path_of(dive)
    try:
        paths = files_in([path], begun=True)
        sessions = sessions_of(paths)
        if len(sessions) != 1:
            raise ReplayError(
                f"dive {dive.name}: {path}: {len(sessions)} sessions; a dive to align has one"
            )
        odometry = odometry_of(sessions, request.odometry_of(dive), request.config)
        if odometry is not None:
            require_overlap(sessions, odometry)
            sessions = sessions_of(paths, odometry=odometry)
    except RecordingError as error:
        raise ReplayError(f"dive {dive.name}: {error}") from error
    return sessions[0]


def _fixes_of(request: Request, dive: SurveyDive) -> "tuple[Fix, ...]":
    if dive.fixes is None:
        return ()
    try:
        return FixFile(request.folder / dive.fixes).fixes(request.config)
    except RecordingError as error:
        raise ReplayError(f"dive {dive.name}: {error}") from error


def _frame_of(request: Request, dive: SurveyDive) -> NDArray[np.float64] | None:
    """Pose of the dive's odometry in the survey: x, y (m), yaw (rad); None if it is to be found."""
    at = dive.transform
    if at is not None:
        return np.array([at.x, at.y, math.radians(at.yaw_deg)])
    return None if request.survey.origin is None or dive.fixes is not None else np.zeros(3)


def _survey_text(request: Request, out: Path, record: "AlignmentRecord") -> str:
    """Return the survey of the aligned dives; other keys are those of the given survey."""
    survey = request.survey
    kept: dict[str, Any] = {}
    if survey.configuration:
        kept["configuration"] = _relative(request.folder / survey.configuration, out)
    for key in ("settings", "origin", "tile_size_m", "outputs"):
        value = getattr(survey, key)
        if value:
            kept[key] = msgspec.to_builtins(value)
    kept["dives"] = [
        {
            "name": dive.name,
            "recording": _relative(request.path_of(dive), out),
            "odometry": [aligned.trajectory[-1]],
        }
        for dive, aligned in zip(survey.dives, record.dives, strict=True)
    ]
    return yaml.safe_dump(kept, sort_keys=False, allow_unicode=True)


def _relative(path: Path, folder: Path) -> str:
    """Return a path from a folder."""
    return os.path.relpath(path.resolve(), folder.resolve())
