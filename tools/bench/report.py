"""The run's figures as Markdown and CSV."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from bench.contenders import CONTENDERS, FULL, GRID_FULL, Contender
from bench.results import BenchResults, CaseResult, ContenderResult, DetailDifference, figure
from bench.targets import FINE_M, RATE_MS, TARGETS, PerformanceTarget, fine_cases, judge

mpl.use("Agg")

CONTENDER, FIRST_RETURNS, FULL_IMAGE = "#9a9a9a", "#1f77b4", "#ff7f0e"
TOP = len(CONTENDERS)
"""Height of the limit's label: above the first bar."""


def draw(path: Path, results: BenchResults) -> None:
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
        "11 rays a first return": CONTENDER,
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
        return CONTENDER
    return FULL_IMAGE if contender.takes == FULL else FIRST_RETURNS


Row = Sequence[str]
ABSENT = "–"  # noqa: RUF001 a dash
COLUMNS = (
    *("map and input", "ms median", "ms p95", "second pass", "first ping (by the median)"),
    *("voxels a ping", "ns a voxel", "bytes a voxel (held)", "peak RSS MB", "memory share"),
)


def markdown(results: BenchResults) -> str:
    """All tables of a run."""
    fine = fine_cases(results.cases)
    asked = [target for target in TARGETS if target.asked]
    informative = [target for target in TARGETS if not target.asked]
    parts = [_machine(results), "## Asked and found", _summary(asked, fine), _targets(asked, fine)]
    parts += ["For information:", _targets(informative, fine)]
    for look in dict.fromkeys(case.look for case in results.cases):
        cases = [case for case in results.cases if case.look == look]
        parts += [f"## Looking {look}", _loud(cases), _overview(cases)]
    compared = [(case.name, case.detail) for case in results.cases if case.detail]
    if compared:
        parts += ["## Detail 1 against detail 8", _details(compared)]
    if results.open_water:
        parts += ["## Open water, 10 cm", _open_water(results.open_water)]
    return "\n\n".join(parts)


def _table(head: Row, rows: Sequence[Row]) -> str:
    """The first column is text, the others are figures."""
    rule = ["---", *("---:" for _ in head[1:])]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, rule, *rows))


def _machine(results: BenchResults) -> str:
    at = results.machine
    return (
        f"`{results.command}` at commit `{at.commit}`: up to {results.pings} pings a case, seed "
        f"{results.seed}. {at.cpu}, {at.cores} cores, load {at.load:.1f} before the run; "
        f"{at.compiler}. Streaming read-modify-write of one thread: "
        f"{at.bytes_a_second / 1e9:.1f} GB/s, read and written bytes together."
    )


def _summary(targets: Sequence[PerformanceTarget], cases: Sequence[CaseResult]) -> str:
    judged = [judge(target, case) for target in targets for case in cases]
    limited = [verdict for verdict in judged if verdict.limit is not None]
    return (
        f"Met: {sum(verdict.met for verdict in limited)} of {len(limited)}. Missed ones are bold."
    )


def _targets(targets: Sequence[PerformanceTarget], cases: Sequence[CaseResult]) -> str:
    """A row a target, a column a case, each figure with its limit."""
    head = ["5 cm, one thread", *(f"{case.look}, {case.range_m:g} m" for case in cases)]
    rows = [[target.wish, *(f"{judge(target, case)}" for case in cases)] for target in targets]
    return _table(head, rows)


def _loud(cases: Sequence[CaseResult]) -> str:
    shares = {case.range_m: case.loud_share for case in cases}
    text = ", ".join(f"{share:.1%} at {range_m:g} m" for range_m, share in shares.items())
    return f"Pixels above the threshold: {text}."


def _overview(cases: Sequence[CaseResult]) -> str:
    """Medians of both passes: a row a contender, a column a case; then the cost of motion."""
    head = ["ms a ping, median: first pass, second pass", *(case.size for case in cases)]
    rows = [
        [contender.label, *(_medians(case.runs.get(contender.name)) for case in cases)]
        for contender in CONTENDERS
        if any(contender.name in case.runs for case in cases)
    ]
    ratios = [_motion(case.runs.get(GRID_FULL.name)) for case in cases]
    return _table(head, [*rows, [f"{GRID_FULL.label}: moving against at rest", *ratios]])


def _medians(run: ContenderResult | None) -> str:
    return f"{figure(run.median_ms)}, {figure(run.second_median_ms)}" if run else ABSENT


def _motion(run: ContenderResult | None) -> str:
    ratio = run.motion_ratio if run else None
    return ABSENT if ratio is None else f"{figure(ratio)}x"


def _details(compared: Sequence[tuple[str, DetailDifference]]) -> str:
    head = ("case, full image", "other class (known to one only)", "mean difference", "pings")
    rows = [
        (
            name,
            f"{found.class_share:.3%} ({found.one_only_share:.3%})",
            f"{found.mean:.2g}",
            f"{found.pings}",
        )
        for name, found in compared
    ]
    return _table(head, rows)


def _open_water(times_ms: dict[str, float]) -> str:
    head = ("range", *(f"{range_m} m" for range_m in times_ms))
    return _table(head, [("evidence grid", *(f"{figure(ms)} ms" for ms in times_ms.values()))])


def details(results: BenchResults) -> str:
    """Return every figure of the 5 cm cases as CSV, one row a case and contender."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("case", *COLUMNS))
    for case in fine_cases(results.cases):
        for contender in CONTENDERS:
            if contender.name in case.runs:
                run = case.runs[contender.name]
                row = _run(contender, run, results.machine.bytes_a_second, results.pings)
                rows.writerow((case.name, *row))
    return text.getvalue()


def _run(contender: Contender, run: ContenderResult, bytes_a_second: float, pings: int) -> Row:
    done = len(run.ms)
    fewer = "" if done == pings else f" ({done} ping{'s' if done > 1 else ''})"
    held = run.bytes_a_held_voxel
    rss_mb, start_mb = run.peak_rss_bytes / 1e6, run.start_rss_bytes / 1e6
    return (
        contender.label,
        f"{figure(run.median_ms)}{fewer}",
        figure(run.p95_ms),
        figure(run.second_median_ms),
        f"{figure(run.ms[0])} ({figure(run.first_ping_ratio)}x)",
        f"{run.touched_a_ping / 1e3:,.0f} k",
        figure(run.ns_a_voxel),
        f"{run.bytes_a_voxel:.1f}{'' if held is None else f' ({held:.1f})'}",
        f"{rss_mb:.0f} ({rss_mb - start_mb:.0f})",
        f"{run.memory_share(bytes_a_second):.1%}",
    )
