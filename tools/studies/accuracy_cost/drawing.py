"""Pictures and tables of a study, into their files."""

from collections.abc import Iterator
from pathlib import Path

from studies.accuracy_cost.plots import (
    draw_knob,
    draw_reliability,
    draw_summary,
    has_bins,
    measured_knob,
)
from studies.accuracy_cost.results import StudyResults
from studies.accuracy_cost.study import Selection, Study
from studies.accuracy_cost.tables import section
from studies.report import PAGES, write_section

__all__ = ["PAGE", "draw"]

PAGE = PAGES["accuracy-cost"]


def draw(
    study: Study, results: StudyResults, selection: Selection, pictures: Path, *, write: bool
) -> Iterator[Path]:
    """Draw the pictures of a selection; with all knobs the summary too. Yields their files."""
    for knob in selection.knobs_of(study):
        if measured_knob(results, knob):
            path = pictures / f"{study.name}-{knob.name}.png"
            draw_knob(study, results, knob, path)
            yield path
    if not selection.knobs:
        draw_summary(study, results, pictures / f"{study.name}.png")
        yield pictures / f"{study.name}.png"
        if has_bins(results):
            draw_reliability(study, results, pictures / f"{study.name}-reliability.png")
            yield pictures / f"{study.name}-reliability.png"
    if write:
        command = f"python -m studies accuracy-cost plot --only {study.name} --write"
        write_section(PAGE, study.name, section(study, results), command)
        yield PAGE
