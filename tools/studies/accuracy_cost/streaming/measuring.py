"""The map stream as a study: prepares its dives and measures settings on them."""

from pathlib import Path

from studies.accuracy_cost.streaming.dives import DIVES, PLANS, load_dive, prepare_dive
from studies.accuracy_cost.streaming.figures import COLUMNS, COST, ERROR
from studies.accuracy_cost.streaming.knobs import KNOBS, WHOLES
from studies.accuracy_cost.streaming.settings import constants, told_by
from studies.accuracy_cost.streaming.watching import watched
from studies.accuracy_cost.study import Column, Dive, Knob, Setting

__all__ = ["StreamStudy"]


class StreamStudy:
    """The study; the defaults are the daemon's, and those of a client that asks for all."""

    name = "stream"
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
        told = told_by(setting.overrides, plan.voxel_m)
        with constants(told):
            return watched(load_dive(folder), plan, told)
