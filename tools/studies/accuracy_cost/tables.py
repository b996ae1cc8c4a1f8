"""The figures of docs/reports/accuracy-cost.md: one row a knob, one a whole configuration."""

import math
import textwrap
from collections.abc import Sequence

from studies.accuracy_cost.command import verdict
from studies.accuracy_cost.front import SAME_COST, Plane, Point, mean_point, plane_of
from studies.accuracy_cost.plots import BIN, has_bins
from studies.accuracy_cost.results import StudyResults, key_of
from studies.accuracy_cost.study import DEFAULT, Knob, Study

__all__ = ["IMAGES", "remarks", "section"]


def remarks(study: Study, results: StudyResults) -> list[str]:
    """Paragraphs of Markdown, for the page; most studies have none."""
    if study.name != "mapping":
        return []
    # Only this study is asked, and its scenes take a second to import.
    from studies.accuracy_cost.mapping.promise import sentences  # noqa: PLC0415

    default = key_of(DEFAULT, study.dives[0]).setting
    dives = {
        dive.name: {
            DEFAULT.key if key.setting == default else key.setting: figures
            for key, figures in results.rows.items()
            if (key.dive, key.seed) == (dive.name, dive.seed)
        }
        for dive in study.dives
    }
    return [PROMISE, sentences(dives)]


PROMISE = """\
The aim against the published settings: at equal error a tenth of the time, and in equal time half
the error. It is missed because most of the error is the echo's elevation, which no ping measures,
and `rays` uses only a part of the ping ([mapping.md](../concepts/mapping.md#three-profiles)). The
second table has the error of each integrator's log-odds against the converged map's."""


IMAGES = "../images/accuracy-cost"
LITTLE = 0.1
"""More error that somebody gladly takes for a faster computer."""
FIRST = f"""\
What to turn first on a weak computer: the cheapest setting of each knob with at most
{100 * LITTLE:g} % more error than the default."""


KNOBS = "All knobs; each figure is the error at the cost, `=` the default's."


def section(study: Study, results: StudyResults) -> str:
    """All that stands between a study's marks, as Markdown."""
    head = results.head
    dives = ", ".join(f"{dive.name} (random seed {dive.seed})" for dive in study.dives)
    columns = {column.name: column.title for column in study.columns}
    about = (
        f"Error: {columns[study.error]}. Cost: {columns[study.cost]}. Means over the dives "
        f"{dives}. Commit {head.get('commit')} on {head.get('machine')}; all figures: "
        f"[{study.name}.csv](accuracy-cost/{study.name}.csv)."
    )
    parts = [f"![All settings of {study.name}]({IMAGES}/{study.name}.png)", _wrapped(about)]
    if has_bins(results):
        parts.append(f"![Reliability]({IMAGES}/{study.name}-reliability.png)")
    parts += [
        "\n".join(_whole_rows(study, results)),
        FIRST,
        "\n".join(_saving_rows(study, results)),
        *remarks(study, results),
        KNOBS,
        "\n".join(_knob_rows(study, results)),
    ]
    return "\n\n".join(parts)


def _wrapped(text: str) -> str:
    return textwrap.fill(text, 100, break_on_hyphens=False)


def _whole_rows(study: Study, results: StudyResults) -> list[str]:
    """All figures of the default and of whole configurations."""
    wholes = (DEFAULT, *study.wholes)
    rows = [f"| | {' | '.join(whole.label for whole in wholes)} |", "|---|" + "---:|" * len(wholes)]
    for column in study.columns:
        if not column.name.startswith(BIN):
            plane = Plane(column.name, column.name)
            means = [mean_point(plane, results, whole, study.dives).error for whole in wholes]
            rows.append(f"| {column.title} | {' | '.join(map(_figure, means))} |")
    return rows


def _saving_rows(study: Study, results: StudyResults) -> list[str]:
    """Knobs that save anything, those that save most first."""
    found = [(knob, _saving(study, results, knob)) for knob in study.knobs]
    savings = sorted(
        ((knob, point) for knob, point in found if point is not None),
        key=lambda pair: pair[1].cost,
    )
    rows = ["| knob | turned to | cost, times the default's | error |", "|---|---|---:|---:|"]
    for knob, point in savings:
        default = mean_point(plane_of(study, knob), results, DEFAULT, study.dives)
        error = 100.0 * (point.error / default.error - 1.0) if default.error else 0.0
        cost = point.cost / default.cost
        rows.append(f"| {knob.name} | {point.setting.label} | {cost:.2f} | {error:+.0f} % |")
    return rows if savings else ["No knob saves time at so little error."]


def _saving(study: Study, results: StudyResults, knob: Knob) -> Point | None:
    """The cheapest setting that is nearly as good as the default, if it is cheaper at all."""
    points = _points(study, results, knob)
    (default,) = (point for point in points if not point.setting.overrides)
    good = [
        point
        for point in points
        if point.error <= default.error * (1.0 + LITTLE) and point.cost * SAME_COST < default.cost
    ]
    return min(good, key=lambda point: point.cost, default=None)


def _knob_rows(study: Study, results: StudyResults) -> list[str]:
    has_published = any(knob.published is not None for knob in study.knobs)
    titles = ["knob", "default", "published", "least error", "least cost", "on the front", "effect"]
    rows = [titles, ["---"] * len(titles), *(_knob_row(study, results, k) for k in study.knobs)]
    left_out = () if has_published else (titles.index("published"),)
    return [
        f"| {' | '.join(cell for i, cell in enumerate(row) if i not in left_out)} |" for row in rows
    ]


def _knob_row(study: Study, results: StudyResults, knob: Knob) -> list[str]:
    points = _points(study, results, knob)
    known = [point for point in points if point.known]
    (default,) = (point for point in points if not point.setting.overrides)
    own = {column.name: f", {column.title}" for column in study.columns}.get(knob.error or "", "")
    cells = [
        f"[{knob.name}]({IMAGES}/{study.name}-{knob.name}.png){own}",
        _text(default),
        _text(_labelled(points, knob.published), default),
        _text(min(known, key=lambda point: point.error, default=None), default),
        _text(min(known, key=lambda point: point.cost, default=None), default),
        _place(study, results, knob),
        knob.advice,
    ]
    return [cell.replace("|", "/") for cell in cells]


def _points(study: Study, results: StudyResults, knob: Knob) -> list[Point]:
    plane = plane_of(study, knob)
    return [mean_point(plane, results, setting, study.dives) for setting in knob.settings]


def _place(study: Study, results: StudyResults, knob: Knob) -> str:
    """Whether the default is on the front, by how much it is not, and by how much it may."""
    judged = verdict(study, knob, study.dives, results, results).lag
    if judged is None:
        return "not measured"
    if judged.better is None:
        return "yes"
    margin = f"margin {100 * knob.margin:g} %"
    return f"{100 * judged.share:.2g} % behind {judged.better.label} ({margin})"


def _labelled(points: Sequence[Point], label: str | None) -> Point | None:
    return next((point for point in points if point.setting.label == label), None)


def _text(point: Point | None, default: Point | None = None) -> str:
    if point is None:
        return "-"
    if point is default:
        return "="
    return f"{point.setting.label}: {_figure(point.error)} at {_figure(point.cost)}"


def _figure(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"
