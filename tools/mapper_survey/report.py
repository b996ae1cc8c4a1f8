"""The report of a survey: coverage, overlap and disagreement, as numbers and pictures."""

import itertools
import json
import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mapper_survey.coverage import BANDS, Coverage, Pictures, Raster, cover
from mapper_survey.difference import Comparison, DifferenceCounts, cubes_of, differences
from mapper_survey.errors import SurveyError
from mapper_survey.export import Progress, grid_place
from mapper_survey.tally import Tally
from mapper_survey.windows import WINDOW_BRICKS, Tiling, WindowedMap, tiling_of
from mapperd.config.tree import Config
from mapperd.errors import ExportError, missing_extra
from mapperd.export.geotiff import write_tiles
from mapperd.export.picture import can_draw
from mapperd.geometry.geodesy import Origin
from mapperd.io import atomic_file, make_folder

__all__ = [
    "COVERAGE",
    "DIFFERENCE",
    "DISAGREEMENT",
    "DISTANCES",
    "OVERLAP",
    "REPORT",
    "VERSION",
    "DiveRecord",
    "PairRecord",
    "Report",
    "WayRecord",
    "draw_pictures",
    "report_of",
    "report_survey",
]


VERSION = 1

EXCELLENT, MODERATE = 0.1, 0.3
"""Grades of sonar_3d_reconstruction's analyser, by the share of voxels without a partner."""


MIN_OVERLAP = 0.05
"""Share of a dive's voxels observed by the other, below which there is no grade."""


class DiveRecord(msgspec.Struct, frozen=True):
    """Ground of one dive."""

    name: str
    observed_m2: float
    mapped_m2: float
    alone_m2: float


class WayRecord(msgspec.Struct, frozen=True):
    """Differences from one dive's occupied voxels to the other's."""

    voxels: int
    common: int
    only: int
    only_share: float | None
    compared: int
    missing: int
    missing_share: float | None
    called_free: int
    conflicts: int
    farther: int
    median_m: float | None
    p95_m: float | None


class HeightRecord(msgspec.Struct, frozen=True):
    """Differences of surfaces where several dives have one."""

    cells: int
    median_m: float | None
    p95_m: float | None


class PairRecord(msgspec.Struct, frozen=True):
    """Two dives; `grade` is None with little overlap."""

    a: str
    b: str
    a_to_b: WayRecord
    b_to_a: WayRecord
    dz: HeightRecord
    mean_only_share: float | None
    published_grade: str | None
    mean_missing_share: float | None
    grade: str | None


class CoverageRecord(msgspec.Struct, frozen=True):
    """Ground of all dives."""

    mapped_m2: float
    overlap_m2: float
    merged_m2: float
    by_dives_m2: dict[str, float]


class Report(msgspec.Struct, frozen=True):
    """The whole document."""

    version: int
    resolution_m: float
    tolerance_m: float
    reach_m: float
    occupied_threshold: float
    free_threshold: float
    coverage: CoverageRecord
    spread: HeightRecord
    dives: list[DiveRecord]
    pairs: list[PairRecord]


def report_of(
    comparison: Comparison,
    coverage: Coverage,
    ways: Mapping[tuple[str, str], DifferenceCounts],
    *,
    tolerance_m: float,
    thresholds: tuple[float, float],
) -> Report:
    """Assemble the report from the counts."""
    edge_m = comparison.resolution_m
    cell_m2 = edge_m**2
    return Report(
        VERSION,
        edge_m,
        tolerance_m,
        comparison.reach * edge_m,
        *thresholds,
        CoverageRecord(
            len(coverage.by_dives) * cell_m2,
            (len(coverage.by_dives) - coverage.by_dives.up_to(1)) * cell_m2,
            coverage.merged * cell_m2,
            {str(dives): cells * cell_m2 for dives, cells in coverage.by_dives},
        ),
        _heights(coverage.spread, coverage.spread, edge_m),
        [
            DiveRecord(
                name,
                coverage.observed[name] * cell_m2,
                coverage.mapped[name] * cell_m2,
                coverage.alone[name] * cell_m2,
            )
            for name in coverage.mapped
        ],
        [_pair(a, b, ways, tally, comparison) for (a, b), tally in coverage.dz.items()],
    )


