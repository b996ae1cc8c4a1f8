"""The two ways in which a rule decides: by level, and by displacement."""

import math

from sonar_sim.effects.effect import Verdict
from sonar_sim.tolerance import Tolerance

ROW_CORRELATION = 0.19
"""Of the powers of neighbouring rows of speckle, as a public recording shows."""
LEVEL_SPREAD_DB = 5.57
"""Standard deviation of speckle's level."""


def by_level(predicted_db: float, tolerance: Tolerance, reason: str) -> Verdict:
    """On if the picture would change by more than the tolerated level."""
    return Verdict(predicted_db > tolerance.level_db, reason, predicted_db)


def by_cells(cells: float, tolerance: Tolerance, reason: str) -> Verdict:
    """On if the picture would be displaced by more than the tolerated part of a cell."""
    return Verdict(cells > tolerance.cells, f"{reason}: {cells:.2g} cells", displaced_db(cells))


def displaced_db(cells: float) -> float:
    """Rms difference of level between speckle and the same speckle displaced.

    Two levels of spread 5.57 dB whose correlation falls with the displacement as rows' does.
    """
    correlation = ROW_CORRELATION ** (cells**2)
    return LEVEL_SPREAD_DB * math.sqrt(2.0 * (1.0 - correlation))
