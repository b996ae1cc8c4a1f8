"""The studies, by name, and what of them is measured."""

import pkgutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from studies.accuracy_cost.errors import AccuracyCostError
from studies.accuracy_cost.study import Dive, Knob, Setting, Study

__all__ = ["DEFAULT", "MODULES", "Selection", "load", "load_all"]

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

    def dives_of(self, study: Study) -> list[Dive]:
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
            AccuracyCostError: one of them, told with those that there are.
        """
        names = [knob.name for study in studies for knob in study.knobs]
        for name in self.knobs:
            if name not in names:
                raise AccuracyCostError(f"no knob {name}; there are {', '.join(names)}")
