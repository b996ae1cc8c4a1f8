"""Effects that move the picture: how far each does, and which can be left out together.

Displacements add up, so what is left out is judged by its sum: the farthest mover is called for
first, until the rest together stay within the tolerance.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.effect import Verdict
from sonar_sim.effects.parts import parts_of
from sonar_sim.effects.preview import View
from sonar_sim.effects.texture import FARTHEST
from sonar_sim.effects.verdicts import displaced_db
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.tolerance import Tolerance

MOVERS = ("sound_speed", "motion", "doppler", "refraction")


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Displacement of the picture's parts, (P,) each: to farther rows, and to starboard beams."""

    rows: NDArray[np.float64]
    beams: NDArray[np.float64]

    @property
    def cells(self) -> float:
        """How far all but a few of the parts move, by rows or by beams."""
        return max(_farthest(self.rows), _farthest(self.beams))


def moves(view: View) -> dict[str, Move]:
    """What each mover does to each part of the picture.

    Sound that comes back from range R after 2 R / c meets a sonar that has come v R / c nearer, on
    the way there and back together, and has turned by omega 2 R / c.
    """
    sonar, speed_mps, parts = view.sonar, view.speed_mps, parts_of(view)
    row_m, none = sonar.range_resolution_m, np.zeros(len(parts.range_m))
    velocity_mps, turn_rps = np.zeros(3), np.zeros(3)
    if view.motion is not None:
        velocity_mps = view.map_T_sonar.rotation.T @ np.asarray(view.motion.linear_mps)
        turn_rps = np.asarray(view.motion.angular_rps)
    closing_mps = parts.away @ velocity_mps - parts.leaving_mps
    closing_m2ps = parts.away_m @ velocity_mps - parts.leaving_m2ps
    sines = parts.turned_m @ turn_rps + parts.passed @ velocity_mps - parts.passing_mps
    return {
        "sound_speed": Move(parts.range_m * (range_scale(view) - 1.0) / row_m, none),
        "motion": Move(
            -closing_m2ps / speed_mps / row_m, 2.0 / speed_mps * sines / sonar.sine_pitch
        ),
        "doppler": Move(closing_mps * doppler_shift_s(sonar, speed_mps) / row_m, none),
        "refraction": Move(parts.stretched_m / row_m, none),
    }


def range_scale(view: View) -> float:
    """Apparent range over true range, by the speed of sound that the sonar was told."""
    told_mps = view.sonar.told_speed_mps
    return 1.0 if told_mps is None else told_mps / view.speed_mps


def doppler_shift_s(sonar: SonarSettings, speed_mps: float) -> float:
    """Apparent range over closing speed, by the coupling of a chirp: f T / B."""
    return sonar.frequency_hz * sonar.pulse_s / sonar.bandwidth_hz(speed_mps)


@dataclass(frozen=True, slots=True, eq=False)
class Movers:
    """What moves one ping's picture.

    Attributes:
        moves: of each mover.
        cells: how far each mover takes all but a few of the picture's parts.
        left_out: movers whose displacements together stay within the tolerance, at `cells`.
    """

    moves: dict[str, Move]
    cells: dict[str, float]
    left_out: dict[float, frozenset[str]]


_KNOWN: WeakKeyDictionary[View, Movers] = WeakKeyDictionary()


def moved_cells(view: View, name: str) -> float:
    """How far one mover takes all but a few of the picture's parts."""
    return _movers(view).cells[name]


def move_verdict(name: str, view: View, tolerance: Tolerance, reason: str) -> Verdict:
    """On if the picture would be displaced too far without this one of the movers."""
    movers = _movers(view)
    left = movers.left_out.get(tolerance.cells)
    if left is None:
        left = movers.left_out[tolerance.cells] = _left_out(movers, tolerance.cells)
    cells = movers.cells[name]
    return Verdict(name not in left, f"{reason}: {cells:.2g} cells", displaced_db(cells))


def _movers(view: View) -> Movers:
    known = _KNOWN.get(view)
    if known is None:
        found = moves(view)
        known = Movers(found, {name: move.cells for name, move in found.items()}, {})
        _KNOWN[view] = known
    return known


def _left_out(movers: Movers, cells: float) -> frozenset[str]:
    """Drop the farthest mover until the rest together stay within the tolerance."""
    left = sorted(movers.cells, key=lambda mover: (movers.cells[mover], mover))
    if sum(movers.cells.values()) <= cells:
        return frozenset(left)
    while left and _sum(movers.moves[mover] for mover in left).cells > cells:
        left.pop()
    return frozenset(left)


def _sum(parts: Iterable[Move]) -> Move:
    rows, beams = zip(*((move.rows, move.beams) for move in parts), strict=True)
    return Move(np.sum(rows, axis=0), np.sum(beams, axis=0))


def _farthest(cells: NDArray[np.float64]) -> float:
    return float(np.quantile(np.abs(cells), FARTHEST)) if cells.any() else 0.0
