"""Displacement of the picture by sound speed, motion, Doppler shift and refraction.

Displacements are linear in velocity and turn rate while a ping listens, so their factors are
computed once per preview. They add up: effects are called for in descending order of displacement,
until the remaining ones together stay within the tolerance.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from sonar_sim.effects.echoes import COLUMNS, Echoes
from sonar_sim.effects.effect import RuleResult, displaced_db
from sonar_sim.effects.image_difference import Tolerance, full_scale, gamma_of
from sonar_sim.effects.preview import PingPreview
from sonar_sim.effects.texture import FAR_QUANTILE, MIN_STEPS
from sonar_sim.scene.sonar import SonarSettings

STEP_S = 1e-3
"""Of the difference that gives an object's velocity."""


def object_velocity_mps(view: PingPreview) -> NDArray[np.float64]:
    """Velocity of each echo's object, map frame, (N, 3); its own turning is left out."""
    velocity = np.zeros((len(view.echoes.range_m), 3))
    for target in view.scene.targets:
        if target.motion is not None:
            here_m, soon_m = (target.position_at_m(view.time_s + t) for t in (0.0, STEP_S))
            its = np.all(view.echoes.point_m == here_m, axis=1)
            velocity[its] = (soon_m - here_m) / STEP_S
    for number, surface in enumerate(view.scene.surfaces):
        if surface.motion is not None:
            now, soon = (surface.motion.pose(view.time_s + after) for after in (0.0, STEP_S))
            its = view.echoes.surface == number
            velocity[its] = (soon.position_m - now.position_m) / STEP_S
    return velocity


def sonar_speed_mps(view: PingPreview) -> float:
    """Speed of the sonar."""
    return 0.0 if view.motion is None else float(np.linalg.norm(view.motion.linear_mps))


def sonar_turn_rate_rps(view: PingPreview) -> float:
    """Rate of turn, rad/s."""
    return 0.0 if view.motion is None else float(np.linalg.norm(view.motion.angular_rps))


STEPS = 8
"""Places along a path at which the profile is read."""
HALF_STEP_M = 0.05
"""Depth over which a gradient is taken, each way."""


@dataclass(frozen=True, slots=True, eq=False)
class PathBending:
    """What the profile does to each echo's path, (N,) each.

    Attributes:
        turn_rad: how much steeper down the path leaves than the straight line to its echo.
        stretch: apparent range over true range, by the mean slowness along the straight line.
    """

    turn_rad: NDArray[np.float64]
    stretch: NDArray[np.float64]


def path_bending(view: PingPreview) -> PathBending:
    """Follow the straight paths through the profile.

    In a constant gradient g a path is an arc of curvature g cos / c, whose chord leaves it by half
    of the bend: g R cos / (2 c). The gradient is the mean one between sonar and echo, weighted as
    the arc sees it: the end of the path is reached by (1 - t) of what bends at t.
    """
    profile, echoes = view.scene.water.profile, view.echoes
    if profile is None:
        return PathBending(np.zeros(len(echoes.range_m)), np.ones(len(echoes.range_m)))
    depths_m, speeds_mps = np.array(profile, dtype=np.float64).T
    steps = (np.arange(STEPS) + 0.5) / STEPS
    depth_s = -float(view.map_T_sonar.position_m[2])
    along_m = depth_s + np.outer(-echoes.point_m[:, 2] - depth_s, steps)
    below, above = (
        np.interp(along_m + off, depths_m, speeds_mps) for off in (HALF_STEP_M, -HALF_STEP_M)
    )
    mean = ((below - above) / (2.0 * HALF_STEP_M) * (1.0 - steps)).mean(axis=1) * 2.0
    level_m = np.hypot(*(echoes.point_m - view.map_T_sonar.position_m)[:, :2].T)
    speed = np.interp(along_m, depths_m, speeds_mps)
    return PathBending(
        -mean * level_m / (2.0 * view.speed_of_sound_mps),
        (view.speed_of_sound_mps / speed).mean(axis=1),
    )


MAX_PARTS = 1024
"""Limit of parts; more do not change the displacement that nine in ten stay below."""


