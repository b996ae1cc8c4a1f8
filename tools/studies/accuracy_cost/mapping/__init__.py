"""What accuracy costs in mapping: surfaces and probabilities against CPU time a ping."""

from dataclasses import dataclass
from pathlib import Path

from studies.accuracy_cost.mapping.dives import DIVES, make_dive
from studies.accuracy_cost.mapping.knobs import KNOBS, WHOLES
from studies.accuracy_cost.mapping.measuring import COLUMNS, COST, ERROR, make_oracle, measure
from studies.accuracy_cost.study import Column, Knob, Setting, StudyDive

__all__ = ["STUDY", "MappingStudy"]


@dataclass(frozen=True, slots=True)
class MappingStudy:
    """See `studies.accuracy_cost.study.Study`."""

    name: str = "mapping"
    knobs: tuple[Knob, ...] = KNOBS
    dives: tuple[StudyDive, ...] = DIVES
    wholes: tuple[Setting, ...] = WHOLES
    columns: tuple[Column, ...] = COLUMNS
    error: str = ERROR
    cost: str = COST

    def prepare(self, dive: StudyDive, folder: Path) -> None:
        """Simulate the dive and make its converged map."""
        folder.mkdir(parents=True, exist_ok=True)
        make_dive(dive, folder)
        make_oracle(dive, folder)

    def measure(self, setting: Setting, dive: StudyDive, folder: Path) -> dict[str, float]:
        """Map the dive with a setting and compare."""
        return measure(setting, dive, folder)


STUDY = MappingStudy()
