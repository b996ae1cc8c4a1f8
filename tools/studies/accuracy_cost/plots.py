"""The plots of a study: one a knob, and one of everything that was measured."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes

from studies.accuracy_cost.front import Plane, Point, front, mean_point, plane_of, point_on
from studies.accuracy_cost.picture import (
    DEFAULT_STYLE,
    PUBLISHED_STYLE,
    draw_front,
    label_points,
    lay_out,
    new_figure,
    panel_size,
    panels,
    save,
    scale,
)
from studies.accuracy_cost.results import Results
from studies.accuracy_cost.studies import DEFAULT, Selection
from studies.accuracy_cost.study import Column, Knob, Setting, Study

__all__ = ["draw_knob", "draw_summary", "measured_knob"]

PUBLISHED = "published"
"""Label of the whole configuration that the published system has."""
WHOLE_MARKS = ("D", "^", "v", "P", "X", "o")
LABELLED_ON_FRONT = 7
AXIS_WIDTH = 45
"""Characters of an axis title's line."""


def measured_knob(results: Results, knob: Knob) -> bool:
    """Whether any setting of a knob but the default is in the results."""
    measured = {key.setting for key in results.rows}
    return any(setting.key in measured for setting in knob.settings if setting.overrides)


def draw_knob(study: Study, results: Results, knob: Knob, path: Path) -> None:
    """Draw error against cost of a knob's settings: a panel a dive, and the mean over them."""
    plane = plane_of(study, knob)
    groups = _groups(study, results, knob.settings, plane)
    figure = new_figure(*panel_size(len(groups)))
    for axes, (title, points) in zip(panels(figure, len(groups)), groups, strict=True):
        scale(axes, points)
        draw_front(axes, points)
        known = [point for point in points if point.known]
        axes.plot(
            [point.cost for point in known], [point.error for point in known],
            ":", color="0.6", lw=0.8, zorder=0,
        )  # fmt: skip
        for point in known:
            _mark(axes, point, published=point.setting.label == knob.published)
        _name_axes(axes, study, plane, title)
    figure.suptitle(_title(knob, width=60 * min(len(groups), 2)), fontsize=12)
    lay_out(figure)
    for axes, (_, points) in zip(figure.axes, groups, strict=True):
        known = [point for point in points if point.known]
        label_points(axes, [(point, _label(point, knob)) for point in known], known)
    save(figure, path)


def draw_summary(study: Study, results: Results, path: Path) -> None:
    """Draw all that was measured: every knob, the front over all, the whole configurations."""
    settings = Selection().settings_of(study)
    plane = plane_of(study)
    groups = _groups(study, results, settings, plane)
    figure = new_figure(*panel_size(len(groups)))
    wholes = {whole.key: whole for whole in study.wholes}
    for axes, (title, points) in zip(panels(figure, len(groups)), groups, strict=True):
        scale(axes, points)
        draw_front(axes, points)
        _draw_all(axes, [point for point in points if point.known], wholes)
        _name_axes(axes, study, plane, title)
    figure.suptitle(f"All settings of the study of {study.name}", fontsize=12)
    lay_out(figure)
    for axes, (_, points) in zip(figure.axes, groups, strict=True):
        label_points(axes, _named(study, points, wholes), [p for p in points if p.known])
    save(figure, path)


def _named(
    study: Study, points: Sequence[Point], wholes: Mapping[str, Setting]
) -> list[tuple[Point, str]]:
    """Points with labels: the default, whole configurations, and some along the front."""
    best = front(points)
    every_nth = max(1, -(-len(best) // LABELLED_ON_FRONT))
    named = {point.setting.key: point for point in best[::every_nth]}
    named |= {p.setting.key: p for p in points if p.known and p.setting.key in {"", *wholes}}
    return [(point, _whole_label(study, key, wholes)) for key, point in named.items()]


def _draw_all(axes: Axes, points: Sequence[Point], wholes: Mapping[str, Setting]) -> None:
    marks = dict(zip(wholes, WHOLE_MARKS, strict=False))
    for point in points:
        key = point.setting.key
        if key in marks and key:
            published = wholes[key].label.startswith(PUBLISHED)
            style = PUBLISHED_STYLE if published else {"marker": marks[key], "color": "#1f77b4"}
            axes.plot(point.cost, point.error, zorder=4, **style)
        elif key:
            axes.plot(point.cost, point.error, "o", color="0.65", markersize=4, zorder=2)
        else:
            axes.plot(point.cost, point.error, zorder=4, **DEFAULT_STYLE)


def _groups(
    study: Study, results: Results, settings: Sequence[Setting], plane: Plane
) -> list[tuple[str, list[Point]]]:
    """Titles of panels and what is in them."""
    groups = [
        (dive.name, [point_on(plane, results, setting, dive) for setting in settings])
        for dive in study.dives
    ]
    if len(groups) > 1:
        means = [mean_point(plane, results, setting, study.dives) for setting in settings]
        groups.append(("mean", means))
    return [(title, points) for title, points in groups if any(point.known for point in points)]


def _mark(axes: Axes, point: Point, *, published: bool) -> None:
    if published:
        style = PUBLISHED_STYLE | {"markersize": 13, "fillstyle": "none", "markeredgewidth": 1.5}
        axes.plot(point.cost, point.error, zorder=3, linestyle="none", **style)
    if point.setting.overrides:
        axes.plot(point.cost, point.error, "o", color="#1f77b4", markersize=6, zorder=4)
    else:
        axes.plot(point.cost, point.error, zorder=4, **DEFAULT_STYLE)


def _label(point: Point, knob: Knob) -> str:
    said = [] if point.setting.overrides else ["default"]
    said += ["published"] if point.setting.label == knob.published else []
    return f"{point.setting.label} ({', '.join(said)})" if said else point.setting.label


def _whole_label(study: Study, key: str, wholes: Mapping[str, Setting]) -> str:
    """A setting is told by its knob too, where all knobs are in one plot."""
    if not key:
        return DEFAULT.label
    if key in wholes:
        return wholes[key].label
    return next(
        f"{knob.name}: {setting.label}"
        for knob in study.knobs
        for setting in knob.settings
        if setting.key == key
    )


def _title(knob: Knob, width: int) -> str:
    marks = "star: default" + (", square: published" if knob.published else "")
    return textwrap.fill(f"{knob.title} ({marks}; line: front)", width)


def _name_axes(axes: Axes, study: Study, plane: Plane, title: str) -> None:
    columns: dict[str, Column] = {column.name: column for column in study.columns}
    axes.set_xlabel(textwrap.fill(columns[plane.cost].title, AXIS_WIDTH))
    axes.set_ylabel(textwrap.fill(columns[plane.error].title, AXIS_WIDTH))
    axes.set_title(title, fontsize=10)
