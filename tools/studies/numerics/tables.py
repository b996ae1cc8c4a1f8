"""The tables of docs/reports/numerical-stability.md that are measured."""

from collections.abc import Sequence

import numpy as np

from studies.numerics.panel import Panel
from studies.numerics.place import Measured, Place
from studies.numerics.sources import NOT_MEASURED

__all__ = ["growth_table", "places_table", "unmeasured_table"]


def growth_table(panels: Sequence[Panel]) -> str:
    """Errors after a tenth, and after all, of the updates."""
    rows = [
        "| what is updated | how | unit | after a thousandth | after all | judged by |",
        "|---|---|---|---:|---:|---|",
    ]
    for panel in panels:
        early = int(np.searchsorted(panel.updates, panel.updates[-1] // 1000))
        for curve in panel.curves:
            ends = " | ".join(_number(curve.error[place]) for place in (early, -1))
            rows.append(
                f"| {panel.title} | {curve.label} | {panel.unit} | {ends} | {panel.oracle} |"
            )
    return "\n".join(rows)


def _number(error: float) -> str:
    return "no number" if not np.isfinite(error) else f"{error:.1e}" if error else "0"


def places_table(measured: Sequence[tuple[Place, Measured]]) -> str:
    """Where single precision is, and what it costs."""
    rows = [
        "| where | what | worst error | so | why it is enough | measured |",
        "|---|---|---|---|---|---|",
    ]
    rows += [
        f"| {place.where} | {place.what} | {found.worst} | {found.so} | {place.enough} | "
        f"{f'in numpy: {place.numpy}' if place.numpy else 'of the product'} |"
        for place, found in measured
    ]
    return "\n".join(rows)


def unmeasured_table() -> str:
    """Sources with single precision that no row measures, and why not."""
    rows = ["| not measured | why |", "|---|---|"]
    return "\n".join(
        [*rows, *(f"| {_names(files)} | {reason} |" for reason, files in NOT_MEASURED.items())]
    )


def _names(files: Sequence[str]) -> str:
    """Those of one folder by that."""
    folder = files[0].rpartition("/")[0]
    many = len(files) > 1 and all(name.rpartition("/")[0] == folder for name in files)
    return f"{len(files)} of `{folder}`" if many else ", ".join(f"`{name}`" for name in files)
