"""Reads and checks the request of a survey, `survey.yaml`."""

import math
import re
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from mapper_survey.errors import SurveyError, SurveyMissingError, SurveySettingsError
from mapper_survey.export import check_products
from mapperd.config.catalog import parameters
from mapperd.config.layers import load_files
from mapperd.config.live import with_values
from mapperd.config.loader import MAX_FILE_BYTES, YamlProblem, parse_yaml
from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from mapperd.odometry.odometry_files import OdometryOptions
from oculus_driver.command_line import hint_at_name

__all__ = ["DiveTransform", "Request", "Survey", "SurveyDive", "SurveyOrigin", "read_survey"]

Metres = Annotated[float, Meta(ge=-1e7, le=1e7)]


class DiveTransform(Struct, frozen=True, forbid_unknown_fields=True):
    """Pose of a dive's map frame in the survey's: rotated by yaw, then shifted."""

    x: Metres = 0.0
    y: Metres = 0.0
    z: Metres = 0.0
    yaw_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0

    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) `survey_T_dive`."""
        yaw_rad = math.radians(self.yaw_deg)
        cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
        return np.array(
            [
                [cosine, -sine, 0.0, self.x],
                [sine, cosine, 0.0, self.y],
                [0.0, 0.0, 1.0, self.z],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )


class SurveyDive(Struct, frozen=True, forbid_unknown_fields=True):
    """One recording session, or the folder of one.

    Attributes:
        name: name of its files in the survey's folder.
        recording: a file, or a folder of files.
        transform: into the survey's frame; None if the frames are equal.
        odometry: files that replace the recorded odometry; empty uses that.
        odometry_offset: seconds added to their times.
        localization: a known map in the survey's frame, on which the dive is localized; each ping
            is mapped at the localized poses, and only while they are certain.
        fixes: CSV of known positions in the survey's frame, for `mapper-survey align`.
    """

    name: Annotated[str, Meta(pattern="^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    recording: Annotated[str, Meta(min_length=1)]
    transform: DiveTransform | None = None
    localization: str | None = None
    odometry: list[Annotated[str, Meta(min_length=1)]] = []
    odometry_offset: Annotated[float, Meta(ge=-1e10, le=1e10)] = 0.0
    fixes: Annotated[str, Meta(min_length=1)] | None = None


class SurveyOrigin(Struct, frozen=True, forbid_unknown_fields=True):
    """Geographic position of the survey's origin; altitude of z = 0 in metres."""

    latitude: Annotated[float, Meta(ge=-90, le=90)]
    longitude: Annotated[float, Meta(ge=-180, le=180)]
    altitude: Annotated[float, Meta(ge=-12000, le=9000)] = 0.0


class Survey(Struct, frozen=True, forbid_unknown_fields=True):
    """Content of the file; `outputs` are the products to export, by default all."""

    dives: Annotated[list[SurveyDive], Meta(min_length=1)]
    configuration: str = ""
    settings: dict[str, Any] = {}
    origin: SurveyOrigin | None = None
    tile_size_m: Annotated[float, Meta(gt=0, le=1e5)] | None = None
    outputs: list[str] = []


class Request(Struct, frozen=True):
    """A survey whose files were found.

    Attributes:
        survey: content of the file.
        config: the settings of all dives.
        folder: base of relative paths in the survey.
    """

    survey: Survey
    config: Config
    folder: Path

    def path_of(self, dive: SurveyDive) -> Path:
        """Return the path of a dive's recording."""
        return self.folder / dive.recording

    def odometry_of(self, dive: SurveyDive) -> OdometryOptions | None:
        """Return the odometry of a dive if it is in separate files, else None."""
        paths = tuple(self.folder / name for name in dive.odometry)
        return OdometryOptions(paths, dive.odometry_offset) if paths else None

    def config_of(self, dive: SurveyDive) -> Config:
        """Return the settings of a dive.

        Raises:
            SurveyError: localization is impossible with them.
        """
        if dive.localization is None:
            return self.config
        mode = self.config.localization.mode
        values = {
            "localization.mode": "track" if mode == "off" else mode,
            "localization.map_path": str(self.folder / dive.localization),
            "localization.mapping": "corrected",
        }
        try:
            return with_values(self.config, values)
        except ConfigError as error:
            raise SurveyError(f"dive {dive.name}: {error}") from error


def read_survey(path: Path) -> Request:
    """Read a survey and the settings that it names.

    Raises:
        SurveyError: it is invalid; one line with the place and the allowed values.
    """
    survey = _survey_of(_tree_of(path), path)
    folder = path.resolve().parent
    names = [dive.name for dive in survey.dives]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise SurveySettingsError(f"{path}: $.dives: two dives are called {twice}")
    try:
        if survey.outputs:
            check_products(survey.outputs, known=survey.origin is not None)
    except SurveyError as error:
        raise SurveySettingsError(f"{path}: $.outputs: {error}") from error
    for number, dive in enumerate(survey.dives):
        _check_files(dive, folder, f"{path}: $.dives[{number}]")
    return Request(survey, _settings_of(survey, folder, path), folder)


