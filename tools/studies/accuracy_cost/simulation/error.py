"""How far pictures lie from the reference: levels and first returns. Float64, numpy alone."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.scene.sonar import SonarSettings

Picture = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grain:
    """Of speckled pictures.

    Attributes:
        spread_db: standard deviation of the level over its expectation; 5.57 dB is Rayleigh's.
        row_correlation: of neighbouring rows' amplitudes over their expectation.
        spread_chance_db, correlation_chance: standard errors of these; NaN of one picture.
    """

    spread_db: float
    row_correlation: float
    spread_chance_db: float
    correlation_chance: float


def grain_of(levels_db: Sequence[Picture]) -> Grain:
    """Measure the grain of pictures that differ by chance alone.

    Args:
        levels_db: of each picture over the expected level, NaN where nothing shows, (rows, beams).
    """
    spread_db, spread_chance_db = _over(levels_db, _spread_db)
    correlation, correlation_chance = _over(levels_db, _row_correlation)
    return Grain(spread_db, correlation, spread_chance_db, correlation_chance)


def grain_errors(shown: Grain, truth: Grain) -> dict[str, float]:
    """How far one is from the other, and the standard errors of that."""
    return {
        "grain_spread_db": abs(shown.spread_db - truth.spread_db),
        "grain_spread_chance_db": math.hypot(shown.spread_chance_db, truth.spread_chance_db),
        "grain_correlation": abs(shown.row_correlation - truth.row_correlation),
        "grain_correlation_chance": math.hypot(shown.correlation_chance, truth.correlation_chance),
    }


def kept_grain(path: Path, measure: Callable[[], Grain]) -> Grain:
    """A grain from its file, or measured and written there.

    Half of all settings change nothing of the surfaces: theirs is measured once.
    """
    if not path.exists():
        beside = path.with_suffix(f".{os.getpid()}.tmp")
        with beside.open("wb") as file:
            np.save(file, np.array(astuple(measure())))
        beside.replace(path)
    return Grain(*np.load(path).tolist())


def _over(
    levels_db: Sequence[Picture], figure: Callable[[Sequence[Picture]], float]
) -> tuple[float, float]:
    """A figure of all pictures together, and its standard error."""
    of_each = [figure([level_db]) for level_db in levels_db]
    if len(of_each) == 1:
        return figure(levels_db), math.nan
    return figure(levels_db), float(np.std(of_each, ddof=1)) / math.sqrt(len(of_each))


def _spread_db(levels_db: Sequence[Picture]) -> float:
    shown = np.concatenate([level_db[np.isfinite(level_db)] for level_db in levels_db])
    return float(np.std(shown)) if shown.size else math.nan


def _row_correlation(levels_db: Sequence[Picture]) -> float:
    """Of no grain it is 0."""
    pairs = [(level_db[:-1], level_db[1:]) for level_db in levels_db]
    both = [np.isfinite(here) & np.isfinite(beyond) for here, beyond in pairs]
    here, beyond = (
        np.concatenate(
            [10.0 ** (pair[k][shown] / 20.0) for pair, shown in zip(pairs, both, strict=True)]
        )
        for k in (0, 1)
    )
    if not here.size:
        return math.nan
    if np.ptp(here) == 0.0 or np.ptp(beyond) == 0.0:
        return 0.0
    return float(np.corrcoef(here, beyond)[0, 1])


RETURN = 35.0 / 255.0
"""Amplitude of a first return: the threshold of the mapper's own defaults."""


def picture_errors(
    pairs: Sequence[tuple[Picture, Picture]], sonar: SonarSettings
) -> dict[str, float]:
    """Of the pixels and beams of all pictures together.

    Args:
        pairs: expected amplitudes of full scale and the reference's, (rows, beams); NaN in the
            first is not compared.
        sonar: whose pixels they are.
    """
    pairs = [(shown, np.where(np.isnan(shown), np.nan, truth)) for shown, truth in pairs]
    level_db = np.concatenate([level_errors_db(*pair, sonar) for pair in pairs])
    beyond = np.concatenate([beyond_tolerance(*pair, sonar, Tolerance()) for pair in pairs])
    shown_m, truth_m = (
        np.concatenate([first_returns_m(pair[k], sonar.range_resolution_m) for pair in pairs])
        for k in (0, 1)
    )
    both = np.isfinite(shown_m) & np.isfinite(truth_m)
    return_m = np.abs(shown_m - truth_m)[both]
    return {
        "image_rms_db": float(np.sqrt(np.mean(np.square(level_db)))),
        "image_p95_db": float(np.quantile(level_db, 0.95)),
        "beyond_tolerance": float(beyond.mean()),
        "return_median_m": float(np.median(return_m)) if both.any() else float("nan"),
        "return_p95_m": float(np.quantile(return_m, 0.95)) if both.any() else float("nan"),
        "return_missed": float(np.mean(np.isfinite(shown_m) != np.isfinite(truth_m))),
    }