def _pair(
    a: str,
    b: str,
    ways: Mapping[tuple[str, str], DifferenceCounts],
    dz: Tally,
    comparison: Comparison,
) -> PairRecord:
    there, back = (_way(ways[pair], comparison) for pair in ((a, b), (b, a)))
    only, missing = (
        _mean(getattr(there, share), getattr(back, share))
        for share in ("only_share", "missing_share")
    )
    apart = Tally()
    for number, count in dz:
        apart.add_one(abs(number), count)
    heights = _heights(dz, apart, comparison.resolution_m)
    grade = _grade(missing) if max(map(_overlap_of, (there, back))) >= MIN_OVERLAP else None
    return PairRecord(a, b, there, back, heights, only, _grade(only), missing, grade)


def _overlap_of(way: WayRecord) -> float:
    return way.compared / way.voxels if way.voxels else 0.0


def _way(way: DifferenceCounts, comparison: Comparison) -> WayRecord:
    missing, only = way.compared - way.common, way.voxels - way.common
    return WayRecord(
        way.voxels,
        way.common,
        only,
        only / way.voxels if way.voxels else None,
        way.compared,
        missing,
        missing / way.compared if way.compared else None,
        way.called_free,
        way.conflicts,
        len(way.squares) - way.squares.up_to(comparison.reach**2),
        _distance(way.squares.quantile(0.5), comparison),
        _distance(way.squares.quantile(0.95), comparison),
    )


def _distance(square: int | None, comparison: Comparison) -> float | None:
    """Return a distance in metres; None if it is beyond the limit."""
    if square is None or square > comparison.reach**2:
        return None
    return math.sqrt(square) * comparison.resolution_m


def _heights(middle: Tally, high: Tally, edge_m: float) -> HeightRecord:
    median, p95 = middle.quantile(0.5), high.quantile(0.95)
    return HeightRecord(
        len(middle),
        None if median is None else median * edge_m,
        None if p95 is None else p95 * edge_m,
    )


def _mean(a: float | None, b: float | None) -> float | None:
    """Return the value of both directions, or of the only one."""
    there = [share for share in (a, b) if share is not None]
    return sum(there) / len(there) if there else None


def _grade(share: float | None) -> str | None:
    if share is None:
        return None
    return "excellent" if share < EXCELLENT else "moderate" if share < MODERATE else "poor"


COVERAGE, OVERLAP = "coverage.png", "overlap.png"
DISAGREEMENT, DISTANCES = "disagreement.png", "distances.png"

DPI = 110
PAPER, INK, LOOKED = "#ffffff", "#1b2733", "#d9e0e6"
MAX_LINES = 6
"""Maximum number of pairs that are drawn; with more, the worst."""

Floats = NDArray[np.float64]


def draw_pictures(
    out_dir: Path,
    report: Report,
    pictures: Pictures,
    raster: Raster,
    ways: Mapping[tuple[str, str], DifferenceCounts],
) -> None:
    """Write all four PNGs.

    Raises:
        ExportError: matplotlib is missing, or a file cannot be written.
    """
    if not can_draw():
        raise ExportError(f"no pictures: {missing_extra('matplotlib', 'survey')}")
    for name, figure in (
        (COVERAGE, _coverage(report, pictures, raster)),
        (OVERLAP, _overlap(report, pictures, raster)),
        (DISAGREEMENT, _disagreement(report, pictures, raster)),
        (DISTANCES, _distances(report, ways)),
    ):
        with atomic_file(out_dir / name) as file:
            figure.savefig(file, format="png", dpi=DPI)


def _coverage(report: Report, pictures: Pictures, raster: Raster) -> Any:  # noqa: ANN401 untyped
    covered = report.coverage
    figure, (axes,) = _maps(
        f"{covered.merged_m2:,.0f} m² mapped by {len(report.dives)} dives; "
        "grey: looked at, no surface",
        pictures,
        raster,
    )
    _put(axes, np.where(pictures.observed > 0, 0.0, np.nan), pictures, raster, cmap=_plain(LOOKED))
    heights = np.where(np.isfinite(pictures.z_m), pictures.z_m, np.nan)
    known = heights[np.isfinite(heights)]
    low, high = (
        np.percentile(known, [1, 99]) if len(known) else (0.0, 1.0)
    )  # relief, without isolated objects
    image = _put(axes, heights, pictures, raster, cmap="viridis", vmin=low, vmax=high)
    bar = {"ax": axes, "label": "highest surface z [m]", "shrink": 0.8, "extend": "both"}
    figure.colorbar(image, **bar)
    return figure


