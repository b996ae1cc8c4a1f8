"""What a study is: knobs, the settings they are turned to, and what is measured at each."""

import pkgutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

__all__ = [
    "DEFAULT",
    "MODULES",
    "AccuracyCostError",
    "Column",
    "Knob",
    "Selection",
    "Setting",
    "Study",
    "StudyDive",
    "Value",
    "load",
    "load_all",
]


class AccuracyCostError(Exception):
    """An error that the user can correct; its message is one line."""


Value = bool | int | float | str


@dataclass(frozen=True, slots=True)
class Setting:
    """One position of a knob, or a whole configuration.

    Attributes:
        label: in plots and tables.
        overrides: what differs from the defaults, by dotted name; empty is the defaults. Equal
            overrides are measured once, whatever knob asks for them.
    """

    label: str
    overrides: Mapping[str, Value]

    @property
    def key(self) -> str:
        """The overrides as one text, in the order of their names."""
        return " ".join(f"{name}={value}" for name, value in sorted(self.overrides.items()))


@dataclass(frozen=True, slots=True)
class Knob:
    """What is turned, everything else at its default.

    Attributes:
        name: of the plot's file, such as `voxel-size`.
        title: heading of the plot.
        settings: in order; one of them has no overrides and is the default.
        published: label of the setting that the published system has, if any.
        margin: how far, as a share of the error, the default may lie behind the front.
        advice: a sentence for docs/reports/accuracy-cost.md: what turning it buys and costs.
        error: column on its error axis, where turning it shows in another one than the study's.
        quick: whether the subset of `accuracy-cost check` turns it.
    """

    name: str
    title: str
    settings: Sequence[Setting]
    published: str | None
    margin: float
    advice: str
    error: str | None = None
    quick: bool = False


@dataclass(frozen=True, slots=True)
class Column:
    """A measured figure.

    Attributes:
        name: in the results' file, with its unit: `surface_p95_m`.
        title: of its axis, with its unit.
        better: "less" or "more".
        repeatable: the same in every run of the same commit; times are not.
        chance: column of its standard error, where it is of a sample drawn at random.
    """

    name: str
    title: str
    better: str = "less"
    repeatable: bool = True
    chance: str | None = None


@dataclass(frozen=True, slots=True)
class StudyDive:
    """A dive (or scene, or link) that settings are measured on.

    Attributes:
        name: in the results' file.
        seed: of everything random in it.
        quick: whether the subset of `accuracy-cost check` measures it.
    """

    name: str
    seed: int
    quick: bool = False


class Study(Protocol):
    """One of mapping, localization, simulation, stream."""

    @property
    def name(self) -> str:
        """Of the study's results and pictures."""

    @property
    def knobs(self) -> Sequence[Knob]:
        """What is turned."""

    @property
    def dives(self) -> Sequence[StudyDive]:
        """On what."""

    @property
    def wholes(self) -> Sequence[Setting]:
        """Whole configurations, marked in all plots: the published system's, the profiles."""

    @property
    def columns(self) -> Sequence[Column]:
        """What is measured."""

    @property
    def error(self) -> str:
        """Column on the error axis."""

    @property
    def cost(self) -> str:
        """Column on the time axis."""

    def prepare(self, dive: StudyDive, folder: Path) -> None:
        """Make a dive's files in a folder, once; what is there and whole is kept."""

    def measure(self, setting: Setting, dive: StudyDive, folder: Path) -> dict[str, float]:
        """Measure a setting on a prepared dive; returns a figure for each column.

        A figure that does not exist for a setting is NaN (an oracle's error, nothing mapped).
        """


MODULES = {
    "mapping": "studies.accuracy_cost.mapping",
    "localization": "studies.accuracy_cost.localization",
    "simulation": "studies.accuracy_cost.simulation",
    "stream": "studies.accuracy_cost.streaming",
}
DEFAULT = Setting("default", {})


def load(module: str) -> Study:
    """Import a study.

    Raises:
        AccuracyCostError: the study contradicts itself.
    """
    study: Study = pkgutil.resolve_name(f"{module}:STUDY")
    _check(study)
    return study


def load_all(only: Iterable[str]) -> dict[str, Study]:
    """Import studies by name; returns them by their modules."""
    return {MODULES[name]: load(MODULES[name]) for name in only}


def _check(study: Study) -> None:
    columns = {column.name: column for column in study.columns}
    errors = {study.error, *(knob.error for knob in study.knobs if knob.error)}
    for axis in (*sorted(errors), study.cost):
        if axis not in columns or columns[axis].better != "less":
            raise AccuracyCostError(f"{study.name}: {axis} is no column of which less is better")
        if axis in errors and not columns[axis].repeatable:
            raise AccuracyCostError(f"{study.name}: its error {axis} differs from run to run")
    for knob in study.knobs:
        labels = [setting.label for setting in knob.settings]
        if len(set(labels)) < len(labels):
            raise AccuracyCostError(f"{study.name}: {knob.name} has two settings of one label")
        if sum(not setting.overrides for setting in knob.settings) != 1:
            raise AccuracyCostError(f"{study.name}: {knob.name} needs one setting of no overrides")
        if knob.published not in (None, *labels):
            raise AccuracyCostError(f"{study.name}: {knob.name} has no setting {knob.published}")


@dataclass(frozen=True, slots=True)
class Selection:
    """Which part of the studies.

    Attributes:
        knobs: their names; empty is all of them, and the whole configurations.
        quick: only the subset of `accuracy-cost check`.
    """

    knobs: Sequence[str] = ()
    quick: bool = False

    def dives_of(self, study: Study) -> list[StudyDive]:
        """The dives of it."""
        return [dive for dive in study.dives if dive.quick or not self.quick]

    def knobs_of(self, study: Study) -> list[Knob]:
        """The knobs of it, in the study's order."""
        return [
            knob
            for knob in study.knobs
            if (knob.quick or not self.quick) and (not self.knobs or knob.name in self.knobs)
        ]

    def settings_of(self, study: Study) -> list[Setting]:
        """The settings of it, each once; the defaults first."""
        knobs = self.knobs_of(study)
        if self.knobs and not knobs:
            return []
        wholes = () if self.knobs or self.quick else study.wholes
        turned = [setting for knob in knobs for setting in knob.settings]
        by_key: dict[str, Setting] = {}
        for setting in (DEFAULT, *turned, *wholes):
            by_key.setdefault(setting.key, setting)
        return list(by_key.values())

    def check_names(self, studies: Iterable[Study]) -> None:
        """Refuse names that no knob of these studies has.

        Raises:
            AccuracyCostError: an unknown name; the message lists those that there are.
        """
        names = [knob.name for study in studies for knob in study.knobs]
        for name in self.knobs:
            if name not in names:
                raise AccuracyCostError(f"no knob {name}; there are {', '.join(names)}")
