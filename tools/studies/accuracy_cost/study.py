"""What a study is: knobs, the settings they are turned to, and what is measured at each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

__all__ = ["Column", "Dive", "Knob", "Setting", "Study", "Value"]

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
class Dive:
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
    def dives(self) -> Sequence[Dive]:
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

    def prepare(self, dive: Dive, folder: Path) -> None:
        """Make a dive's files in a folder, once; what is there and whole is kept."""

    def measure(self, setting: Setting, dive: Dive, folder: Path) -> dict[str, float]:
        """Measure a setting on a prepared dive; returns a figure for each column.

        A figure that does not exist for a setting is NaN (an oracle's error, nothing mapped).
        """
