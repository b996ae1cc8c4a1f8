"""Tables, verdicts and pictures of the study, from its rows."""

import csv
import json
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.stats import t as student

from mapperd.config.tree import SonarConfig
from mapperd.export.calibration import ProbabilityCalibration
from mapperd.imaging.filter_chain import filter_ping_image
from mapperd.imaging.ping_image import ping_image_of
from mapperd.mapping.sonar_map import SonarMap
from oculus_driver import Ping, StreamParser, decode_ping
from oculus_driver.noise import noise_by_range
from studies.accuracy_cost.mapping.metrics import reliability
from studies.accuracy_cost.mapping.recalibration import FILE, curve_of, written
from studies.elevation.dives import DIVES, cache_of, load
from studies.elevation.measures import CURVE_LOG_ODDS, TrueGrid, truth_of
from studies.elevation.run import CONTENDERS, VOXEL_M, Contender, contender_config, map_dive
from studies.report import IMAGES, PAGES, machine, table, write_section

__all__ = ["Rows", "Verdict", "draw_recording", "interval", "read_rows", "verdicts", "write_report"]

Floats = NDArray[np.float64]
Row = Mapping[str, Any]
Case = tuple[float, str]
"""Edge of a voxel, and whether poses are `true` or `noisy`."""

MAIN: Case = (VOXEL_M, "true")
FIRST = next(iter(CONTENDERS))
COLUMNS = {
    "f_one": "F1",
    "f_two": "F2",
    "false_share": "> 0.25 m off",
    "complete_voxels": "complete",
    "best_f_one": "best F1",
    "best_f_two": "best F2",
    "roc_area": "ROC",
    "log_loss": "log-loss",
    "log_loss_calibrated": "log-loss, calibrated",
    "calibration_worst": "worst bin",
    "calibrated_worst": "worst bin, calibrated",
    "cpu_ms": "ms a ping",
}
SLICES = {"depth_pitch": ("y", 2.55), "ship_hull": ("x", -2.0), "grazing": ("y", 2.55)}
"""Plane of the vertical slice through a dive: x or y, and where."""
CURVE_MIDDLES = (CURVE_LOG_ODDS[:-1] + CURVE_LOG_ODDS[1:]) / 2
CURVE_WEIGHT = 1e5
"""Voxels that a dive counts as."""
CURVES = {"arc": "arc.yaml", "arc, refined": "arc_refined.yaml"}
"""Contenders whose curve is shipped."""
CURVE_HEAD = """\
# For {}; fitted on simulated dives by
# python -m studies elevation report --write"""
COLOURS = ("#7f7f7f", "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b")
NEAR, MIDDLE, FAR, FREE, SOLID = "#1a9641", "#fdae61", "#d7191c", "#e8f1fa", "#000000"
DPI = 110


class Rows:
    """Rows of one case, by contender and dive.

    Args:
        rows: as `run` writes them.
        case: the others are left out.
    """

    def __init__(self, rows: Sequence[Row], case: Case) -> None:
        self._rows: dict[tuple[str, str], list[Row]] = defaultdict(list)
        for row in rows:
            if (row["edge_m"], row["poses"]) == case:
                self._rows[row["contender"], row["dive"]].append(row)
        names = {contender for contender, _ in self._rows}
        order = [*CONTENDERS, *sorted(names - CONTENDERS.keys())]
        self.contenders = [name for name in order if name in names]
        self.dives = [dive for dive in DIVES if any((c, dive) in self._rows for c in names)]

    def of(self, contender: str, dive: str) -> list[Row]:
        """One row a seed."""
        return self._rows[contender, dive]

    def values(self, contender: str, dive: str, figure: str) -> Floats:
        """A figure of each seed; empty where it was not measured."""
        found = [row[figure] for row in self.of(contender, dive) if figure in row]
        return np.array([math.nan if value is None else value for value in found], dtype=float)

    def mean(self, contender: str, dive: str, figure: str) -> float:
        """Mean over the seeds, NaN without any."""
        values = self.values(contender, dive, figure)
        return float(values.mean()) if len(values) else math.nan

    def shared(self, contender: str) -> list[str]:
        """Dives that the contender and the first one have rows of."""
        return [d for d in self.dives if self.of(contender, d) and self.of(FIRST, d)]


def read_rows(folder: Path) -> list[Row]:
    """All rows, in the order of their files' names."""
    return [json.loads(path.read_text()) for path in sorted(folder.glob("rows/*/*.json"))]


