"""How well pings agree about the height of the floor: roll, scale of the ranges, time offset.

The first echo of a beam comes from where the floor is nearest, which on a smooth floor lies in the
upright plane through the array. So its elevation is known, and passes at several heights, roll
angles and headings that overlap must find the same heights.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from mapperd.calibration.agreement import STEPS, SonarView
from mapperd.calibration.dive import CalibrationDive

__all__ = ["FloorEchoes", "fit_floor", "floor_echoes", "floor_points"]

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

MAX_SINE = 0.5
"""Beams further to the side are left out: their first echo comes from the near edge of the beam."""

EVERY_BEAM = 4
FIRST_SHARE = 0.5
"""The first echo is the first peak above this share of the beam's brightest sample."""

CLIMB_ROWS = 12
MIN_BRIGHTNESS = 3.0
CELL_M = 0.4
GATES_M = (0.4, 0.24, 0.15, 0.09, 0.08, 0.08, 0.08, 0.08)
"""Largest distance from the median height of a cell, by round: what stands on the floor goes."""

NOISE_M = 0.03
CORRELATED = 25.0
"""Number of neighbouring echoes that err alike: of one ping, and of one stone."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorEchoes:
    """First echoes.

    Attributes:
        ping: (N,) index of the ping.
        sine: (N,) sine of the bearing.
        range_m: (N,) as measured.
    """

    ping: Numbers
    sine: Floats
    range_m: Floats


def floor_echoes(dive: CalibrationDive, view: SonarView) -> FloorEchoes:
    """Find the first echo of every fourth beam of each ping."""
    images = gaussian_filter(np.sqrt(np.clip(dive.images - 4.0, 0.0, None)), (0, 1, 1))
    rows = images.shape[1]
    columns = np.arange(0, images.shape[2], EVERY_BEAM)
    sines = dive.first_sine + columns * dive.sine_step
    inside = np.abs(sines) < MAX_SINE
    columns, sines = columns[inside], sines[inside]
    profile = images[:, :, columns].copy()
    profile[:, : int(view.min_range_m / dive.row_m)] = 0

    def at(row: Numbers) -> Floats:
        found = np.take_along_axis(profile, np.clip(row, 0, rows - 1)[:, None, :], axis=1)
        return np.asarray(found[:, 0], dtype=np.float64)

    brightest = profile.max(axis=1)
    peak = (profile >= FIRST_SHARE * brightest[:, None, :]).argmax(axis=1)
    for _ in range(CLIMB_ROWS):
        peak = np.where(at(peak + 1) > at(peak), peak + 1, peak)
    before, top, after = at(peak - 1), at(peak), at(peak + 1)
    bend = before - 2 * top + after
    bent = np.abs(bend) > 1e-6  # noqa: PLR2004 flat
    shift = np.where(bent, 0.5 * (before - after) / np.where(bent, bend, 1.0), 0.0)
    ping, place = np.nonzero((brightest > MIN_BRIGHTNESS) & (peak < rows - 2))
    range_m = (peak + np.clip(shift, -0.5, 0.5) + 0.5) * dive.row_m
    return FloorEchoes(ping, sines[place], range_m[ping, place])


def floor_points(
    dive: CalibrationDive, view: SonarView, echoes: FloorEchoes, values: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the echoes in the map, (N, 3) m, and which of them lie inside the vertical beam."""
    motion = dive.motion(float(values[6]))
    mounting = view.mounting(values)
    ping = echoes.ping
    down = np.einsum("nji,j->ni", motion.rotation @ mounting, np.array([0.0, 0.0, -1.0]))[ping]
    elevation = np.arctan2(down[:, 2], down[:, 0])
    across = np.sqrt(1.0 - echoes.sine**2)
    ray = np.stack([across * np.cos(elevation), -echoes.sine, across * np.sin(elevation)], axis=1)
    range_m = values[7] * echoes.range_m
    sonar = ray * range_m[:, None]
    sonar = sonar + dive.drift(motion, mounting, values[3:6], ping, sonar)
    base = sonar @ mounting.T + values[3:6]
    points = np.einsum("nij,nj->ni", motion.rotation[ping], base) + motion.position_m[ping]
    return points, np.abs(elevation) < view.aperture_rad


def fit_floor(
    dive: CalibrationDive, view: SonarView, echoes: FloorEchoes, values: Floats, free: Numbers
) -> tuple[Floats, Floats]:
    """Fit parameters so that the heights in each cell agree.

    Args:
        dive: pings and path.
        view: of the sonar.
        echoes: of the floor.
        values: (8,) parameters at the start.
        free: indices of those to fit.

    Returns:
        The parameters, (8,), and the standard deviations of the free ones; infinite ones without
        enough floor.
    """
    spread = np.full(len(free), np.inf)
    steps = STEPS[free]
    for gate_m in GATES_M:
        points, lit = floor_points(dive, view, echoes, values)
        cell, median_m = _cells(points)
        used = lit & (np.abs(points[:, 2] - median_m) < gate_m)
        if used.sum() < 10 * len(free):
            return values, np.full(len(free), np.inf)
        chosen = FloorEchoes(echoes.ping[used], echoes.sine[used], echoes.range_m[used])
        for _ in range(2):
            residuals = _residuals(dive, view, chosen, values, cell[used])
            slopes = []
            for place, step in zip(free, steps, strict=True):
                moved = np.zeros(len(values))
                moved[place] = 0.2 * step
                up, low = (
                    _residuals(dive, view, chosen, values + sign * moved, cell[used])
                    for sign in (1, -1)
                )
                slopes.append((up - low) / 0.4)
            jacobian = np.stack(slopes, axis=1)
            weight = 1.0 / (1.0 + (residuals / NOISE_M) ** 2)
            normal = jacobian.T @ (jacobian * weight[:, None])
            normal += 1e-9 * np.trace(normal) * np.eye(len(free))
            values = values.copy()
            values[free] -= np.linalg.solve(normal, jacobian.T @ (weight * residuals)) * steps
            noise_m = math.sqrt(CORRELATED * float(np.average(residuals**2, weights=weight)))
            spread = noise_m * np.sqrt(np.diag(np.linalg.inv(normal))) * steps
    return values, spread


def _cells(points: Floats) -> tuple[Numbers, Floats]:
    """Return the cell of each point and the median height in it."""
    place = np.floor(points[:, :2] / CELL_M).astype(np.intp)
    place -= place.min(axis=0)
    _, cell = np.unique(place[:, 0] * (place[:, 1].max() + 1) + place[:, 1], return_inverse=True)
    order = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[order])) + 1
    medians = np.array([np.median(part) for part in np.split(points[order, 2], starts)])
    return cell, medians[cell]


def _residuals(
    dive: CalibrationDive, view: SonarView, echoes: FloorEchoes, values: Floats, cell: Numbers
) -> Floats:
    height_m = floor_points(dive, view, echoes, values)[0][:, 2]
    count = np.maximum(np.bincount(cell), 1)
    return np.asarray(height_m - (np.bincount(cell, height_m) / count)[cell])