def _overlap(report: Report, pictures: Pictures, raster: Raster) -> Any:  # noqa: ANN401
    covered = report.coverage
    share = covered.overlap_m2 / covered.mapped_m2
    figure, (axes,) = _maps(
        f"{covered.overlap_m2:,.0f} m² seen by two or more dives, {share:.0%} of what is mapped",
        pictures,
        raster,
    )
    most = max(int(dives) for dives in covered.by_dives_m2)
    from matplotlib import colormaps  # noqa: PLC0415 an extra
    from matplotlib.colors import BoundaryNorm  # noqa: PLC0415

    colours = colormaps["plasma"].resampled(max(most, 2))
    norm = BoundaryNorm(np.arange(0.5, max(most, 2) + 1), colours.N)
    dives = np.where(pictures.dives > 0, pictures.dives, np.nan)
    image = _put(axes, dives, pictures, raster, cmap=colours, norm=norm)
    ticks = np.unique(np.linspace(1, max(most, 2), min(max(most, 2), 10)).astype(int))
    figure.colorbar(image, ax=axes, label="dives with a surface", shrink=0.8, ticks=ticks)
    return figure


def _disagreement(report: Report, pictures: Pictures, raster: Raster) -> Any:  # noqa: ANN401
    compared = (pictures.compared > 0) | np.isfinite(pictures.spread_m)
    shown = _broad(raster.shown_m(compared)) if compared.any() else None
    voxels = [way for pair in report.pairs for way in (pair.a_to_b, pair.b_to_a)]
    number, whole = (sum(getattr(way, name) for way in voxels) for name in ("compared", "voxels"))
    share = number / whole if whole else 0.0
    figure, (left, right) = _maps(
        f"disagreement where several dives looked ({share:.1%} of their voxels); "
        f"tolerance {report.tolerance_m:g} m; grey: one dive",
        pictures,
        raster,
        number=2,
        shown=shown,
    )
    spread = np.where(np.isfinite(pictures.spread_m), pictures.spread_m, np.nan)
    with np.errstate(invalid="ignore"):
        missing = pictures.missing / np.where(pictures.compared > 0, pictures.compared, np.nan)
    high = max(5 * report.tolerance_m, report.resolution_m)
    for axes, picture, most, title, bar in (
        (left, spread, high, "highest less lowest surface, the most in a pixel", "spread [m]"),
        (right, missing, 1.0, "voxels that the other dive has not", "share"),
    ):
        single = np.where(pictures.dives > 0, 0.0, np.nan)
        _put(axes, single, pictures, raster, cmap=_plain(LOOKED))
        image = _put(axes, picture, pictures, raster, cmap="plasma", vmin=0.0, vmax=most)
        axes.set_title(title, fontsize=10, loc="left")
        if shown is not None:
            axes.set(xlim=shown[:2], ylim=shown[2:])
        extend = "max" if picture is spread else "neither"
        figure.colorbar(image, ax=axes, label=bar, shrink=0.8, extend=extend)
    return figure


def _broad(
    box_m: tuple[float, float, float, float],
) -> tuple[float, float, float, float]:
    """Widen a narrow strip to fit a page; return left, right, bottom, top."""
    left, right, bottom, top = box_m
    width, height = right - left, top - bottom
    more_x, more_y = max(height - width, 0.0) / 2, max(width / 2 - height, 0.0) / 2
    return left - more_x, right + more_x, bottom - more_y, top + more_y