def calibrated(rows: Sequence[Row]) -> list[Row]:
    """The rows with figures of probabilities that the other dives calibrate.

    Of each contender and case, one curve a dive from the voxels of all others, each dive weighing
    the same; NaN where there is no other dive.
    """
    groups: dict[tuple[Any, ...], list[Row]] = defaultdict(list)
    for row in rows:
        groups[row["contender"], row["edge_m"], row["poses"]].append(row)
    found: list[Row] = []
    for group in groups.values():
        for dive in dict.fromkeys(row["dive"] for row in group):
            curve = curve_from([row for row in group if row["dive"] != dive])
            found += [{**row, **_calibration(row, curve)} for row in group if row["dive"] == dive]
    return found


def curve_from(rows: Sequence[Row]) -> ProbabilityCalibration | None:
    """The curve from probabilities to shares, each dive weighing the same; None without rows."""
    voxels, solids = np.zeros((2, len(CURVE_LOG_ODDS) - 1))
    for dive in {row["dive"] for row in rows}:
        counts = [
            np.sum([row[name] for row in rows if row["dive"] == dive], axis=0)
            for name in ("curve_voxels", "curve_solid")
        ]
        weight = CURVE_WEIGHT / counts[0].sum()
        voxels += weight * counts[0]
        solids += weight * counts[1]
    known = voxels > 0
    if not known.any():
        return None
    return curve_of(CURVE_MIDDLES[known], voxels[known], solids[known])


def _calibration(row: Row, curve: ProbabilityCalibration | None) -> Row:
    if curve is None:
        return {"log_loss_calibrated": None, "calibrated_worst": None}
    voxels, solids = (np.array(row[name]) for name in ("curve_voxels", "curve_solid"))
    log_odds = curve.log_odds_of(CURVE_MIDDLES)
    lost = solids * np.logaddexp(0, -log_odds) + (voxels - solids) * np.logaddexp(0, log_odds)
    bins = reliability(
        np.repeat(log_odds, voxels),
        np.repeat(np.tile([True, False], len(voxels)), _interleaved(solids, voxels - solids)),
    )
    return {
        "log_loss_calibrated": float(lost.sum() / voxels.sum()),
        "calibrated_worst": bins.worst,
    }


def _interleaved(one: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.stack([one, other], axis=1).ravel()


def interval(values: Floats) -> float:
    """Half the 95 % interval of the mean (Student's t); NaN of fewer than two values."""
    if len(values) < 2:  # noqa: PLR2004 a single one has no spread
        return math.nan
    half = student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values))
    return float(half)


@dataclass(frozen=True, slots=True)
class Verdict:
    """One line of the acceptance.

    Attributes:
        line: what is asked for.
        found: what was measured.
        kept: whether that is enough; None where nothing was measured.
    """

    line: str
    found: str
    kept: bool | None


MEAN_RATIOS = (
    ("f_one", "F1 over all dives at the defaults", False, 1.2),
    ("f_one", "F1 on varied dives", True, 1.3),
    ("false_share", "share over 0.25 m on varied dives", True, 0.5),
)
"""Figure, what it is called, whether varied dives alone count, and the ratio asked for."""
EVERY_DIVE = (
    ("log_loss", "log_loss", 0.5),
    ("log_loss_calibrated", "log_loss", 0.5),
    ("cpu_ms", "cpu_ms", 3.0),
)
"""Figure, that of the first contender, and the largest ratio."""
WORST_BIN, GOOD_SHARE = 0.1, 0.8
MAX_LOST = 0.02
CHANGE_PINGS = 15


def verdicts(rows: Rows, contender: str) -> list[Verdict]:
    """A contender's verdicts beside the first one, means over seeds and dives."""
    return [
        *_mean_verdicts(rows, contender),
        *_dive_verdicts(rows, contender),
        *_change_verdicts(rows, contender),
    ]


def _mean_verdicts(rows: Rows, contender: str) -> Iterator[Verdict]:
    """Ratios of means over the dives."""
    for figure, name, only_varied, limit in MEAN_RATIOS:
        dives = [d for d in rows.shared(contender) if DIVES[d].varied or not only_varied]
        ours, theirs = (
            sum(rows.mean(name, dive, figure) for dive in dives) for name in (contender, FIRST)
        )
        value = ours / theirs if theirs else math.nan
        kept = value >= limit if limit > 1.0 else value <= limit
        sign = "≥" if limit > 1.0 else "≤"
        yield Verdict(f"{name} {sign} {limit:g} times", f"{value:.2f}", _known(value, kept))


