"""Localization as a study: prepares its dives and measures settings on them."""

from pathlib import Path

from studies.accuracy_cost.localization.dives import DIVES, PLANS, load_runs, map_path, prepare_dive
from studies.accuracy_cost.localization.figures import COLUMNS, COST, ERROR, figures_of
from studies.accuracy_cost.localization.knobs import KNOBS, WHOLES
from studies.accuracy_cost.localization.runs import localize
from studies.accuracy_cost.localization.settings import config_for
from studies.accuracy_cost.study import Column, Dive, Knob, Setting

__all__ = ["LocalizationStudy"]


class LocalizationStudy:
    """The study; the defaults are those of `config/localization.yaml`."""

    name = "localization"
    knobs: tuple[Knob, ...] = KNOBS
    dives: tuple[Dive, ...] = DIVES
    wholes: tuple[Setting, ...] = WHOLES
    columns: tuple[Column, ...] = COLUMNS
    error = ERROR
    cost = COST

    def prepare(self, dive: Dive, folder: Path) -> None:
        """As of `Study`."""
        prepare_dive(dive, folder)

    def measure(self, setting: Setting, dive: Dive, folder: Path) -> dict[str, float]:
        """As of `Study`."""
        plan = PLANS[dive.name]
        config = config_for(plan.place, setting.overrides, dive.seed)
        path = map_path(folder, float(setting.overrides.get("scale.cells", 1.0)))
        runs, memory = localize(path, load_runs(dive, folder), plan.repeats, config)
        return figures_of(runs, plan.place.right_m, memory)