@dataclass(frozen=True, slots=True, eq=False)
class VisibleParts:
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
        turned_m: R times the starboard sine's rate per rad/s of the sonar's turn, (P, 3).
        passed: R times its rate per m/s of the sonar's velocity, (P, 3).
        passing_mps: R times its rate by the objects' own motion, (P,).
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


_PARTS_CACHE: WeakKeyDictionary[Echoes, VisibleParts] = WeakKeyDictionary()


def visible_parts(view: PingPreview) -> VisibleParts:
    """The parts of what a look saw, whatever the motion."""
    known = _PARTS_CACHE.get(view.echoes)
    if known is None:
        known = _PARTS_CACHE[view.echoes] = _parts_of(view)
    return known


def _parts_of(view: PingPreview) -> VisibleParts:
    place, its, total = _seen(view)
    u, range_m = view.echoes.direction.take(its, axis=0), view.echoes.range_m[its]
    shares = csc_matrix(
        (view.echo_power[its] / total[place], place, np.arange(len(its) + 1)),
        shape=(len(total), len(its)),
    )

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of each part, weighted by power, (P, ...)."""
        of_parts: NDArray[np.float64] = shares @ values
        return of_parts

    away_m = mean(range_m[:, None] * u)
    # s = -y; the direction to a fixed point turns by -omega x u and passes by -(v - (v u) u) / R.
    passed = -u[:, 1, None] * u
    passed[:, 1] += 1.0
    none = np.zeros(len(total))
    stretched_m = leaving_mps = leaving_m2ps = passing_mps = none
    if view.scene.water.profile is not None:
        stretched_m = mean(range_m * (path_bending(view).stretch[its] - 1.0))
    if view.solids.moving or any(target.motion is not None for target in view.scene.targets):
        leaving = object_velocity_mps(view)[its] @ view.map_T_sonar.rotation
        along = np.sum(leaving * u, axis=1)
        leaving_mps, leaving_m2ps = mean(along), mean(range_m * along)
        passing_mps = mean(np.sum(leaving * passed, axis=1))
    return VisibleParts(
        mean(range_m),
        stretched_m,
        mean(u),
        away_m,
        leaving_mps,
        leaving_m2ps,
        np.stack([-away_m[:, 2], none, away_m[:, 0]], axis=1),
        mean(passed),
        passing_mps,
    )


def _seen(view: PingPreview) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Part of each echo in one (M,), those echoes (M,), and each part's power (P,)."""
    grid, echoes = view.grid, view.echoes
    row = np.clip((echoes.range_m / grid.row_m).astype(np.int64), 0, grid.rows - 1)
    cell = row * COLUMNS + echoes.column
    total = np.bincount(cell, view.echo_power, grid.rows * COLUMNS)
    least = (MIN_STEPS / full_scale(view.sonar)) ** (1.0 / gamma_of(view.sonar))
    bright = view.gains.amplitude(view.echo_picture).ravel() > least
    seen = np.flatnonzero((total > 0.0) & bright)
    seen = seen[:: max(1, -(-len(seen) // MAX_PARTS))]
    number = np.full(len(total), -1, dtype=np.int64)
    number[seen] = np.arange(len(seen))
    part: NDArray[np.int64] = number[cell]
    its: NDArray[np.int64] = np.flatnonzero(part >= 0)
    return part[its], its, total[seen].astype(np.float64)


DISPLACING_EFFECTS = ("sound_speed", "motion", "doppler", "refraction")


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """Displacement of the picture's parts, (P,) each: to farther rows, and to starboard beams."""

    rows: NDArray[np.float64]
    beams: NDArray[np.float64]

    @property
    def cells(self) -> float:
        """How far all but a few of the parts move, by rows or by beams."""
        return max(_farthest(self.rows), _farthest(self.beams))


def displacement(view: PingPreview) -> dict[str, Displacement]:
    """What each effect does to each part of the picture.

    Sound that comes back from range R after 2 R / c meets a sonar that has come v R / c nearer, on
    the way there and back together, and has turned by omega 2 R / c.
    """
    sonar, speed_mps, parts = view.sonar, view.speed_of_sound_mps, visible_parts(view)
    row_m, none = sonar.range_resolution_m, np.zeros(len(parts.range_m))
    velocity_mps, turn_rps = np.zeros(3), np.zeros(3)
    if view.motion is not None:
        velocity_mps = view.map_T_sonar.rotation.T @ np.asarray(view.motion.linear_mps)
        turn_rps = np.asarray(view.motion.angular_rps)
    closing_mps = parts.away @ velocity_mps - parts.leaving_mps
    closing_m2ps = parts.away_m @ velocity_mps - parts.leaving_m2ps
    sines = parts.turned_m @ turn_rps + parts.passed @ velocity_mps - parts.passing_mps
    return {
        "sound_speed": Displacement(parts.range_m * (range_scale(view) - 1.0) / row_m, none),
        "motion": Displacement(
            -closing_m2ps / speed_mps / row_m, 2.0 / speed_mps * sines / sonar.sine_pitch
        ),
        "doppler": Displacement(closing_mps * doppler_shift_s(sonar, speed_mps) / row_m, none),
        "refraction": Displacement(parts.stretched_m / row_m, none),
    }


def range_scale(view: PingPreview) -> float:
    """Apparent range over true range, by the speed of sound that the sonar assumes."""
    assumed_mps = view.sonar.told_speed_mps
    return 1.0 if assumed_mps is None else assumed_mps / view.speed_of_sound_mps


def doppler_shift_s(sonar: SonarSettings, speed_mps: float) -> float:
    """Apparent range over closing speed, by the coupling of a chirp: f T / B."""
    return sonar.frequency_hz * sonar.pulse_s / sonar.bandwidth_hz(speed_mps)


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """What moves one ping's picture.

    Attributes:
        moves: of each effect.
        cells: how far each effect takes all but a few of the picture's parts.
        left_out: effects whose displacements together stay within the tolerance, at `cells`.
    """

    moves: dict[str, Displacement]
    cells: dict[str, float]
    left_out: dict[float, frozenset[str]]


_DISPLACEMENTS_CACHE: WeakKeyDictionary[PingPreview, Displacements] = WeakKeyDictionary()


def displaced_cells(view: PingPreview, name: str) -> float:
    """How far one effect takes all but a few of the picture's parts."""
    return _displacements(view).cells[name]


def displacement_result(
    name: str, view: PingPreview, tolerance: Tolerance, reason: str
) -> RuleResult:
    """On if the picture would be displaced too far without this one of the effects."""
    found = _displacements(view)
    left = found.left_out.get(tolerance.cells)
    if left is None:
        left = found.left_out[tolerance.cells] = _left_out(found, tolerance.cells)
    cells = found.cells[name]
    return RuleResult(name not in left, f"{reason}: {cells:.2g} cells", displaced_db(cells))


def _displacements(view: PingPreview) -> Displacements:
    known = _DISPLACEMENTS_CACHE.get(view)
    if known is None:
        found = displacement(view)
        known = Displacements(found, {name: move.cells for name, move in found.items()}, {})
        _DISPLACEMENTS_CACHE[view] = known
    return known


def _left_out(found: Displacements, cells: float) -> frozenset[str]:
    """Drop the farthest effect until the rest together stay within the tolerance."""
    left = sorted(found.cells, key=lambda effect: (found.cells[effect], effect))
    if sum(found.cells.values()) <= cells:
        return frozenset(left)
    while left and _sum(found.moves[effect] for effect in left).cells > cells:
        left.pop()
    return frozenset(left)


def _sum(parts: Iterable[Displacement]) -> Displacement:
    rows, beams = zip(*((move.rows, move.beams) for move in parts), strict=True)
    return Displacement(np.sum(rows, axis=0), np.sum(beams, axis=0))


def _farthest(cells: NDArray[np.float64]) -> float:
    """The quantile of the sizes, linear between two of them."""
    if not cells.any():
        return 0.0
    at = FAR_QUANTILE * (len(cells) - 1)
    low = int(at)
    high = min(low + 1, len(cells) - 1)
    sizes = np.partition(np.abs(cells), (low, high))
    return float(sizes[low] + (at - low) * (sizes[high] - sizes[low]))