def _dive_verdicts(rows: Rows, contender: str) -> Iterator[Verdict]:
    """What is asked for on every dive, and on which it is worst."""
    dives = rows.shared(contender)
    for figure, base, limit in EVERY_DIVE:
        ratios = [(rows.mean(contender, d, figure) / rows.mean(FIRST, d, base), d) for d in dives]
        ratio, where = max(ratios, default=(math.nan, "none"))
        within = sum(value <= limit for value, _ in ratios)
        line = f"{COLUMNS[figure]} on every dive ≤ {limit:g} times"
        found = f"{within} of {len(dives)}; worst {ratio:.2f} ({where})"
        yield Verdict(line, found, _known(ratio, ratio <= limit))
    for figure in ("calibration_worst", "calibrated_worst"):
        good = sum(rows.mean(contender, dive, figure) <= WORST_BIN for dive in dives)
        line = f"{COLUMNS[figure]} ≤ {WORST_BIN:g} on {GOOD_SHARE:.0%} of the dives"
        kept = good >= GOOD_SHARE * len(dives) if dives else None
        yield Verdict(line, f"{good} of {len(dives)}", kept)
    for figure in ("f_one", "f_two", "roc_area"):
        losses = [(rows.mean(FIRST, d, figure) - rows.mean(contender, d, figure), d) for d in dives]
        lost, where = max(losses, default=(math.nan, "none"))
        line = f"{COLUMNS[figure]} lost on any dive ≤ {MAX_LOST:g}"
        yield Verdict(line, f"{lost:+.3f} ({where})", _known(lost, lost <= MAX_LOST))


def _change_verdicts(rows: Rows, contender: str) -> Iterator[Verdict]:
    """Pings until the map shows what has changed, of every seed."""
    dives = [dive for dive in rows.dives if DIVES[dive].change is not None]
    for figure, what in (("gone_pings", "removed object gone"), ("shown_pings", "new one shown")):
        counts = [float(n) for dive in dives for n in rows.values(contender, dive, figure)]
        text = ", ".join("never" if math.isnan(n) else f"{n:.0f}" for n in counts)
        kept = all(n <= CHANGE_PINGS for n in counts) if counts else None
        yield Verdict(f"{what} within {CHANGE_PINGS} pings", text or "not measured", kept)


def _known(value: float, kept: bool) -> bool | None:  # noqa: FBT001 a verdict
    return None if math.isnan(value) else bool(kept)


def _case_text(rows: Rows) -> str:
    """Tables of one case, Markdown."""
    parts = []
    head = ["dive", "rule", *COLUMNS.values()]
    cells = [
        [DIVES[dive].title, name, *(_cell(rows.values(name, dive, f)) for f in COLUMNS)]
        for dive in rows.dives
        for name in rows.contenders
        if rows.of(name, dive)
    ]
    parts.append(table(head, cells))
    for name in rows.contenders:
        if name == FIRST or not rows.shared(name):
            continue
        signs = {True: "yes", False: "**no**", None: "not measured"}
        judged = [[v.line, v.found, signs[v.kept]] for v in verdicts(rows, name)]
        parts.append(f"{name}:\n\n" + table(["asked for", "found", "kept"], judged))
    changing = [
        [DIVES[dive].title, name, *(_cell(rows.values(name, dive, f)) for f in CHANGES)]
        for dive in rows.dives
        for name in rows.contenders
        if DIVES[dive].change is not None
    ]
    if changing:
        parts.append(table(["dive", "rule", *CHANGES.values()], changing))
    return "\n\n".join(parts)


CHANGES = {
    "gone_pings": "pings until gone",
    "gone_share": "share left at the end",
    "shown_pings": "pings until shown",
    "shown_share": "share shown at the end",
    "removed_before": "removed one shown before",
    "added_before": "new one shown before",
}


def _cell(values: Floats) -> str:
    known = values[~np.isnan(values)]
    if not len(known):
        return "never" if len(values) else ""
    half, form = interval(known), ".1f" if abs(known.mean()) >= 5 else ".3f"  # noqa: PLR2004
    text = f"{known.mean():{form}}" + ("" if math.isnan(half) else f" ± {half:{form}}")
    return text + (f" ({len(values) - len(known)} never)" if len(known) < len(values) else "")


