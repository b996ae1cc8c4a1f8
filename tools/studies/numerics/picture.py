"""Errors over updates, drawn."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image

from studies.numerics.panel import Panel

__all__ = ["draw"]

OURS, OTHERS = "#1f5f8b", ("#c8553d", "#d9a441")
COLOURS = 64
"""Of the picture: enough for lines and text, and a third of the bytes."""


def draw(panels: Sequence[Panel], file: Path) -> None:
    """A picture of all panels, two side by side."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415 after the backend is chosen

    rows = -(-len(panels) // 2)
    figure, axes = plt.subplots(rows, 2, figsize=(11, 3.5 * rows), constrained_layout=True)
    for axis, panel in zip(np.ravel(axes), panels, strict=False):
        others = iter(OTHERS)
        bottom = _bottom(panel)
        for curve in panel.curves:
            colour = OURS if curve.ours else next(others)
            shown = np.where(curve.error == 0.0, bottom, curve.error)
            axis.plot(panel.updates, shown, color=colour, label=curve.label, lw=1.4)
        axis.set(xscale="log", yscale="log", xlabel="updates", ylabel=f"error, {panel.unit}")
        axis.set_title(panel.title, fontsize=10)
        axis.set_ylim(bottom=bottom)
        axis.grid(visible=True, alpha=0.25)
        axis.legend(fontsize=7.5, loc="best")
    file.parent.mkdir(parents=True, exist_ok=True)
    drawn = BytesIO()
    figure.savefig(drawn, dpi=75)
    plt.close(figure)
    Image.open(drawn).convert("RGB").quantize(COLOURS).save(file, optimize=True)


def _bottom(panel: Panel) -> float:
    """Under the least error that is any; an error of nothing is drawn there."""
    errors = np.concatenate([curve.error for curve in panel.curves])
    return float(errors[errors > 0].min()) / 10
