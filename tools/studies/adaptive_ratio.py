"""What `adaptive.min_ratio` buys and costs: pings until a changed voxel is seen, and false alarms.

Draws docs/images/adaptive-ratio.png and prints the tables of docs/reports/mapping.md, in about two
minutes. The rule is the map's own, through `mapperd.ProbabilityUpdater`, with the defaults of the
settings. The original rule's way back is computed in real numbers: the map holds log-odds in 16
bits, and rounds most of its steps to nothing.

Usage: python -m studies adaptive-ratio [--picture FILE]
"""

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mapperd import ProbabilityUpdater
from mapperd.config.tree import Config

PICTURE = Path("docs/images/adaptive-ratio.png")
DEFAULTS = Config()
PUBLISHED, DEFAULT = 0.0, DEFAULTS.adaptive.min_ratio
OCCUPIED, FREE = DEFAULTS.mapping.occupied_threshold, DEFAULTS.mapping.free_threshold
FULL = 255.0
MIDDLE = (DEFAULTS.filtering.intensity_threshold + FULL) / 2
"""Intensity half way between the threshold and the maximum: w = 0.5."""

PROMISED_PINGS = 30
BEFORE = (1, 2, 5, 30, 1000)
INTENSITIES = (36.0, 90.0, MIDDLE, 200.0, FULL)
NOISE = (0.001, 0.01, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5)
NOISY_VOXELS, NOISY_PINGS = 256, 10_000
GIVEN_UP = 10_000_000


def updater_of(min_ratio: float) -> ProbabilityUpdater:
    """An empty map under the settings' default rule, but for `adaptive.min_ratio`."""
    updater, iwlo, adaptive = ProbabilityUpdater(), DEFAULTS.iwlo, DEFAULTS.adaptive
    updater.set_log_odds_params(iwlo.L_occ, iwlo.L_free)
    updater.set_iwlo_params(iwlo.sharpness, iwlo.decay_rate, iwlo.min_alpha, iwlo.L_min, iwlo.L_max)
    updater.set_intensity_params(DEFAULTS.filtering.intensity_threshold, iwlo.intensity_max)
    updater.set_adaptive_params(adaptive.update, adaptive.threshold, adaptive.max_ratio, min_ratio)
    return updater


def probability_after(min_ratio: float, history: Sequence[tuple[int, float]]) -> float:
    """Probability of one voxel after runs of equal pings: (pings, intensity; 0 is free)."""
    updater = updater_of(min_ratio)
    intensities = np.repeat([i for _, i in history], [n for n, _ in history])
    points = np.zeros((intensities.size, 3))
    updater.batch_update_iwlo(points, intensities, intensities > 0)
    return float(updater.get_occupied_voxels(0)[0, 3])


def first_true(holds: Callable[[int], bool]) -> int:
    """The least whole number from 1 at which a condition, once true always true, holds."""
    above = 1
    while not holds(above):
        above *= 2
        if above > GIVEN_UP:
            raise ValueError(f"not within {GIVEN_UP} pings")
    below = above // 2
    while above - below > 1:
        middle = (above + below) // 2
        below, above = (below, middle) if holds(middle) else (middle, above)
    return above


@cache
def pings_to_occupied(min_ratio: float, free_before: int, intensity: float = MIDDLE) -> int:
    """Count the pings until a voxel becomes occupied in the map, after pings that saw it free."""
    return first_true(
        lambda n: probability_after(min_ratio, [(free_before, 0), (n, intensity)]) > OCCUPIED
    )


@cache
def published_pings_to_occupied(free_before: int, intensity: float = MIDDLE) -> int:
    """The same by the original rule, in double precision."""
    iwlo, adaptive = DEFAULTS.iwlo, DEFAULTS.adaptive
    threshold = DEFAULTS.filtering.intensity_threshold
    share = (intensity - threshold) / (iwlo.intensity_max - threshold)
    full = iwlo.L_occ / (1.0 + math.exp(-iwlo.sharpness * (share - 0.5)))

    def alpha(count: int) -> float:
        return max(iwlo.min_alpha, 1.0 / (1.0 + iwlo.decay_rate * count))

    log_odds = 0.0
    for count in range(free_before):
        log_odds = max(log_odds + iwlo.L_free * alpha(count), iwlo.L_min)
    for pings in range(1, GIVEN_UP):
        p = 1.0 / (1.0 + math.exp(-log_odds))
        scale = 1.0 if p >= adaptive.threshold else p / adaptive.threshold * adaptive.max_ratio
        log_odds += full * alpha(free_before + pings - 1) * scale
        if 1.0 / (1.0 + math.exp(-log_odds)) > OCCUPIED:
            return pings
    raise ValueError(f"not within {GIVEN_UP} pings")