def _distances(report: Report, ways: Mapping[tuple[str, str], DifferenceCounts]) -> Any:  # noqa: ANN401
    figure = _figure(10.0, 5.0)
    figure.suptitle("from each dive's voxels to the nearest of the other", color=INK, fontsize=12)
    axes = figure.subplots()
    pairs = [pair for pair in report.pairs if pair.a_to_b.compared or pair.b_to_a.compared]
    pairs.sort(key=lambda pair: pair.mean_missing_share or 0.0, reverse=True)
    for number, pair in enumerate(pairs[:MAX_LINES]):
        for (a, b), style in (((pair.a, pair.b), "-"), ((pair.b, pair.a), "--")):
            way = ways[a, b]
            if way.compared:
                steps = np.array(list(way.squares), dtype=np.float64)
                x_m, y = np.sqrt(steps[:, 0]) * report.resolution_m, np.cumsum(steps[:, 1])
                label = f"{a} to {b}: {way.common / way.compared:.1%}"
                axes.step(x_m, y / y[-1], style, where="post", color=f"C{number}", label=label)
    axes.axvline(report.tolerance_m, color=INK, linewidth=1, linestyle=":")
    axes.set(xlim=(0, report.reach_m), ylim=(0, 1.02), xlabel="distance [m]")
    axes.set_ylabel("share of compared voxels within it")
    axes.grid(alpha=0.25)
    if pairs:
        chosen = f"; the worst {MAX_LINES} of {len(pairs)} pairs"
        title = f"within {report.tolerance_m:g} m" + chosen * (len(pairs) > MAX_LINES)
        axes.legend(title=title, fontsize=8, loc="lower right")
    else:
        axes.text(0.5, 0.5, "no two dives looked at the same place", ha="center", color=INK)
    return figure


def _maps(
    title: str,
    pictures: Pictures,
    raster: Raster,
    *,
    number: int = 1,
    shown: tuple[float, float, float, float] | None = None,
) -> tuple[Any, list[Any]]:
    """Make a figure with maps side by side, or stacked if they are wide.

    Args:
        title: title of the figure.
        pictures: pictures of the ground.
        raster: raster of the pictures.
        number: number of maps.
        shown: left, right, bottom and top, m; None shows the observed area.
    """
    left, right, bottom, top = shown or _shown(pictures, raster)
    ratio = float(np.clip((top - bottom) / (right - left), 0.3, 1.6))
    wide = ratio < 1
    width, height = 9.0, 6.9 * ratio + 1.2  # the rest is for the scale and the title
    size = (width, height * number) if wide else (width * number, height)
    figure = _figure(*size)
    figure.suptitle(title, color=INK, fontsize=12)
    grid = figure.subplots(number, 1) if wide else figure.subplots(1, number)
    maps = list(np.atleast_1d(grid))
    for axes in maps:
        axes.set(xlabel="x east [m]", ylabel="y north [m]", facecolor=PAPER, aspect="equal")
    return figure, maps


def _shown(pictures: Pictures, raster: Raster) -> tuple[float, float, float, float]:
    return raster.shown_m((pictures.observed > 0) | (pictures.dives > 0))


def _figure(width_in: float, height_in: float) -> Any:  # noqa: ANN401
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(width_in, height_in), facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _put(axes: Any, picture: Floats, pictures: Pictures, raster: Raster, **how: Any) -> Any:  # noqa: ANN401
    shown = _shown(pictures, raster)
    left, right, bottom, top = raster.extent_m
    image = axes.imshow(picture, extent=(left, right, bottom, top), interpolation="nearest", **how)
    axes.set(xlim=shown[:2], ylim=shown[2:])
    return image


def _plain(colour: str) -> Any:  # noqa: ANN401
    from matplotlib.colors import ListedColormap  # noqa: PLC0415 an extra

    return ListedColormap([colour])


REPORT, DIFFERENCE = "report.json", "difference.tif"


