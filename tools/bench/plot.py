"""The run's milliseconds a ping as a picture."""

from pathlib import Path

import matplotlib as mpl

from bench.contenders import CONTENDERS, FULL, Contender
from bench.results import CaseResult, Results, figure
from bench.targets import FINE_M, RATE_MS

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Patch

RIVAL, FIRST_RETURNS, FULL_IMAGE = "#9a9a9a", "#1f77b4", "#ff7f0e"
TOP = len(CONTENDERS)
"""Height of the limit's label: above the first bar."""


def draw(path: Path, results: Results) -> None:
    """One panel a case: bars of the median, whiskers to the 95th percentile."""
    looks = list(dict.fromkeys(case.look for case in results.cases))
    columns = len(results.cases) // len(looks)
    picture, panels = plt.subplots(
        len(looks),
        columns,
        figsize=(3.0 + 3.6 * columns, 4.2 * len(looks)),
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    for panel, case in zip(panels.ravel(), results.cases, strict=True):
        _panel(panel, case)
    for panel in panels[-1]:
        panel.set_xlabel("ms a ping: median, line to 95th percentile")
    kinds = {
        "11 rays a first return": RIVAL,
        "ours, the same first returns": FIRST_RETURNS,
        "ours, the full image": FULL_IMAGE,
    }
    patches = [Patch(color=colour, label=label) for label, colour in kinds.items()]
    picture.legend(handles=patches, loc="upper center", ncols=len(patches), frameon=False)
    picture.tight_layout(rect=(0.0, 0.0, 1.0, 0.96))
    picture.savefig(path, dpi=90)
    plt.close(picture)


def _panel(panel: Axes, case: CaseResult) -> None:
    for place, contender in enumerate(reversed(CONTENDERS)):
        run = case.runs.get(contender.name)
        if run is None:
            continue
        panel.barh(place, run.median_ms, color=_colour(contender), height=0.75)
        panel.plot([run.median_ms, run.p95_ms], [place, place], color="black", linewidth=1)
        right = max(run.median_ms, run.p95_ms)
        panel.text(right * 1.1, place, figure(run.median_ms), va="center", fontsize=8)
    panel.set_yticks(range(len(CONTENDERS)), [_label(c) for c in reversed(CONTENDERS)], fontsize=8)
    panel.set_xscale("log")
    panel.margins(x=0.2)
    panel.grid(axis="x", alpha=0.3)
    panel.set_axisbelow(True)
    panel.set_title(case.name, fontsize=11)
    panel.set_ylim(-0.8, TOP + 0.8)
    if case.resolution_m == FINE_M:
        limit_ms = RATE_MS[case.range_m]
        panel.axvline(limit_ms, color="firebrick", linestyle="--", linewidth=1)
        panel.text(1.15 * limit_ms, TOP, f"{limit_ms:g} ms", fontsize=8, color="firebrick")


def _label(contender: Contender) -> str:
    threads = ", 2 threads" if contender.threads > 1 else ""
    return f"{contender.map_name}{threads}"


def _colour(contender: Contender) -> str:
    if not contender.is_ours:
        return RIVAL
    return FULL_IMAGE if contender.takes == FULL else FIRST_RETURNS
