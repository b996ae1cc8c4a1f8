"""An effect: a formula with its source, a rule that decides on it, and its settings."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.preview import PingPreview
from sonar_sim.propagation.physics import Physics


class Cost(Enum):
    """What an effect's work grows with."""

    FREE = "free"
    ROW = "a table over the rows"
    CELL = "every cell"
    SCATTERER = "every scatterer"
    RAY = "every ray"
    CAST = "one more cast of the rays"


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A number that an effect takes.

    Attributes:
        name: where the number is given, such as `water.temperature_c`.
        unit: of the number; "1" for a ratio.
        meaning: in a few words.
    """

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class RuleResult:
    """A rule's result for one ping.

    Attributes:
        on: whether the ping calls for the effect.
        reason: the numbers that decided.
        predicted_db: how much the picture would change without the effect. For an effect that
            displaces the picture, what the displacement does to its speckle.
    """

    on: bool
    reason: str
    predicted_db: float


@dataclass(frozen=True, slots=True)
class Effect:
    """One physical effect.

    Attributes:
        name: as in `--effects`.
        does: to the picture, in a sentence.
        needs: from scene, water, sonar or motion.
        formula: in the units of `parameters`.
        source: of the formula.
        rule: when it is computed.
        cost: what its work grows with.
        parameters: numbers it takes.
        decide: the rule, as a function of what is known before the ping is computed.
        configure: fills in the effect's own fields of the settings.
        anywhere: whether a change of any single pixel calls for it: the effect costs next to
            nothing, and what it changes may be small but all that there is to see.
    """

    name: str
    does: str
    needs: str
    formula: str
    source: str
    rule: str
    cost: Cost
    parameters: tuple[EffectParameter, ...]
    decide: Callable[[PingPreview, Tolerance], RuleResult]
    configure: Callable[[Physics, PingPreview], None]
    anywhere: bool = False


ROW_CORRELATION = 0.19
"""Of the powers of neighbouring rows of speckle, as a public recording shows."""
LEVEL_SPREAD_DB = 5.57
"""Standard deviation of speckle's level."""


def by_level(predicted_db: float, tolerance: Tolerance, reason: str) -> RuleResult:
    """On if the picture would change by more than the tolerated level."""
    return RuleResult(predicted_db > tolerance.level_db, reason, predicted_db)


def by_cells(cells: float, tolerance: Tolerance, reason: str) -> RuleResult:
    """On if the picture would be displaced by more than the tolerated part of a cell."""
    return RuleResult(cells > tolerance.cells, f"{reason}: {cells:.2g} cells", displaced_db(cells))


def displaced_db(cells: float) -> float:
    """Rms difference of level between speckle and the same speckle displaced.

    Two levels of spread 5.57 dB whose correlation falls with the displacement as rows' does.
    """
    correlation = ROW_CORRELATION ** (cells**2)
    return LEVEL_SPREAD_DB * math.sqrt(2.0 * (1.0 - correlation))
