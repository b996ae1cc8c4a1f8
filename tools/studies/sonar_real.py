"""Draw a recorded sonar beside the same sonar simulated: out/simulator-real.png.

The recording is three pings of an M1200d at 2.1 MHz from the public repository liboculus
(test/data/three_pings_8bit.raw). Exit code 1: some number of the two differs by more than allowed.
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sonar_sim.validation.alike import CLASS_REFERENCE, CLASSES, EVEN_ROWS, LINE_BLOCK, compare
from sonar_sim.validation.recording import (
    BAND_ROWS,
    Recorded,
    band_centres_m,
    noise_level_db,
    noisy_bands,
    read_recording,
    simulate_recording,
    usual_floor_db,
)
from sonar_sim.validation.statistics import (
    beam_correlation,
    class_correlation,
    flat_blocks,
    linear_amplitude,
    ping_correlation,
    row_correlation,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROOT = Path(__file__).resolve().parents[2]
REAL, SIMULATED = "#1f3b73", "#d1711c"
Both = dict[str, NDArray[np.uint8]]
COLOURS = {"recorded": REAL, "simulated": SIMULATED}


def main() -> int:
    """Compare, print the table, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = ROOT.parent / "shared" / "data" / "oculus" / "three_pings_8bit.raw"
    parser.add_argument("recording", type=Path, nargs="?", default=default)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "simulator-real.png")
    arguments = parser.parse_args()
    recorded = read_recording(arguments.recording)
    both = {"recorded": recorded.pixels, "simulated": simulate_recording(recorded)}
    numbers = compare(recorded, both["simulated"])
    print(f"{'':38} reference  recorded  simulated  tolerance")
    for n in numbers:
        reference = "" if n.reference is None else f"{n.reference:.4g}"
        verdict = "" if n.holds else "  DIFFERS"
        print(
            f"{n.what:38} {reference:>9} {n.real:9.4f} {n.simulated:10.4f} "
            f"{n.tolerance:10.3f}{verdict}"
        )
    draw(arguments.out, recorded, both)
    return 0 if all(n.holds for n in numbers) else 1


