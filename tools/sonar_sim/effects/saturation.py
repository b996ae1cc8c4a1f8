"""Saturation: what is louder than full scale looks like full scale."""

import math

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.picture_change import expected_clipped, level_change_db
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance

UNCLIPPED = 0.5
"""Amplitude of full scale, rms, below which clipping takes less than 0.05 dB."""
ROW_LEAK = 0.24
"""Part of a row's amplitude in each neighbour (see `range_spread`)."""


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if speckle's peaks are clipped so that what is expected of a pixel falls.

    A flash is thin, and brighter than its mean over a coarse row: rows are those of the sonar.
    """
    brighter = 10.0 ** (tolerance.brighter_db / 20.0)
    loudest = float(view.amplitude.max(initial=0.0)) * brighter
    loudest_db = 20.0 * math.log10(max(loudest, 1e-6))
    reason = f"the loudest echo is at {loudest_db:+.0f} dB of full scale"
    if loudest * math.sqrt(view.fine.grid.rows / view.grid.rows) <= UNCLIPPED:
        return by_level(0.0, tolerance, reason)
    sonar = view.sonar
    shown = view.fine.gains.amplitude(_spread(view.fine.picture)) * brighter
    cells = (
        tolerance.cells * shown.shape[0] / sonar.rows,
        tolerance.cells * shown.shape[1] / sonar.beams,
    )
    limited = expected_clipped(shown)
    # To clip costs next to nothing.
    predicted_db = level_change_db(limited, shown, sonar, 0.0, cells)
    return by_level(predicted_db, tolerance, reason)


def _spread(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """With what a loud row leaks into its neighbours."""
    spread = picture.copy()
    spread[1:] += ROW_LEAK**2 * picture[:-1]
    spread[:-1] += ROW_LEAK**2 * picture[1:]
    return spread


def configure(physics: Physics, view: View) -> None:
    """Clip."""
    del view
    physics.saturation = True


EFFECT = Effect(
    name="saturation",
    does="cuts bright echoes off at full scale",
    needs="gains",
    formula="min(amplitude, full scale); of speckle of rms m expected m erf(1 / m)",
    source="the converter's end",
    rule="clipped speckle lowers any pixel's expected level by more than the tolerance",
    cost=Cost.CELL,
    parameters=(Parameter("sonar.gain_percent", "%", "the operator's gain"),),
    decide=decide,
    configure=configure,
    anywhere=True,
)
