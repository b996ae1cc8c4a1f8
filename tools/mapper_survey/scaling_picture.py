"""The scaling report's picture: speed-up over workers, and what limits it."""

from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from mapper_survey.scaling import LIMITS
from mapper_survey.scaling_record import ScalingRecord

COLOURS = {name: f"C{k}" for k, name in enumerate((*LIMITS, "none alone"))}
SIZE_INCHES = (11.0, 4.6)
DPI = 110


def draw(record: ScalingRecord, path: Path) -> None:
    """Draw into a file; a picture is there whole or not at all."""
    figure, (left, right) = plt.subplots(1, 2, figsize=SIZE_INCHES, layout="constrained")
    _draw_speedups(left, record)
    _draw_limits(right, record)
    unfinished = path.with_name(f"{path.stem}.part{path.suffix}")
    figure.savefig(unfinished, dpi=DPI)
    plt.close(figure)
    unfinished.replace(path)


def _draw_speedups(axes: Axes, record: ScalingRecord) -> None:
    workers = [step.workers for step in record.steps]
    axes.plot(workers, workers, ":", color="0.5", label="ideal")
    axes.plot(workers, [step.speedup for step in record.steps], "-", color="0.3", label="simulated")
    for name, colour in COLOURS.items():
        there = [step for step in record.steps if step.bottleneck == name]
        if there:
            speedups = [step.speedup for step in there]
            label = f"bottleneck: {name}"
            axes.plot([s.workers for s in there], speedups, "o", color=colour, label=label)
    measured = record.measured
    speedups = [run.speedup for run in measured]
    axes.plot([run.workers for run in measured], speedups, "kx", ms=9, mew=2, label="measured")
    axes.set(xscale="log", yscale="log", xlabel="workers", ylabel="speed-up")
    axes.set_title("How much faster than one worker")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize="small")


def _draw_limits(axes: Axes, record: ScalingRecord) -> None:
    workers = [step.workers for step in record.steps]
    for name in LIMITS:
        saved = [100.0 * max(step.saved.get(name, 0.0), 0.0) for step in record.steps]
        axes.plot(workers, saved, "o-", ms=4, color=COLOURS[name], label=name)
    axes.set(xscale="log", xlabel="workers", ylabel="part of the time, %", ylim=(0.0, 100.0))
    axes.set_title("What each limit alone costs")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize="small")
