"""What `mapping.error_bound` costs and saves: time a ping against the error of the log-odds.

Each ping is integrated into an empty map, exactly and with each bound, so that the differences are
those of one observation. Prints the table of docs/mapping.md and draws docs/images/error-bound.png,
in some five minutes.

Usage: python tools/bench/error_bound.py [--pings N] [--picture FILE]
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench_input import DOWN, SETTINGS, cached
from bench_pings import Pings, load
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from our_settings import APERTURE_DEG

from mapperd.config import Config, Mapping, Octree, Sonar
from mapperd.mapping import SonarMap

BOUNDS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
RESOLUTIONS_M = (0.1, 0.05)
SEED = 7
PICTURE = Path("docs/images/error-bound.png")


@dataclass(frozen=True, slots=True)
class Point:
    """One bound: milliseconds a ping, and errors of log-odds where both maps say occupied.

    Attributes:
        bound: the setting.
        median_ms: over the pings.
        errors: median, 99th percentile and largest.
        within_share: of the voxels, within the bound.
        class_share: voxels of another class than the exact map's, as a share of the occupied.
    """

    bound: float
    median_ms: float
    errors: tuple[float, float, float]
    within_share: float
    class_share: float


Evidence = tuple[NDArray[np.int64], NDArray[np.float32]]


def integrated(pings: Pings, i: int, resolution_m: float, bound: float) -> tuple[float, Evidence]:
    """Milliseconds of one ping, and its voxels: a number each, in order, and log-odds."""
    mapping = Mapping(error_bound=bound)
    octree, sonar = Octree(voxel_resolution=resolution_m), Sonar(vertical_aperture=APERTURE_DEG)
    sonar_map = SonarMap(Config(sonar=sonar, octree=octree, mapping=mapping))
    echo = pings.echo(i, first_returns_only=False)
    began_s = time.perf_counter()
    sonar_map.integrate(echo, pings.map_T_sonar[i])
    took_ms = 1e3 * (time.perf_counter() - began_s)
    centres_m, log_odds, _ = sonar_map.core.voxels()
    index = np.floor(centres_m / resolution_m).astype(np.int64) + (1 << 20)
    names = index[:, 0] << 42 | index[:, 1] << 21 | index[:, 2]
    order = np.argsort(names)
    return took_ms, (names[order], log_odds[order])


def differences(exact: Evidence, other: Evidence) -> tuple[NDArray[np.float64], int]:
    """Errors where both say occupied, and how many voxels are of another class."""
    _, here, there = np.intersect1d(exact[0], other[0], assume_unique=True, return_indices=True)
    a, b = exact[1][here].astype(float), other[1][there].astype(float)
    both = (a > 0) & (b > 0)
    others = int(np.count_nonzero((a > 0) != (b > 0)))
    others += len(exact[0]) + len(other[0]) - 2 * len(here)
    return np.abs(a - b)[both], others


def sweep(pings: Pings, resolution_m: float) -> list[Point]:
    """All bounds on the same pings."""
    times: dict[float, list[float]] = {bound: [] for bound in BOUNDS}
    errors: dict[float, list[NDArray[np.float64]]] = {bound: [] for bound in BOUNDS}
    others = dict.fromkeys(BOUNDS, 0)
    for i in range(len(pings)):
        took_ms, exact = integrated(pings, i, resolution_m, 0.0)
        times[0.0].append(took_ms)
        for bound in BOUNDS[1:]:
            took_ms, found = integrated(pings, i, resolution_m, bound)
            times[bound].append(took_ms)
            error, other = differences(exact, found)
            errors[bound].append(error)
            others[bound] += other
    points = [Point(0.0, float(np.median(times[0.0])), (0.0, 0.0, 0.0), 1.0, 0.0)]
    for bound in BOUNDS[1:]:
        error = np.concatenate(errors[bound])
        median, p99 = np.quantile(error, (0.5, 0.99))
        points.append(
            Point(
                bound,
                float(np.median(times[bound])),
                (float(median), float(p99), float(error.max())),
                float(np.mean(error <= bound)),
                others[bound] / error.size,
            )
        )
    return points


def table(name: str, points: Sequence[Point]) -> str:
    """Markdown."""
    lines = [
        f"{name}:",
        "",
        "| bound | ms a ping | error, median | 99 % | largest | within the bound | other class |",
        "|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for p in points:
        median, p99, largest = (f"{error:.2g}" for error in p.errors)
        lines.append(
            f"| {p.bound:g} | {p.median_ms:.0f} | {median} | {p99} | {largest} | "
            f"{100 * p.within_share:.2f} % | {100 * p.class_share:.2f} % |"
        )
    return "\n".join([*lines, ""])


def draw(curves: dict[str, list[Point]], file: Path) -> None:
    """Time against error, the default marked."""
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.add_subplot(
        xscale="log",
        yscale="log",
        xlabel="error of one ping's log-odds, 99th percentile",
        ylabel="ms a ping, one thread",
    )
    for name, points in curves.items():
        sampled = points[1:]
        errors = [p.errors[1] for p in sampled]
        (line,) = axes.plot(errors, [p.median_ms for p in sampled], marker="o", label=name)
        axes.axhline(points[0].median_ms, color=line.get_color(), linestyle=":", linewidth=1)
        for p in sampled:
            if p.bound == Mapping().error_bound:
                axes.plot(p.errors[1], p.median_ms, "s", markersize=12, fillstyle="none", color="k")
    axes.set_title("What accuracy costs: error_bound 0.02 to 1; dotted: exact; square: the default")
    axes.grid(visible=True, which="both", alpha=0.25)
    axes.legend()
    FigureCanvasAgg(figure)
    figure.savefig(file, dpi=110)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pings", type=int, default=6)
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    parser.add_argument("--picture", type=Path, default=PICTURE)
    said = parser.parse_args()
    said.out.mkdir(parents=True, exist_ok=True)
    curves: dict[str, list[Point]] = {}
    for setting in SETTINGS:
        if setting.look != DOWN:
            continue
        pings = load(cached(said.out, setting, said.pings, SEED))
        for resolution_m in RESOLUTIONS_M:
            name = f"{setting.range_m:g} m, {100 * resolution_m:g} cm"
            curves[name] = sweep(pings, resolution_m)
            print(table(name, curves[name]), flush=True)
    said.picture.parent.mkdir(parents=True, exist_ok=True)
    draw(curves, said.picture)
    print(f"drawn: {said.picture}")


if __name__ == "__main__":
    main()