def _ingredients_text(rows: Rows) -> str:
    """Means over the dives of each contender, those that vary in depth, pitch or roll apart."""
    lines = []
    for name in rows.contenders:
        shared = rows.shared(name)
        varied = [dive for dive in shared if DIVES[dive].varied]
        means = [
            np.mean([rows.mean(name, dive, figure) for dive in dives]) if dives else math.nan
            for dives in (shared, varied)
            for figure in INGREDIENTS
        ]
        lines.append([name, f"{len(shared)}", *(f"{mean:.3f}" for mean in means)])
    head = [f"{text}{which}" for which in ("", ", varied") for text in INGREDIENTS.values()]
    return table(["contender", "dives", *head], lines)


INGREDIENTS = {"f_one": "F1", "best_f_one": "best F1", "false_share": "> 0.25 m off"}


def write_report(folder: Path, contenders: Sequence[str] = (), *, write: bool) -> None:
    """Print the tables and draw the pictures; with `write` into the documentation.

    Args:
        folder: of all files.
        contenders: those to report beside the first one; all without any.
        write: into docs/images and the accuracy report.

    Raises:
        ValueError: the page has no section `elevation`.
    """
    wanted = {FIRST, *contenders}
    everything = read_rows(folder)
    chosen = [row for row in everything if not contenders or row["contender"] in wanted]
    rows = calibrated(chosen)
    _write_csv(rows, folder / "results.csv")
    cases = sorted({(row["edge_m"], row["poses"]) for row in rows}, key=lambda c: (c != MAIN, c))
    text = [f"Mean and 95 % interval over seeds; {machine()}."]
    for case in cases:
        text.append(f"Voxels of {100 * case[0]:g} cm, {case[1]} poses:")
        text.append(_case_text(Rows(rows, case)))
    text.append("Single ingredients changed, means over the dives:")
    text.append(_ingredients_text(Rows(everything, MAIN)))
    pictures = IMAGES if write else folder
    main = Rows(rows, MAIN)
    for name, draw in (("f1", _draw_bars), ("reliability", _draw_reliability)):
        _save(draw(main), pictures / f"elevation-{name}.png")
    slices = _draw_slices(main.contenders[:3], folder)
    if slices is not None:
        _save(slices, pictures / "elevation-slices.png")
    print("\n\n".join(text))
    if write:
        _write_curves(chosen)
        drawn = ("f1", "reliability") if slices is None else ("f1", "slices", "reliability")
        links = [f"![{name}](../images/elevation-{name}.png)" for name in drawn]
        page, command = PAGES["accuracy-cost"], "python -m studies elevation report --write"
        write_section(page, "elevation", "\n\n".join([*text, *links]), command)


def _write_curves(rows: Sequence[Row]) -> None:
    for name, file in CURVES.items():
        here = [row for row in rows if (row["edge_m"], row["poses"]) == MAIN]
        curve = curve_from([row for row in here if row["contender"] == name])
        if curve is not None:
            what = "maps of mapping.rule: arc" + (", refined" if "refined" in name else "")
            FILE.with_name(file).write_text(written(curve, CURVE_HEAD.format(what)))


def _write_csv(rows: Sequence[Row], path: Path) -> None:
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI)
    print(f"picture: {path}")


def _draw_bars(rows: Rows) -> Figure:
    """F-score at one voxel at the default threshold; a tick is the best over thresholds."""
    figure = _figure(9.0, 4.2)
    axes = figure.subplots()
    width = 0.8 / max(len(rows.contenders), 1)
    for k, name in enumerate(rows.contenders):
        at = np.arange(len(rows.dives)) + (k - (len(rows.contenders) - 1) / 2) * width
        scores = [rows.values(name, dive, "f_one") for dive in rows.dives]
        heights = [v.mean() if len(v) else math.nan for v in scores]
        errors = [interval(v) for v in scores]
        colour = COLOURS[k % len(COLOURS)]
        axes.bar(at, heights, 0.92 * width, yerr=errors, capsize=2, color=colour, label=name)
        best = [rows.mean(name, dive, "best_f_one") for dive in rows.dives]
        axes.scatter(at, best, s=120 * width, marker="_", color="black", zorder=3)
    axes.scatter([], [], marker="_", color="black", label="best threshold")
    titles = [DIVES[dive].title.replace(", ", "\n") for dive in rows.dives]
    axes.set_xticks(np.arange(len(titles)), titles, rotation=35, ha="right", fontsize=8)
    axes.set_ylabel("F-score at one voxel")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, ncols=4, loc="upper right", frameon=False)
    return figure