def _check_files(dive: SurveyDive, folder: Path, here: str) -> None:
    """Raise if a file of a dive is missing, or its keys contradict each other."""
    if not (folder / dive.recording).exists():
        raise SurveyMissingError(
            f"{here}.recording: {dive.recording}: there is no such recording; allowed: a file "
            "or a folder, from the folder of this file"
        )
    for name in dive.odometry:
        if not (folder / name).exists():
            raise SurveyMissingError(
                f"{here}.odometry: {name}: there is no such file; allowed: a list of files, "
                "from the folder of this file"
            )
    if dive.fixes is not None and not (folder / dive.fixes).is_file():
        raise SurveyMissingError(f"{here}.fixes: {dive.fixes}: there is no such file")
    if dive.fixes is not None and dive.transform is not None:
        raise SurveySettingsError(
            f"{here}: has a transform and fixes; allowed: one of them, for either determines where "
            "the dive lies in the survey"
        )
    if dive.transform is not None and dive.localization is not None:
        raise SurveySettingsError(
            f"{here}: has a transform and localization; allowed: one of them, for either "
            "determines where the dive lies in the survey"
        )
    if dive.localization is not None and not (folder / dive.localization).is_file():
        raise SurveyMissingError(f"{here}.localization: {dive.localization}: there is no such map")


def _tree_of(path: Path) -> object:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        if len(data) > MAX_FILE_BYTES:
            raise SurveySettingsError(
                f"{path}: larger than {MAX_FILE_BYTES // 1024} KiB, not a survey"
            )
        return parse_yaml(data.decode("utf-8-sig"))
    except OSError as error:
        raise SurveyMissingError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SurveySettingsError(f"{path}: not UTF-8 text (byte {error.start})") from error
    except YamlProblem as problem:
        raise SurveySettingsError(f"{path}: {problem}") from problem


def _survey_of(tree: object, path: Path) -> Survey:
    try:
        return msgspec.convert(tree, Survey)
    except msgspec.ValidationError as error:
        text = str(error)
        what, _, place = text.partition(" - at ")
        place = place.strip("`") or "$"
        if unknown := re.search(r"unknown field `(.*)`", what):
            what = _unknown(unknown[1], place)
        raise SurveySettingsError(f"{path}: {place}: {what}") from error


def _unknown(field: str, place: str) -> str:
    kinds = {"transform": DiveTransform, "origin": SurveyOrigin, "$": Survey}
    last = place.rpartition(".")[2]
    known = kinds.get(last, SurveyDive).__struct_fields__
    hint = hint_at_name(field, known, f"allowed: {', '.join(known)}")
    return f"there is no {field[:60]}; {hint}"


def _settings_of(survey: Survey, folder: Path, path: Path) -> Config:
    try:
        files = [folder / survey.configuration] if survey.configuration else []
        config = with_values(load_files(files).config, _values_of(survey, path))
    except ConfigError as error:
        raise SurveySettingsError(f"{path}: {str(error).removeprefix(': ')}") from error
    if config.mapping.rule != "iwlo":
        raise SurveySettingsError(
            f"{path}: mapping.rule {config.mapping.rule} cannot map the tiles of a survey one by "
            "one, because its arcs cross them; allowed: iwlo"
        )
    if survey.origin is None:
        return config
    zero = {"latitude": survey.origin.latitude, "longitude": survey.origin.longitude}
    configured = config.odometry.origin
    if configured is not None and msgspec.to_builtins(configured) != zero:
        raise SurveySettingsError(
            f"{path}: $.origin: the settings have another odometry.origin; allowed: the same, or "
            "only one of them"
        )
    return with_values(config, {"odometry.origin": zero})


def _values_of(survey: Survey, path: Path) -> dict[str, object]:
    """Return settings by full name, written so or in sections."""
    values: dict[str, object] = {}

    def walk(tree: dict[str, Any], prefix: str) -> None:
        for key, value in tree.items():
            name = f"{prefix}{key}"
            if name in parameters():
                values[name] = value
            elif isinstance(value, dict) and any(p.startswith(f"{name}.") for p in parameters()):
                walk(value, f"{name}.")
            else:
                page = "docs/reference/configuration.md has them all"
                hint = hint_at_name(name, parameters(), page)
                raise SurveySettingsError(
                    f"{path}: $.settings.{name}: there is no such setting; {hint}"
                )

    walk(survey.settings, "")
    return values