def pings_to_free(min_ratio: float, occupied_before: int, intensity: float = MIDDLE) -> int:
    """The other way round."""
    return first_true(
        lambda n: probability_after(min_ratio, [(occupied_before, intensity), (n, 0)]) < FREE
    )


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """Voxels of free water that returns are falsely seen in: shares, 0 to 1.

    Attributes:
        ever: of the voxels, occupied after any ping.
        time: of all pings of all voxels, occupied after it.
    """

    ever: float
    time: float


def false_alarms(
    min_ratio: float,
    rate: float,
    free_before: int,
    *,
    voxels: int = NOISY_VOXELS,
    pings: int = NOISY_PINGS,
    seed: int = 1,
) -> FalseAlarms:
    """Let each ping find each voxel occupied, at full intensity, with a probability of `rate`."""
    generator, updater = np.random.default_rng(seed), updater_of(min_ratio)
    edge_m = updater.get_resolution()
    cells = np.stack([np.arange(voxels) % 16, np.arange(voxels) // 16, np.zeros(voxels)], axis=1)
    points = (cells + 0.5) * edge_m
    for _ in range(free_before):
        updater.batch_update_iwlo(points, np.zeros(voxels), np.zeros(voxels, dtype=bool))
    ever, occupied_pings = np.zeros(voxels, dtype=bool), 0
    for _ in range(pings):
        seen = generator.random(voxels) < rate
        updater.batch_update_iwlo(points, FULL * seen, seen)
        x, y = (updater.get_occupied_voxels(OCCUPIED)[:, :2] // edge_m).astype(int).T
        ever[x + 16 * y] = True
        occupied_pings += x.size
    return FalseAlarms(float(ever.mean()), occupied_pings / (voxels * pings))


def reclassification_table() -> list[str]:
    """Pings to see a change, as Markdown: one row a number of contrary pings before it."""
    rows = [
        "| pings before | free to occupied, published | now | occupied to free, both |",
        "|---:|---:|---:|---:|",
    ]
    for before in BEFORE:
        published = published_pings_to_occupied(before)
        now = pings_to_occupied(DEFAULT, before)
        back = pings_to_free(DEFAULT, before)
        rows.append(f"| {before} | {_spaced(published)} | {now} | {back} |")
    return rows


def intensity_table() -> list[str]:
    """Pings until a voxel that was seen free 1000 times is occupied, by intensity."""
    rows = ["| intensity | " + " | ".join(f"{i:g}" for i in INTENSITIES) + " |"]
    rows.append("|---|" + "---:|" * len(INTENSITIES))
    published = [_spaced(published_pings_to_occupied(BEFORE[-1], i)) for i in INTENSITIES]
    now = [_spaced(pings_to_occupied(DEFAULT, BEFORE[-1], i)) for i in INTENSITIES]
    rows += ["| published | " + " | ".join(published) + " |", "| now | " + " | ".join(now) + " |"]
    return rows


def burst_table() -> list[str]:
    """One false return at full intensity: the probability after it, and how many it takes."""
    rows = [
        "| free pings before | after one, published | after one, now | it takes now |",
        "|---:|---:|---:|---:|",
    ]
    for before in (0, *BEFORE):
        once = [probability_after(r, [(before, 0), (1, FULL)]) for r in (PUBLISHED, DEFAULT)]
        taken = pings_to_occupied(DEFAULT, before, FULL)
        rows.append(f"| {before} | {once[0]:.2g} | {once[1]:.2g} | {taken} |")
    return rows


def noise_table(alarms: dict[float, list[FalseAlarms]]) -> list[str]:
    """Noise at full intensity, as Markdown; `alarms` by min_ratio, in the order of NOISE."""
    rows = [
        "| false returns | ever, published | ever, now | of the time, published | now |",
        "|---:|---:|---:|---:|---:|",
    ]
    for rate, *each in zip(NOISE, alarms[PUBLISHED], alarms[DEFAULT], strict=True):
        rows.append(noise_row(rate, each))
    return rows


def noise_row(rate: float, alarms: Sequence[FalseAlarms]) -> str:
    """One row of it: the original rule and ours."""
    shares = [*(alarm.ever for alarm in alarms), *(alarm.time for alarm in alarms)]
    return f"| {100 * rate:g} % | " + " | ".join(f"{100 * s:.3g} %" for s in shares) + " |"


def _spaced(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def draw(path: Path, alarms: dict[float, list[FalseAlarms]]) -> None:
    """Write the picture: how far the promise reaches, why this default, and what it costs."""
    figure = Figure(figsize=(15.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    reach, choice, cost = figure.subplots(1, 3)
    _draw_reach(reach)
    _draw_choice(choice)
    _draw_cost(cost, alarms)
    for axes in (reach, choice, cost):
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


def _draw_reach(axes: Axes) -> None:
    before = (1, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50, 100, 200, 500, 1000)
    published = [published_pings_to_occupied(n) for n in before]
    axes.loglog(before, published, "C3o-", markersize=4, label="free to occupied, original rule")
    now = [pings_to_occupied(DEFAULT, n) for n in before]
    name = f"free to occupied, min_ratio {DEFAULT:g}"
    axes.loglog(before, now, "C0o-", markersize=4, label=name)
    back = [pings_to_free(DEFAULT, n) for n in before]
    axes.loglog(before, back, "--", color="0.5", label="occupied to free, both rules")
    _promise(axes)
    axes.set_ylim(1, 1e6)
    axes.set_xlabel("pings before the change")
    axes.set_ylabel("pings until the map shows the change")
    axes.set_title(f"How long a change takes to show (intensity {MIDDLE:g})")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.legend(loc="upper right", bbox_to_anchor=(1.0, 0.8), fontsize=9)


def _draw_choice(axes: Axes) -> None:
    ratios = np.linspace(0.02, DEFAULTS.adaptive.max_ratio, 29)
    for n, colour in zip(BEFORE, ("C9", "C2", "C1", "C4", "C0"), strict=True):
        pings = [pings_to_occupied(float(ratio), n) for ratio in ratios]
        axes.semilogy(ratios, pings, color=colour, label="once" if n == 1 else f"{n} times")
    _promise(axes)
    axes.axvline(DEFAULT, color="0.3", linestyle=":")
    axes.text(DEFAULT, 5.3, "default ", ha="right", color="0.3")
    axes.set_ylim(5, 400)
    axes.set_xlabel("adaptive.min_ratio")
    axes.set_ylabel("pings until occupied")
    axes.set_title(f"Why {DEFAULT:g} (intensity {MIDDLE:g})")
    axes.set_yticks((10, 30, 100, 300), labels=("10", "30", "100", "300"))
    axes.legend(title="seen free before", loc="upper right", bbox_to_anchor=(0.8, 1.0), fontsize=9)


def _draw_cost(axes: Axes, alarms: dict[float, list[FalseAlarms]]) -> None:
    percent = 100 * np.array(NOISE)
    for ratio, colour in ((PUBLISHED, "C3"), (DEFAULT, "C0")):
        name = f"min_ratio {ratio:g}" if ratio else "original rule (0)"
        time = [100 * alarm.time for alarm in alarms[ratio]]
        ever = [100 * alarm.ever for alarm in alarms[ratio]]
        axes.plot(percent, time, f"{colour}-o", markersize=4)
        axes.plot(percent, ever, f"{colour}:")
        axes.text(percent[-1], 8 if ratio == PUBLISHED else 60, name, color=colour, ha="right")
    axes.text(percent[-1], 52, "line: of the time\ndots: at any time", ha="right", va="top")
    axes.set_ylim(-5, 105)
    axes.set_xlabel("pings with a false return at full intensity, %")
    axes.set_ylabel("free voxels shown occupied, %")
    axes.set_title(f"What noise does ({NOISY_VOXELS} voxels, {_spaced(NOISY_PINGS)} pings)")


def _promise(axes: Axes) -> None:
    axes.axhline(PROMISED_PINGS, color="k", linewidth=1.0, linestyle="--")
    axes.text(0.01, PROMISED_PINGS * 1.05, f"{PROMISED_PINGS} pings",
              transform=axes.get_yaxis_transform(), va="bottom", fontsize=9)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> None:
    """Print the tables and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--picture", type=Path, default=PICTURE)
    args = parser.parse_args(argv)
    alarms = {
        ratio: [false_alarms(ratio, rate, PROMISED_PINGS) for rate in NOISE]
        for ratio in (PUBLISHED, DEFAULT)
    }
    tables = (reclassification_table(), intensity_table(), burst_table(), noise_table(alarms))
    print("\n\n".join("\n".join(table) for table in tables))
    draw(args.picture, alarms)


if __name__ == "__main__":
    main()
