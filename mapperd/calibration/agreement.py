"""How well pings from different places agree about the structure around them.

A bright echo of one ping is a point in the map, and all other pings that look at the point from
about the same side should show it as bright. The disagreement is the share of their brightness that
no constant brightness of the points explains. Range and bearing of a point are measured; its
elevation is the one at which the pings agree best.

A line array measures the sine of the angle between a direction and its upright plane, so the
mounting's turn about the array changes ranges and bearings of nothing.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from mapperd.calibration.dive import CalibrationDive, VehicleMotion

__all__ = ["PARAMETERS", "STEPS", "Agreement", "Blur", "SonarView"]

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

PARAMETERS = ("roll", "pitch", "yaw", "x", "y", "z", "time_offset", "range_scale")
"""Turn of the mounting about the base axes from the start, deg; position of the sonar in the base,
m; seconds to add to the times of the pings; factor on ranges."""

STEPS = np.array([0.5, 0.5, 0.5, 0.02, 0.02, 0.02, 0.02, 0.005])
"""Changes of the parameters that move echoes alike, for derivatives."""

UP_STEP = 0.01
CORRELATED = 5.0
"""Neighbouring looks err alike: how much wider than of independent ones the spread is."""

ELEVATIONS = 5
"""Number of elevations tried for each echo."""

BACKGROUND = 3.0
"""Width of the background taken off each image, in units of its blur."""

PINGS_OF_POINT = 6
"""A point that fewer pings look at shows nothing."""

KEPT_SHARE = 0.7
"""Share of the echoes that are kept: the ones most pings agree about. A small share would favour
those that agree at the parameters of the start, and so hold the fit back."""

APART = 4.0
"""A look that sees a point nearly where its own ping saw it shows nothing: neighbouring pings look
alike whatever the parameters are. In units of the blur."""

REVISIT_S = 5.0
"""Pings this far apart in time show in pictures whether passes agree."""

EXTRA_ELEVATION_DEG = 3.0
EDGE_M, EDGE_SINE = 0.1, 0.02
"""Points nearer to the edge of the fan are left out, for no change may take them across it."""


@dataclass(frozen=True, slots=True)
class Blur:
    """Blur of the images: standard deviations.

    Attributes:
        range_m: along range.
        sine: along the sine of the bearing.
    """

    range_m: float
    sine: float


@dataclass(frozen=True, slots=True)
class SonarView:
    """What is known of the sonar.

    Attributes:
        start: (3, 3) rotation of the mounting at the start, sonar to base.
        aperture_rad: two-way half-power width of the vertical pattern.
        min_range_m: nearer echoes are ignored.
    """

    start: Floats
    aperture_rad: float
    min_range_m: float

    def mounting(self, values: Floats) -> Floats:
        """Return the rotation (3, 3) of the mounting, sonar to base."""
        turn: Floats = Rotation.from_rotvec(np.radians(values[:3])).as_matrix()
        return turn @ self.start


class Agreement:
    """The disagreement of pings as a function of the parameters, for one blur.

    Args:
        dive: pings and path.
        view: of the sonar.
        blur: of the images.
        values: (8,) parameters near which it is used.
        side_deg: largest angle between two views of a point; another side of a thing is another
            point.
        echoes: number of echoes to try.
        seed: of their choice.

    Attributes:
        pings_of_echoes: (P,) index of the ping that each point is an echo of.
    """

    def __init__(
        self,
        dive: CalibrationDive,
        view: SonarView,
        blur: Blur,
        values: Floats,
        *,
        side_deg: float,
        echoes: int,
        seed: int,
    ) -> None:
        self._dive, self._view, self._blur = dive, view, blur
        self._features = features(dive, blur)
        self._alike = math.cos(math.radians(side_deg))
        random = np.random.default_rng(seed)
        self._ping: Numbers = np.zeros(0, dtype=np.intp)
        self._point: Numbers = np.zeros(0, dtype=np.intp)
        self._up = np.zeros(echoes)
        self._choose(random, echoes)
        self._resolve_elevation(random, values)

    @property
    def points(self) -> int:
        """Number of points."""
        return len(self.pings_of_echoes)

    def residuals(self, values: Floats) -> Floats:
        """Return what the points do not explain, one number for each look of a ping at a point.

        Args:
            values: (8,) parameters.

        Returns:
            Numbers whose squares add up to the disagreement, 0 to 1.
        """
        seen = self._look(values)
        total = math.sqrt(float(seen @ seen)) or 1.0
        looks = np.maximum(self._sum(np.ones(len(seen))), 1)
        return (seen - (self._sum(seen) / looks)[self._point]) / total

    def disagreement(self, values: Floats) -> float:
        """Return the sum of the squares of `residuals`."""
        residuals = self.residuals(values)
        return float(residuals @ residuals)

    def improve(self, values: Floats, free: Numbers, rounds: int) -> tuple[Floats, Floats]:
        """Change parameters, and the elevation of every point, until the pings agree best.

        Args:
            values: (8,) parameters at the start.
            free: indices of those to change.
            rounds: largest number of steps.

        Returns:
            The parameters, (8,), and the standard deviations of the free ones.
        """
        steps = STEPS[free] * max(self._blur.range_m, 0.03) / 0.1
        spread = np.full(len(free), np.inf)
        before = self.disagreement(values)
        for _ in range(rounds):
            normal, change, ups = self._direction(values, free, steps)
            noise = math.sqrt(before / max(len(self._point), 1))
            spread = CORRELATED * noise * np.sqrt(np.diag(np.linalg.inv(normal))) * steps
            up, best, size = self._up, before, 1.0
            found = values
            while 0.1 < size < 8.0:  # noqa: PLR2004 noise makes steps too short, rarely too long
                moved = values.copy()
                moved[free] += size * change * steps
                self._up = self._bounded(up + size * ups)
                if (now := self.disagreement(moved)) < best:
                    best, found, kept = now, moved, self._up
                    size *= 2.0
                elif found is not values:
                    break
                else:
                    size /= 2.0
            self._up = up if found is values else kept
            if found is values or before - best < 2e-4 * before:
                return found, spread
            values, before = found, best
        return values, spread

    def stack(self, values: Floats, offsets_m: Floats) -> Floats:
        """Return what later and earlier pings show around the points, averaged.

        A sharp spot in the middle shows that they agree.

        Args:
            values: (8,) parameters.
            offsets_m: (N,) along range and across it, from the place of a point.

        Returns:
            (N, N) mean brightness; rows along range, columns to starboard.
        """
        t_s = self._dive.t_s
        apart_s = np.abs(t_s[self._ping] - t_s[self.pings_of_echoes[self._point]])
        again = np.flatnonzero(apart_s > REVISIT_S)
        row, column, range_m = (part[again] for part in self._places(values))
        ping = self._ping[again]
        mean = np.zeros((len(offsets_m), len(offsets_m)))
        if not len(again):
            return mean
        for i, ahead_m in enumerate(offsets_m):
            for j, side_m in enumerate(offsets_m):
                ahead = row + ahead_m / self._dive.row_m
                side = column + side_m / (range_m * self._dive.sine_step)
                mean[i, j] = self._sample(ping, ahead, side).mean()
        return mean

    def _bounded(self, up: Floats) -> Floats:
        limit = math.sin(0.75 * self._view.aperture_rad)
        return np.asarray(np.clip(up, -limit, limit))

    def _direction(
        self, values: Floats, free: Numbers, steps: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the normal matrix, the change in units of the steps, and that of the elevations.

        Each look depends on the elevation of one point alone, so those are eliminated point by
        point.
        """
        residuals = self.residuals(values)
        slopes = []
        for place, step in zip(free, steps, strict=True):
            moved = np.zeros(len(values))
            moved[place] = step
            slopes.append((self.residuals(values + moved) - self.residuals(values - moved)) / 2)
        jacobian = np.stack(slopes, axis=1)
        up = self._up
        self._up = up + UP_STEP
        higher = self.residuals(values)
        self._up = up - UP_STEP
        by_up = (higher - self.residuals(values)) / 2
        self._up = up
        weight = self._sum(by_up**2)
        weight += weight.mean() + 1e-12 if len(weight) else 0.0
        shared = np.stack([self._sum(by_up * column) for column in jacobian.T], axis=1)
        pull = self._sum(by_up * residuals)
        normal = jacobian.T @ jacobian - shared.T @ (shared / weight[:, None])
        normal += 1e-3 * np.diag(np.diag(normal)) + 1e-15 * np.eye(len(free))
        gradient = jacobian.T @ residuals - shared.T @ (pull / weight)
        change = np.clip(-np.linalg.solve(normal, gradient), -4.0, 4.0)
        ups = -UP_STEP * np.clip((pull + shared @ change) / weight, -4.0, 4.0)
        return normal, change, ups

    def _choose(self, random: np.random.Generator, echoes: int) -> None:
        """Choose echoes, each as likely as it is bright."""
        dive = self._dive
        weight = np.clip(self._features, 0, None) ** 2
        weight[:, (np.arange(weight.shape[1]) + 0.5) * dive.row_m < self._view.min_range_m] = 0
        sums = np.cumsum(weight.ravel(), dtype=np.float64)
        chosen = np.searchsorted(sums, random.random(echoes) * sums[-1])
        ping, row, column = np.unravel_index(chosen, weight.shape)
        self.pings_of_echoes: Numbers = ping
        self._range_m = (row + random.random(echoes)) * dive.row_m
        self._sine = dive.first_sine + (column + random.random(echoes) - 0.5) * dive.sine_step

    def _resolve_elevation(self, random: np.random.Generator, values: Floats) -> None:
        """Give each echo the elevation at which pings agree best, and keep the best echoes."""
        echoes = self.points
        best, up = np.full(echoes, -np.inf), self._up
        step = self._view.aperture_rad / (ELEVATIONS - 1)
        for k in range(ELEVATIONS):
            angle = (k - (ELEVATIONS - 1) / 2 + random.uniform(-0.5, 0.5, echoes)) * step
            self._up = np.sin(angle)
            self._find_looks(values)
            score = self._score(values)
            up = np.where(score > best, self._up, up)
            best = np.maximum(best, score)
        good = np.flatnonzero(np.isfinite(best))
        kept = good[np.argsort(-best[good], kind="stable")[: max(int(KEPT_SHARE * echoes), 1)]]
        self.pings_of_echoes = self.pings_of_echoes[kept]
        self._range_m, self._sine, self._up = self._range_m[kept], self._sine[kept], up[kept]
        self._find_looks(values)
        other = self._ping != self.pings_of_echoes[self._point]
        self._ping, self._point = self._ping[other], self._point[other]

    def _score(self, values: Floats) -> Floats:
        """Return how bright each point is and how well pings agree about it; (P,)."""
        seen = self._look(values)
        looks = self._sum(np.ones(len(seen)))
        mean = self._sum(seen) / np.maximum(looks, 1)
        score = 2 * mean**2 - self._sum(seen**2) / np.maximum(looks, 1)
        return np.asarray(np.where(looks >= PINGS_OF_POINT, score, -np.inf))

    def _find_looks(self, values: Floats) -> None:
        """Find which pings look at which points."""
        dive, view = self._dive, self._view
        motion = dive.motion(float(values[6]))
        points = self._place(values, motion)
        mounting = view.mounting(values)
        sonar_m = motion.position_m + motion.rotation @ values[3:6]
        first = points - sonar_m[self.pings_of_echoes]
        first /= np.linalg.norm(first, axis=1)[:, None]
        most_up = math.sin(view.aperture_rad + math.radians(EXTRA_ELEVATION_DEG))
        most_side = abs(dive.first_sine) - EDGE_SINE
        far_m = dive.range_m * values[7] - EDGE_M
        pings, looked = [], []
        for ping, (rotation, position_m) in enumerate(
            zip(motion.rotation, motion.position_m, strict=True)
        ):
            sonar = ((points - position_m) @ rotation - values[3:6]) @ mounting
            range_m = np.sqrt(np.einsum("ni,ni->n", sonar, sonar))
            inside = (range_m > view.min_range_m) & (range_m < far_m) & (sonar[:, 0] > 0)
            inside &= np.abs(sonar[:, 2]) < most_up * range_m
            inside &= np.abs(sonar[:, 1]) < most_side * range_m
            along = np.einsum("ni,ni->n", points - sonar_m[ping], first)
            inside &= along > self._alike * range_m
            side = -sonar[:, 1] / np.maximum(range_m, 1e-6)
            far = np.abs(range_m - self._range_m * values[7]) > APART * self._blur.range_m
            far |= np.abs(side - self._sine) > APART * self._blur.sine
            found = np.flatnonzero(inside & far)
            pings.append(np.full(len(found), ping))
            looked.append(found)
        self._ping, self._point = np.concatenate(pings), np.concatenate(looked)

    def _place(self, values: Floats, motion: VehicleMotion) -> Floats:
        """Return the points in the map, (P, 3), by the pings that they are echoes of."""
        ping = self.pings_of_echoes
        range_m = self._range_m * values[7]
        ahead = np.sqrt(np.maximum(1.0 - self._sine**2 - self._up**2, 1e-6))
        sonar = np.stack([ahead, -self._sine, self._up], axis=1) * range_m[:, None]
        mounting = self._view.mounting(values)
        sonar = sonar + self._dive.drift(motion, mounting, values[3:6], ping, sonar)
        base = sonar @ mounting.T + values[3:6]
        turned = np.einsum("nij,nj->ni", motion.rotation[ping], base)
        return np.asarray(turned + motion.position_m[ping])

    def _look(self, values: Floats) -> Floats:
        """Return what each look sees, (L,)."""
        row, column, _ = self._places(values)
        return self._sample(self._ping, row, column)

    def _places(self, values: Floats) -> tuple[Floats, Floats, Floats]:
        """Return row, column and range, m, at which each look should see its point; (L,)."""
        dive, ping = self._dive, self._ping
        motion = dive.motion(float(values[6]))
        points = self._place(values, motion)
        mounting = self._view.mounting(values)
        turns = motion.rotation @ mounting
        places = motion.position_m + motion.rotation @ values[3:6]
        sonar = np.einsum("nji,nj->ni", turns[ping], points[self._point] - places[ping])
        range_m = np.sqrt(np.einsum("ni,ni->n", sonar, sonar))
        sonar = sonar - self._dive.drift(motion, mounting, values[3:6], ping, sonar)
        range_m = np.sqrt(np.einsum("ni,ni->n", sonar, sonar))
        row = range_m / (values[7] * dive.row_m) - 0.5
        column = (-sonar[:, 1] / range_m - dive.first_sine) / dive.sine_step
        return row, column, range_m

    def _sample(self, ping: Numbers, row: Floats, column: Floats) -> Floats:
        """Interpolate the features linearly."""
        _, rows, columns = self._features.shape
        row, column = np.clip(row, 0, rows - 1.001), np.clip(column, 0, columns - 1.001)
        i, j = row.astype(np.intp), column.astype(np.intp)
        down, right = row - i, column - j
        flat, at = self._features.reshape(-1), (ping * rows + i) * columns + j
        near = flat[at] * (1 - right) + flat[at + 1] * right
        far = flat[at + columns] * (1 - right) + flat[at + columns + 1] * right
        return np.asarray(near * (1 - down) + far * down, dtype=np.float64)

    def _sum(self, looks: Floats) -> Floats:
        """Add up numbers of the looks for each point."""
        return np.asarray(np.bincount(self._point, looks, self.points), dtype=np.float64)


@lru_cache(maxsize=1)
def features(dive: CalibrationDive, blur: Blur) -> NDArray[np.float32]:
    """Return the images blurred, less their background: spots and edges.

    The square root keeps the brightest echoes from outweighing all others. The rounds of a stage
    share the result: it is read-only.
    """
    floor = 2.0 * float(np.median(dive.images[:, ::4, ::4])) + 2.0
    root = np.sqrt(np.clip(dive.images - floor, 0.0, None))
    across = (0.0, blur.range_m / dive.row_m, blur.sine / dive.sine_step)
    spots = gaussian_filter(root, across)
    spots -= gaussian_filter(root, [BACKGROUND * width for width in across])
    found: NDArray[np.float32] = np.asarray(spots, dtype=np.float32)
    found.setflags(write=False)
    return found