def step(sonar: SonarSettings) -> float:
    """Amplitude of the smallest pixel that is not 0."""
    gamma = sonar.gamma_byte / 255.0 if sonar.gamma_byte else 1.0
    return float((1.0 / (2**sonar.bits - 1)) ** (1.0 / gamma))


def half_step(sonar: SonarSettings) -> float:
    """The most that a pixel of 0 can stand for."""
    gamma = sonar.gamma_byte / 255.0 if sonar.gamma_byte else 1.0
    return float((0.5 / (2**sonar.bits - 1)) ** (1.0 / gamma))


def rounded(picture: Picture, sonar: SonarSettings) -> Picture:
    """As integer pixels hold it; what exceeds full scale is the business of saturation."""
    gamma, scale = (sonar.gamma_byte / 255.0 if sonar.gamma_byte else 1.0), 2**sonar.bits - 1
    pixels = np.rint(scale * picture**gamma)
    return np.asarray((pixels / scale) ** (1.0 / gamma), dtype=np.float64)


def level_errors_db(shown: Picture, truth: Picture, sonar: SonarSettings) -> Picture:
    """|Difference of level| of the pixels that one of the two shows, flat, dB."""
    least = half_step(sonar)
    visible = np.maximum(shown, truth) >= step(sonar)
    ratio = np.maximum(shown[visible], least) / np.maximum(truth[visible], least)
    return np.asarray(np.abs(20.0 * np.log10(ratio)), dtype=np.float64)


def beyond_tolerance(
    shown: Picture, truth: Picture, sonar: SonarSettings, tolerance: Tolerance
) -> NDArray[np.bool_]:
    """Which visible pixels differ too much, however either picture is displaced, flat.

    Displaced by the tolerated part of a cell: an edge may lie there.
    """
    visible = np.maximum(shown, truth) >= step(sonar)
    least = half_step(sonar)
    beyond = np.ones(int(visible.sum()), dtype=np.bool_)
    for still, moved in ((shown, truth), (truth, shown)):
        nearest = np.clip(still, *_displaced_bounds(moved, tolerance.cells))
        ratio = np.maximum(still[visible], least) / np.maximum(nearest[visible], least)
        beyond &= np.abs(20.0 * np.log10(ratio)) > tolerance.level_db
    return beyond


def first_returns_m(picture: Picture, row_m: float) -> Picture:
    """Range of each beam's first rise over the threshold, between rows, NaN without, (beams,)."""
    above = picture >= RETURN
    row = np.argmax(above, axis=0)
    beam = np.arange(picture.shape[1])
    here, before = picture[row, beam], picture[np.maximum(row - 1, 0), beam]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(row > 0, (RETURN - before) / (here - before), 0.0)
    return np.where(above.any(axis=0), (row - 0.5 + part) * row_m, np.nan)


def _displaced_bounds(picture: Picture, cells: float) -> tuple[Picture, Picture]:
    """Least and greatest amplitude that a displacement of up to so many cells brings to a pixel."""
    low = high = np.square(picture)
    for axis in (0, 1):
        low = low + cells * (_neighbours(low, axis, np.minimum) - low)
        high = high + cells * (_neighbours(high, axis, np.maximum) - high)
    return np.sqrt(low), np.sqrt(high)


def _neighbours(picture: Picture, axis: int, which: np.ufunc) -> Picture:
    """The least or greatest of each pixel and its two neighbours along an axis."""
    along = picture if axis == 0 else picture.T
    found = along.copy()
    which(found[1:], along[:-1], out=found[1:])
    which(found[:-1], along[1:], out=found[:-1])
    return found if axis == 0 else found.T