def _draw_reliability(rows: Rows) -> Figure:
    """True share over predicted probability, bins of at least 100 voxels, all seeds together."""
    columns = 4
    lines = math.ceil(max(len(rows.dives), 1) / columns)
    figure = _figure(9.0, 2.4 * lines)
    grid = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
    for axes in grid.flat[len(rows.dives) :]:
        axes.remove()
    for axes, dive in zip(grid.flat, rows.dives, strict=False):
        axes.plot([0, 1], [0, 1], color="#bbbbbb", lw=1)
        for k, name in enumerate(rows.contenders):
            _draw_curve(axes, rows.of(name, dive), COLOURS[k % len(COLOURS)], name)
        axes.set_title(DIVES[dive].title, fontsize=9)
    grid[0, 0].legend(fontsize=8, frameon=False)
    figure.supxlabel("probability in the map", fontsize=9)
    figure.supylabel("share that is solid", fontsize=9)
    return figure


def _draw_curve(axes: Axes, rows: Sequence[Row], colour: str, name: str) -> None:
    counts = np.zeros(0)
    if rows:
        voxels = np.array([row["bin_voxels"] for row in rows], dtype=float)
        counts = voxels.sum(axis=0)
    known = counts >= 100  # noqa: PLR2004 as `metrics.reliability`
    if not known.any():
        return
    sums = [
        np.nansum(voxels * np.array([row[f] for row in rows], dtype=float), axis=0)[known]
        for f in ("bin_probability", "bin_solid")
    ]
    x, y = (total / counts[known] for total in sums)
    axes.plot(x, y, "o-", ms=3, lw=1.2, color=colour, label=name)