def report_survey(
    stores_by_dive: Mapping[str, Path],
    merged: Path,
    out_dir: Path,
    tolerance_m: float,
    progress: Progress = lambda _done, _all: None,
    *,
    origin: Origin | None = None,
    config: Config | None = None,
) -> Report:
    """Compare each pair of dives of a survey in both directions, and write the report.

    Memory holds one window of one map at a time, and pictures of at most 1200 pixels a side.

    Args:
        stores_by_dive: map file of each dive, all in one frame and of one resolution.
        merged: map file of all dives.
        out_dir: created if missing; gets `report.json`, `difference.tif` and pictures.
        tolerance_m: distance within which voxels of two dives are the same.
        progress: receives the numbers of finished and of all parts.
        origin: origin of the GeoTIFF; None if unknown.
        config: its thresholds count; None uses the defaults.

    Raises:
        SurveyError: the maps cannot be compared, have no surface, or the tolerance is invalid.
        StoreError: a map cannot be read, or bricks of it are damaged.
        ExportError: a file cannot be written, or a library is missing.
    """
    with ExitStack() as opening:
        whole = opening.enter_context(WindowedMap(merged, config))
        stores = {
            name: opening.enter_context(WindowedMap(path, config))
            for name, path in stores_by_dive.items()
        }
        _check(stores, whole)
        make_folder(out_dir)
        return _Comparing(stores, whole, tolerance_m, progress).write(out_dir, origin)


class _Comparing:
    """All dives of a survey, opened."""

    def __init__(
        self,
        stores: Mapping[str, WindowedMap],
        merged: WindowedMap,
        tolerance_m: float,
        progress: Progress,
    ) -> None:
        self._stores, self._merged, self._progress = stores, merged, progress
        self._tolerance_m = tolerance_m
        self._comparison = Comparison(merged.resolution_m, tolerance_m)
        every = [stored.keys for stored in (*stores.values(), merged)]
        self._tiling: Tiling = tiling_of(np.concatenate(every), WINDOW_BRICKS)
        self._raster = Raster(self._tiling, merged.resolution_m)
        self._pictures = Pictures.empty(self._raster)
        self._coverage = Coverage(
            dict.fromkeys(stores, 0), dict.fromkeys(stores, 0), dict.fromkeys(stores, 0)
        )
        self._coverage.dz = {pair: Tally() for pair in itertools.combinations(stores, 2)}
        self._ways = {pair: DifferenceCounts() for pair in itertools.permutations(stores, 2)}

    def write(self, out_dir: Path, origin: Origin | None) -> Report:
        """Count everything, then write the report."""
        progress = self._progress_steps()
        place = grid_place(self._tiling, self._comparison.resolution_m, 1)
        with atomic_file(out_dir / DIFFERENCE) as file:
            tiles = cover(
                self._stores,
                self._merged,
                self._tiling,
                self._coverage,
                self._pictures,
                raster=self._raster,
                progress=progress,
            )
            write_tiles(file, tiles, place, BANDS, origin, edge=self._tiling.edge)
            if not len(self._coverage.by_dives):
                raise SurveyError("no dive has an occupied voxel: there is nothing to report")
        self._compare(progress)
        config = self._merged.config
        report = report_of(
            self._comparison,
            self._coverage,
            self._ways,
            tolerance_m=self._tolerance_m,
            thresholds=(config.occupied_threshold, config.free_threshold),
        )
        with atomic_file(out_dir / REPORT) as file:
            plain = msgspec.to_builtins(report)
            file.write(json.dumps(plain, indent=2, allow_nan=False).encode() + b"\n")
        draw_pictures(out_dir, report, self._pictures, self._raster, self._ways)
        return report

    def _compare(self, progress: Callable[[], None]) -> None:
        raster, pictures = self._raster, self._pictures
        for found in differences(self._stores, self._ways, self._comparison, progress):
            x, y = found.index.T
            raster.put(pictures.compared, np.add.at, x, y, 1.0)
            raster.put(pictures.missing, np.add.at, x, y, found.missing)

    def _progress_steps(self) -> Callable[[], None]:
        total = self._tiling.columns * self._tiling.rows + len(cubes_of(self._stores))
        done = itertools.count(1)
        return lambda: self._progress(next(done), total)


def _check(stores: Mapping[str, WindowedMap], merged: WindowedMap) -> None:
    if not stores:
        raise SurveyError("no dives: there is nothing to report")
    for name, stored in stores.items():
        if stored.resolution_m != merged.resolution_m:
            raise SurveyError(
                f"{name}: its voxels are {stored.resolution_m:g} m, those of the merged map "
                f"{merged.resolution_m:g} m: plan and run the survey again"
            )
    if not sum(len(stored.keys) for stored in stores.values()):
        raise SurveyError("the maps of all dives are empty: there is nothing to report")
