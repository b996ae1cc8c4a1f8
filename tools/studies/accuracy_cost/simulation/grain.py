"""Speckle of pings beside what is expected of them: over several random seeds, as it is chance.

An echo's intensity over its expectation follows a law (exponential, where many scatterers add up);
one ping is one sample of it. The same ping is made with surfaces of several random seeds, all their
cells are one sample, and how much the figures of single seeds differ says how sure its figures are.
"""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
