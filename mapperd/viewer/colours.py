"""Colours of cells, and their legend."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mapperd.viewer.chunks import ChunkSurface, points_m

__all__ = [
    "MODES",
    "Legend",
    "Mode",
    "Scale",
    "colours_of",
    "legend_of",
    "linear",
    "shaded",
    "values_of",
]

Mode = Literal["height", "probability", "age", "count"]
MODES: tuple[Mode, ...] = ("height", "probability", "age", "count")

LIGHT = np.array([0.35, -0.5, 0.79], np.float32)
"""Direction to the light: unit vector, map frame."""

DARKEST = 0.62

MIN = 1e-3
"""Minimum of logarithmic scales."""

_PARTS = np.arange(256) / 255
_TOE = 0.04045
_LINEAR = (
    np.where(_PARTS <= _TOE, _PARTS / 12.92, ((_PARTS + 0.055) / 1.055) ** 2.4) * 255 + 0.5
).astype(np.uint8)

_MAPS = {"height": "turbo", "probability": "viridis", "age": "plasma_r", "count": "cividis"}
_STEPS = 256
TICKS = 5


@dataclass(frozen=True, slots=True)
class Scale:
    """Mapping from values to colours.

    Attributes:
        mode: value to show.
        low, high: values at the ends of the colour map.
    """

    mode: Mode
    low: float
    high: float

    @property
    def logarithmic(self) -> bool:
        """Whether the scale is logarithmic: ages and counts span decades."""
        return self.mode in ("age", "count")


@dataclass(frozen=True, slots=True)
class Legend:
    """Legend of a colour scale.

    Attributes:
        title: title with the unit.
        ticks: labels from low to high, evenly spaced.
        colours: colours of the bar from low to high, `#rrggbb`.
    """

    title: str
    ticks: tuple[str, ...]
    colours: tuple[str, ...]


def values_of(drawn: ChunkSurface, mode: Mode, now_ns: int) -> NDArray[np.float64]:
    """Value of each cell: z in m, probability, age in s, or number of observations."""
    if mode == "height":
        return points_m(drawn)[:, 2]
    if mode == "probability":
        return drawn.probability.astype(np.float64)
    if mode == "age":
        return np.maximum(now_ns - drawn.changed_ns, 0) / 1e9
    return drawn.count.astype(np.float64)


def colours_of(values: NDArray[np.float64], scale: Scale) -> NDArray[np.uint8]:
    """Colours (N, 3) of values (N,), clamped to the ends of the scale."""
    low, high = _ends(scale)
    if scale.logarithmic:
        values = np.log(np.maximum(values, MIN))
    part = (values - low) / max(high - low, 1e-9)
    row = np.clip(part * (_STEPS - 1) + 0.5, 0, _STEPS - 1).astype(np.intp)
    return np.asarray(_table(scale.mode)[row])


def shaded(colours: NDArray[np.uint8], normals: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Shade colours by normals, so that points look like surfaces."""
    light = DARKEST + (1 - DARKEST) * np.clip(0.5 + 0.5 * (normals @ LIGHT), 0, 1)
    return np.asarray((colours * light[:, None] + 0.5).astype(np.uint8))


def linear(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert sRGB to linear light, as lit meshes need it (IEC 61966-2-1)."""
    return np.asarray(_LINEAR[colours])


def legend_of(scale: Scale) -> Legend:
    """Legend of a scale."""
    titles = {
        "height": "height z (m)",
        "probability": "probability",
        "age": "last change",
        "count": "observations",
    }
    values = np.linspace(*_ends(scale), TICKS)
    if scale.logarithmic:
        values = np.exp(values)
    texts = tuple(_text(float(value), scale.mode) for value in values)
    table = _table(scale.mode)[np.linspace(0, _STEPS - 1, 16).astype(np.intp)]
    return Legend(
        titles[scale.mode], texts, tuple(f"#{r:02x}{g:02x}{b:02x}" for r, g, b in table.tolist())
    )


def _ends(scale: Scale) -> tuple[float, float]:
    """Ends of the scale, as logarithms if it is logarithmic."""
    if not scale.logarithmic:
        return scale.low, scale.high
    return math.log(max(scale.low, MIN)), math.log(max(scale.high, MIN))


def _text(value: float, mode: Mode) -> str:
    if mode == "age":
        return f"{value:.0f} s" if value < 100 else f"{value / 60:.0f} min"  # noqa: PLR2004 read
    if mode == "count":
        return f"{value:.0f}"
    return f"{value:.2f}" if mode == "probability" else f"{value:.1f}"


_tables: dict[str, NDArray[np.uint8]] = {}


def _table(mode: Mode) -> NDArray[np.uint8]:
    """256 colours (256, 3)."""
    if mode not in _tables:
        import matplotlib as mpl  # noqa: PLC0415 of the extra `topside`

        rgba = mpl.colormaps[_MAPS[mode]](np.linspace(0, 1, _STEPS))
        _tables[mode] = (rgba[:, :3] * 255 + 0.5).astype(np.uint8)
    return _tables[mode]