def draw(path: Path, recorded: Recorded, both: Both) -> None:
    """Two pictures and six graphs."""
    figure = Figure(figsize=(16.0, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, 4)
    for axes, (name, pixels) in zip((grid[0, 0], grid[1, 0]), both.items(), strict=True):
        _picture(axes, recorded, pixels[0], name)
    graphs = (_amplitudes, _pings_by_level, _pings_by_range, _beams, _rows, _floor)
    for axes, graph in zip(grid[:, 1:].ravel(), graphs, strict=True):
        graph(axes, recorded, both)
        axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


def _picture(axes: "Axes", recorded: Recorded, pixels: NDArray[np.uint8], name: str) -> None:
    sonar = recorded.sonar
    steps = (np.append(recorded.bearings_deg, recorded.bearings_deg[-1]) * np.pi / 180.0)[None]
    range_m = (np.arange(sonar.rows + 1) * sonar.range_resolution_m)[:, None]
    axes.pcolormesh(
        range_m * np.sin(steps), range_m * np.cos(steps), pixels, cmap="inferno", vmin=0, vmax=255
    )
    axes.set_aspect("equal")
    axes.set_title(f"{name}: pixels")
    axes.set_xlabel("starboard, m")
    axes.set_ylabel("ahead, m")


def _amplitudes(axes: "Axes", recorded: Recorded, both: Both) -> None:
    for name, pixels in both.items():
        patch = np.concatenate([flat_blocks(p, recorded.sonar.gamma_byte) for p in pixels]).ravel()
        axes.hist(
            patch / np.sqrt(np.mean(np.square(patch))),
            bins=64,
            range=(0.0, 3.2),
            density=True,
            histtype="step",
            color=COLOURS[name],
            label=f"{name}, flat patches",
        )
    a = np.linspace(0.0, 3.2, 200)
    axes.plot(a, 2.0 * a * np.exp(-np.square(a)), "k:", lw=1.0, label="Rayleigh")
    axes.set_xlabel("amplitude over rms")
    axes.set_ylabel("density")
    axes.set_title("speckle")


def _pings_by_level(axes: "Axes", recorded: Recorded, both: Both) -> None:
    place = np.arange(len(CLASSES))
    for shift, (name, pixels) in zip((-0.2, 0.2), both.items(), strict=True):
        amplitude = list(linear_amplitude(pixels, recorded.sonar.gamma_byte))
        found = [class_correlation(amplitude, list(pixels), *bounds) for bounds in CLASSES]
        axes.bar(place + shift, found, 0.38, color=COLOURS[name], label=name)
    axes.plot(place, CLASS_REFERENCE, "k_", ms=24, label="recorded, reference")
    axes.set_xticks(place, [f"{low:g}" for low, _ in CLASSES])
    axes.set_xlabel("mean pixel, from")
    axes.set_ylabel("correlation of amplitude")
    axes.set_title("ping to ping, by level")


def _pings_by_range(axes: "Axes", recorded: Recorded, both: Both) -> None:
    starts = range(0, recorded.sonar.rows - 2 * BAND_ROWS, BAND_ROWS)
    middle_m = (np.array(starts) + BAND_ROWS) * recorded.sonar.range_resolution_m
    for name, pixels in both.items():
        amplitude = linear_amplitude(pixels, recorded.sonar.gamma_byte)
        found = [
            ping_correlation([ping[start : start + 2 * BAND_ROWS] for ping in amplitude])
            for start in starts
        ]
        axes.plot(middle_m, found, "o-", ms=3, lw=1.0, color=COLOURS[name], label=name)
    axes.set_xlabel("range, m")
    axes.set_ylabel("correlation of amplitude")
    axes.set_title("ping to ping, by range")


def _beams(axes: "Axes", recorded: Recorded, both: Both) -> None:
    for name, pixels in both.items():
        amplitude = linear_amplitude(pixels, recorded.sonar.gamma_byte)
        found = [
            np.mean([beam_correlation(ping[EVEN_ROWS], lag) for ping in amplitude])
            for lag in range(1, 7)
        ]
        axes.plot(range(1, 7), found, "o-", ms=4, lw=1.0, color=COLOURS[name], label=name)
    axes.axhspan(0.61, 0.65, color="0.85", label="recorded, reference, lag 1")
    axes.set_xlabel("lag, beams")
    axes.set_ylabel("correlation of amplitude")
    axes.set_title("beam to beam, far half")


def _rows(axes: "Axes", recorded: Recorded, both: Both) -> None:
    for name, pixels in both.items():
        amplitude = linear_amplitude(pixels, recorded.sonar.gamma_byte)
        for rows, style, part in (
            (slice(None), "o-", "whole picture"),
            (EVEN_ROWS, "o:", "far half"),
        ):
            found = [
                np.mean([row_correlation(ping[rows], lag, LINE_BLOCK) for ping in amplitude])
                for lag in range(1, 5)
            ]
            axes.plot(
                range(1, 5),
                found,
                style,
                ms=4,
                lw=1.0,
                color=COLOURS[name],
                label=f"{name}, {part}",
            )
    axes.plot((1, 2), (0.19, 0.04), "k_", ms=24, label="recorded, reference")
    axes.set_xlabel("lag, range lines")
    axes.set_ylabel("correlation of amplitude")
    axes.set_title("line to line")


def _floor(axes: "Axes", recorded: Recorded, both: Both) -> None:
    range_m = band_centres_m(recorded.sonar)
    noisy = noisy_bands(recorded.sonar)
    for name, pixels in both.items():
        level_db = noise_level_db(pixels, recorded.sonar.gamma_byte)
        axes.plot(range_m, level_db, lw=0.6, color=COLOURS[name])
        axes.plot(range_m[noisy], level_db[noisy], "o", ms=4, color=COLOURS[name], label=name)
    usual = usual_floor_db(recorded)
    axes.plot(range_m[2:], usual[2:], "k:", lw=1.0, label="30 log R + 2 alpha R")
    axes.set_xlabel("range, m")
    axes.set_ylabel("dB of full scale")
    axes.set_title("changing from ping to ping (dots: noise)")


if __name__ == "__main__":
    sys.exit(main())
