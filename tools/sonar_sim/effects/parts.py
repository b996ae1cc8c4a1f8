"""Parts of the picture that can be seen to move, and how each answers to motion.

Motion is small while a ping listens, so displacements are linear in velocity and turn rate: what
they are multiplied with is worked out once a look.
"""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.bending import bending
from sonar_sim.effects.echoes import COLUMNS, Echoes
from sonar_sim.effects.listening import leaving_mps
from sonar_sim.effects.preview import View
from sonar_sim.effects.texture import LEAST_STEPS
from sonar_sim.picture_change import full_scale, gamma_of

MOST_PARTS = 1024
"""More say no more of how far nine in ten of them move."""


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """Coarse cells bright enough to be seen, each by its echoes' mean weighted by their powers.

    Echoes that share a cell move as one: what lies above and below can move to and fro. u is the
    direction to an echo in the sonar's frame, R its range; a column for each axis of the frame.

    Attributes:
        range_m: R, (P,).
        stretched_m: apparent less true range by the profile of sound speed, (P,).
        away: u, (P, 3).
        away_m: R u, (P, 3).
        leaving_mps: speed at which moving objects leave, along u, (P,).
        leaving_m2ps: the same times R, (P,).
        turned_m: what turns the echo's starboard sine, times R, (P, 3).
        passed: what moves it by passing, (P, 3).
        passing_mps: the same of moving objects, (P,).
    """

    range_m: NDArray[np.float64]
    stretched_m: NDArray[np.float64]
    away: NDArray[np.float64]
    away_m: NDArray[np.float64]
    leaving_mps: NDArray[np.float64]
    leaving_m2ps: NDArray[np.float64]
    turned_m: NDArray[np.float64]
    passed: NDArray[np.float64]
    passing_mps: NDArray[np.float64]


_KNOWN: WeakKeyDictionary[Echoes, Parts] = WeakKeyDictionary()


def parts_of(view: View) -> Parts:
    """The parts of what a look saw, whatever the motion."""
    known = _KNOWN.get(view.echoes)
    if known is None:
        known = _KNOWN[view.echoes] = _parts_of(view)
    return known


def _parts_of(view: View) -> Parts:
    place, its, total = _seen(view)
    u, range_m = view.echoes.direction[its], view.echoes.range_m[its]
    leaving = leaving_mps(view)[its] @ view.map_T_sonar.rotation
    along = np.sum(leaving * u, axis=1)
    # s = -y; the direction to a fixed point turns by -omega x u and passes by -(v - (v u) u) / R.
    turned = np.stack([-u[:, 2], np.zeros(len(u)), u[:, 0]], axis=1)
    passed = -u[:, 1, None] * u
    passed[:, 1] += 1.0
    values = np.column_stack(
        [
            range_m,
            range_m * (bending(view).stretch[its] - 1.0),
            u,
            range_m[:, None] * u,
            along,
            range_m * along,
            range_m[:, None] * turned,
            passed,
            np.sum(leaving * passed, axis=1),
        ]
    )
    values *= view.echo_power[its, None]
    sums = [np.bincount(place, each, len(total)) for each in values.T]
    mean: NDArray[np.float64] = np.column_stack(sums) / total[:, None]
    return Parts(
        mean[:, 0],
        mean[:, 1],
        mean[:, 2:5],
        mean[:, 5:8],
        mean[:, 8],
        mean[:, 9],
        mean[:, 10:13],
        mean[:, 13:16],
        mean[:, 16],
    )


def _seen(view: View) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Part of each echo in one (M,), those echoes (M,), and each part's power (P,)."""
    grid, echoes = view.grid, view.echoes
    row = np.clip((echoes.range_m / grid.row_m).astype(np.int64), 0, grid.rows - 1)
    cell = row * COLUMNS + echoes.column
    total = np.bincount(cell, view.echo_power, grid.rows * COLUMNS)
    least = (LEAST_STEPS / full_scale(view.sonar)) ** (1.0 / gamma_of(view.sonar))
    bright = view.gains.amplitude(view.echo_picture).ravel() > least
    seen = np.flatnonzero((total > 0.0) & bright)
    seen = seen[:: max(1, -(-len(seen) // MOST_PARTS))]
    number = np.full(len(total), -1, dtype=np.int64)
    number[seen] = np.arange(len(seen))
    part: NDArray[np.int64] = number[cell]
    its: NDArray[np.int64] = np.flatnonzero(part >= 0)
    return part[its], its, total[seen].astype(np.float64)
