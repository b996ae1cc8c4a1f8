"""Whether defaults are still worth choosing: errors measured now, costs as they were recorded."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from studies.accuracy_cost.errors import AccuracyCostError
from studies.accuracy_cost.front import Lag, lag, mean_point, plane_of
from studies.accuracy_cost.pool import Job, perform
from studies.accuracy_cost.results import Results, key_of
from studies.accuracy_cost.studies import Selection
from studies.accuracy_cost.study import Dive, Knob, Study

__all__ = ["Verdict", "measure_quick", "verdict", "verdicts"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a knob's default is worth.

    Attributes:
        lag: how far it lies behind the front; none where its cost was never recorded.
    """

    study: str
    knob: Knob
    lag: Lag | None

    @property
    def good(self) -> bool:
        """Whether the default lies behind the front by no more than the knob's margin."""
        return self.lag is not None and self.lag.share <= self.knob.margin

    def __str__(self) -> str:
        name = f"{self.study}: {self.knob.name}"
        if self.lag is None:
            return f"{name}: no recorded cost of its default: run make accuracy-cost"
        if self.lag.better is None:
            return f"{name}: the default is on the front"
        return (
            f"{name}: the default lies {100 * self.lag.share:.1f} % behind the front (margin "
            f"{100 * self.knob.margin:g} %): {self.lag.better.label} has less error at no more cost"
        )


def measure_quick(module: str, study: Study, folder: Path) -> Results:
    """Measure the quick subset, in this process.

    Raises:
        AccuracyCostError: a setting cannot be measured.
    """
    results = Results({"study": study.name}, [column.name for column in study.columns])
    selection = Selection(quick=True)
    for dive in selection.dives_of(study):
        place = folder / study.name / f"{dive.name}-{dive.seed}"
        for setting in (None, *selection.settings_of(study)):
            outcome = perform(Job(module, dive, setting, place))
            if outcome.figures is None:
                label = "its files" if setting is None else setting.label
                raise AccuracyCostError(f"{study.name}: {dive.name}, {label}: {outcome.failure}")
            if setting is not None:
                results.rows[key_of(setting, dive)] = outcome.figures
    return results


def verdict(
    study: Study, knob: Knob, dives: Sequence[Dive], errors: Results, costs: Results
) -> Verdict:
    """Judge a knob's default by the mean over dives; errors and costs may be of different runs."""
    plane = plane_of(study, knob)
    points = [
        replace(
            mean_point(plane, errors, setting, dives),
            cost=mean_point(plane, costs, setting, dives).cost,
        )
        for setting in knob.settings
    ]
    (default,) = (point for point in points if not point.setting.overrides)
    others = [point for point in points if point.setting.overrides]
    known = not math.isnan(default.cost)
    return Verdict(study.name, knob, lag(default, others) if known else None)


def verdicts(
    studies: Mapping[str, Study], errors: Mapping[str, Results], costs: Mapping[str, Results]
) -> list[Verdict]:
    """Judge the defaults of all quick knobs; results are by the study's name."""
    return [
        verdict(study, knob, dives, errors[study.name], costs[study.name])
        for study in studies.values()
        for dives in [[dive for dive in study.dives if dive.quick]]
        for knob in study.knobs
        if knob.quick
    ]
