"""Effects that move the picture: how far each does, and which can be left out together.

Displacements add up, so what is left out is judged by its sum: the farthest mover is called for
first, until the rest together stay within the tolerance.
"""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.bending import bending
from sonar_sim.effects.echoes import COLUMNS
from sonar_sim.effects.effect import Verdict
from sonar_sim.effects.listening import closing_mps, turn_rps
from sonar_sim.effects.verdicts import displaced_db
from sonar_sim.effects.view import View
from sonar_sim.picture_change import full_scale, gamma_of
from sonar_sim.sonar import SonarSettings
from sonar_sim.texture import FARTHEST, LEAST_STEPS
from sonar_sim.tolerance import Tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Displacement of each echo, (N,) each: towards farther rows, and across beams, unsigned."""

    rows: NDArray[np.float64]
    beams: NDArray[np.float64]

    def __add__(self, other: "Move") -> "Move":
        """Both together."""
        return Move(self.rows + other.rows, self.beams + other.beams)


def moves(view: View) -> dict[str, Move]:
    """What each mover does to each echo."""
    sonar, range_m = view.sonar, view.echoes.range_m
    row_m, none = sonar.range_resolution_m, np.zeros(len(range_m))
    closing = closing_mps(view)
    turned_rad = turn_rps(view) * 2.0 * range_m / view.speed_mps
    return {
        "sound_speed": Move(range_m * (range_scale(view) - 1.0) / row_m, none),
        "motion": Move(
            -closing * range_m / view.speed_mps / row_m, turned_rad / sonar.beam_width_rad
        ),
        "doppler": Move(closing * doppler_shift_s(sonar, view.speed_mps) / row_m, none),
        "refraction": Move(range_m * (bending(view).stretch - 1.0) / row_m, none),
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
        cells: how far each mover takes all but a few of the picture's parts.
        left_out: movers whose displacements together stay within the tolerance, at `cells`.
    """

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
        left = movers.left_out[tolerance.cells] = _left_out(view, movers, tolerance.cells)
    cells = movers.cells[name]
    return Verdict(name not in left, f"{reason}: {cells:.2g} cells", displaced_db(cells))


def _movers(view: View) -> Movers:
    known = _KNOWN.get(view)
    if known is None:
        parts = _Parts.of(view)
        known = Movers({n: parts.moved_cells(move) for n, move in moves(view).items()}, {})
        _KNOWN[view] = known
    return known


def _left_out(view: View, movers: Movers, cells: float) -> frozenset[str]:
    """Drop the farthest mover until the rest together stay within the tolerance."""
    left = sorted(movers.cells, key=lambda mover: (movers.cells[mover], mover))
    if sum(movers.cells.values()) <= cells:
        return frozenset(left)
    found, parts = moves(view), _Parts.of(view)
    while left and parts.moved_cells(_sum([found[mover] for mover in left])) > cells:
        left.pop()
    return frozenset(left)


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """Parts of the picture that can be seen to move: coarse cells bright enough.

    Echoes that share one move as one, by the mean of their powers: what lies above and below can
    move to and fro.

    Attributes:
        place: coarse cell of each echo, (N,).
        power: of each echo, (N,).
        total: of each coarse cell, (cells,).
        seen: which coarse cells are bright enough, (cells,).
    """

    place: NDArray[np.int64]
    power: NDArray[np.float64]
    total: NDArray[np.float64]
    seen: NDArray[np.bool_]

    @classmethod
    def of(cls, view: View) -> "_Parts":
        grid, echoes = view.grid, view.echoes
        row = np.clip((echoes.range_m / grid.row_m).astype(np.int64), 0, grid.rows - 1)
        place = row * COLUMNS + echoes.column
        power = np.maximum(view.echo_power, 1e-30)
        total = np.bincount(place, power, grid.rows * COLUMNS).astype(np.float64)
        least = (LEAST_STEPS / full_scale(view.sonar)) ** (1.0 / gamma_of(view.sonar))
        seen: NDArray[np.bool_] = (total > 0.0) & (
            view.gains.amplitude(view.echo_picture).ravel() > least
        )
        return cls(place.astype(np.int64), power, total, seen)

    def moved_cells(self, move: Move) -> float:
        """How far all but a few of the parts move, by rows or by beams."""
        if not self.seen.any():
            return 0.0
        return max(self._moved(part) for part in (move.rows, move.beams))

    def _moved(self, cells: NDArray[np.float64]) -> float:
        if not cells.any():
            return 0.0
        mean = np.bincount(self.place, self.power * cells, len(self.total))[self.seen]
        return float(np.quantile(np.abs(mean / self.total[self.seen]), FARTHEST))


def _sum(parts: list[Move]) -> Move:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total