def _draw_slices(contenders: Sequence[str], folder: Path) -> Figure | None:
    """A vertical slice through the map of each contender; None without simulated dives."""
    there = [name for name in SLICES if cache_of(DIVES[name], 1, folder).exists()]
    known = [name for name in contenders if name in CONTENDERS]
    if not (there and known):
        return None
    figure = _figure(9.0, 2.7 * len(there))
    grid = figure.subplots(len(there), len(known), squeeze=False)
    for row, name in zip(grid, there, strict=True):
        data, truth = load(DIVES[name], 1, folder), truth_of(DIVES[name], VOXEL_M, folder)
        for axes, contender in zip(row, known, strict=True):
            own = CONTENDERS[contender]
            config, refine = contender_config(own, VOXEL_M), "refine" in own
            sonar_map = map_dive(data, config, refine=refine).map
            occupied_m = sonar_map.occupied().centres_m
            _draw_slice(axes, truth, sonar_map.core.voxels()[0], occupied_m, SLICES[name])
            axes.set_title(f"{DIVES[name].title}: {contender}", fontsize=9)
    meaning = {
        NEAR: "within a voxel",
        MIDDLE: "within 0.25 m",
        FAR: "farther",
        FREE: "not occupied",
    }
    handles = [Patch(color=colour, label=text) for colour, text in meaning.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


RECORDING: dict[str, Contender] = {
    "iwlo": {},
    "iwlo, noise factor 7": {"filtering.noise_factor": 7.0},
    "arc": {"mapping.rule": "arc", "arc.beam_width": 12.0},
}
"""What the recorded pings are mapped with: those of an M1200d at its high frequency."""
RECORDING_EDGE_M = 0.02


def draw_recording(recording: Path, path: Path) -> None:
    """Draw the last ping of a recording of a sonar at rest, and maps of all its pings.

    Args:
        recording: a file of the sonar's messages.
        path: of the picture.

    Raises:
        RecordingError: the file is no recording.
    """
    parser, images = StreamParser(), []
    for message in parser.feed(recording.read_bytes()):
        ping = decode_ping(message)
        if isinstance(ping, Ping):
            images.append(ping_image_of(ping, SonarConfig()))
    if not images:
        raise ValueError(f"{recording}: no ping in it")
    figure = _figure(11.0, 4.4)
    grid = figure.subplots(2, 1 + len(RECORDING), gridspec_kw={"height_ratios": [1.6, 1]})
    last = images[-1]
    edges_m = np.arange(len(last.intensity) + 1) * last.range_resolution_m
    bearings = np.append(last.bearings_rad, last.bearings_rad[-1])
    x, y = edges_m[:, None] * np.cos(bearings), -edges_m[:, None] * np.sin(bearings)
    grid[0, 0].pcolormesh(-y, x, last.intensity, cmap="magma", rasterized=True)
    grid[0, 0].set_title("last ping", fontsize=9)
    quiet = noise_by_range(last.intensity)
    ranges_m = (np.arange(len(quiet)) + 0.5) * last.range_resolution_m
    grid[1, 0].plot(ranges_m, np.median(last.intensity, axis=1), color=MIDDLE, label="median")
    grid[1, 0].plot(ranges_m, 7 * quiet, color=FAR, label="7 times the noise")
    grid[1, 0].axhline(35, color=SOLID, lw=0.8, label="threshold 35")
    grid[1, 0].set(xlabel="range, m", ylabel="level", ylim=(0, 255))
    grid[1, 0].legend(
        fontsize=6.5,
        frameon=False,
        ncols=3,
        loc="lower center",
        bbox_to_anchor=(0.45, 0.98),
        columnspacing=1.0,
        handlelength=1.2,
    )
    for (top, bottom), (name, own) in zip(grid[:, 1:].T, RECORDING.items(), strict=True):
        config = contender_config(own, RECORDING_EDGE_M)
        sonar_map = SonarMap(config)
        for image in images:
            sonar_map.integrate(filter_ping_image(image, config)[0], np.eye(4))
        x, y, z = sonar_map.occupied().centres_m.T
        ahead = np.abs(y) < 2 * RECORDING_EDGE_M
        top.scatter(-y, x, s=0.6, color=NEAR, linewidths=0)
        top.set_title(f"{name}, from above", fontsize=9)
        bottom.scatter(x[ahead], z[ahead], s=1.5, color=NEAR, linewidths=0)
        bottom.set_title("slice ahead", fontsize=9)
        bottom.set(xlim=(0, last.max_range_m), ylim=(-0.6, 0.6), xlabel="m", aspect="equal")
    for axes in grid[0]:
        axes.set(xlim=(-1.2, 1.2), ylim=(0, last.max_range_m), aspect="equal")
    for axes in grid.flat:
        axes.tick_params(labelsize=7)
    _save(figure, path)


def _draw_slice(
    axes: Axes,
    truth: TrueGrid,
    observed_m: Floats,
    occupied_m: Floats,
    plane: tuple[str, float],
) -> None:
    """Occupied voxels green within an edge of a surface, red beyond 0.25 m; solid ones outlined."""
    normal = "xy".index(plane[0])
    along = 1 - normal
    edge_m, low = truth.edge_m, truth.low
    layer = math.floor(plane[1] / edge_m) - int(low[normal])
    shape = (truth.solid.shape[along], truth.solid.shape[2])
    image = np.ones((*shape, 3))

    def paint(points_m: Floats, colour: str) -> None:
        place = truth.place(points_m)
        here = place[normal] == layer
        rgb = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        image[place[along][here], place[2][here]] = rgb

    paint(observed_m, FREE)
    off_m = truth.distance_m(occupied_m)
    paint(occupied_m[off_m > 0.25], FAR)  # noqa: PLR2004 as `false_share`
    paint(occupied_m[(off_m > edge_m) & (off_m <= 0.25)], MIDDLE)  # noqa: PLR2004
    paint(occupied_m[off_m <= edge_m], NEAR)
    first, last = low[[along, 2]] * edge_m, (low[[along, 2]] + shape) * edge_m
    extent = (first[0], last[0], first[1], last[1])
    axes.imshow(image.transpose(1, 0, 2), origin="lower", extent=extent, interpolation="nearest")
    solid = truth.solid[layer] if normal == 0 else truth.solid[:, layer]
    middles = [first[i] + (np.arange(shape[i]) + 0.5) * edge_m for i in (0, 1)]
    axes.contour(*middles, solid.T.astype(float), levels=[0.5], colors=SOLID, linewidths=0.7)
    seen = truth.place(observed_m)
    box = [(low[i] + np.array([seen[i].min(), seen[i].max() + 1])) * edge_m for i in (along, 2)]
    axes.set(xlim=box[0], ylim=box[1])
    axes.tick_params(labelsize=7)
