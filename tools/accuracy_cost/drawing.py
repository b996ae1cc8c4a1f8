"""Pictures and tables of a study, into their files."""

from collections.abc import Iterator
from pathlib import Path

from marked import put_into

from accuracy_cost.plots import draw_knob, draw_summary, measured_knob
from accuracy_cost.reliability import draw_reliability, has_bins
from accuracy_cost.results import Results
from accuracy_cost.studies import ROOT, Selection
from accuracy_cost.study import Study
from accuracy_cost.tables import section

__all__ = ["PAGE", "draw"]

PAGE = ROOT / "docs/reports/accuracy-cost.md"


def draw(
    study: Study, results: Results, selection: Selection, pictures: Path, *, write: bool
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
        put_into(PAGE, f"accuracy-cost plot --only {study.name} --write", section(study, results))
        yield PAGE
