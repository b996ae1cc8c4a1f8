"""Consistency of the filter's covariance: NEES over seeded runs.

NEES is e' P^-1 e of the error e and the covariance P; of three consistent numbers its mean is 3.
Beams of a multibeam sonar overlap: neighbours hear one echo, and are wrong together. To a log
product each is a witness of its own, so that it is too sure; tempering takes that back.
"""

import math

import numpy as np
from numpy.typing import NDArray

from mapperd.localization.particle_filter import (
    Endpoints,
    HitModel,
    LikelihoodField,
    ParticleFilter,
    RangeMap,
)
from tests.mapperd.localization.filter_cases import grid
from tests.mapperd.localization.filter_cases import rule as filter_params

Floats = NDArray[np.float64]

RUNS = 100
STEPS = 12
BEAMS = 120
TOGETHER = 6
"""Beams that hear one echo."""

MAX_RANGE_M = 20.0
STEP = (0.3, 0.0, 0.05)
ALPHAS = np.array([0.02, 0.0, 0.01, 0.0, 0.01])


def harbour() -> NDArray[np.int8]:
    """30 m x 30 m at 0.1 m: two quays, piles, a hull."""
    cells = np.zeros((300, 300), dtype=np.int8)
    cells[280:, :] = cells[:, 285:] = 100
    for k in range(6):
        cells[40 + 40 * k : 44 + 40 * k, 30:34] = 100
    cells[60:75, 150:210] = 100
    return cells


GRID = grid(harbour(), 0.1)
RANGES = RangeMap(GRID)
FIELD = LikelihoodField.of_grid(
    GRID,
    HitModel(z_hit=0.8, z_rand=0.2, sigma_hit_m=0.2, max_range_m=MAX_RANGE_M, max_distance_m=2.0),
    only_boundaries=True,
)


def scan_at(pose: Floats, random: np.random.Generator) -> Endpoints:
    """40 % hear nothing, 8 % a fish, 8 % a way round; neighbours are wrong together."""
    bearing = np.linspace(-1.1, 1.1, BEAMS)
    rays = np.column_stack([np.tile(pose[:2], (BEAMS, 1)), pose[2] + bearing])
    truth = RANGES.cast(np.ascontiguousarray(rays), MAX_RANGE_M)
    shared = np.repeat(random.normal(0.0, 0.2, BEAMS // TOGETHER), TOGETHER)
    centre_m = 0.05  # a ray ends at its cell's edge
    seen = truth + centre_m + shared + random.normal(0.0, 0.03, BEAMS)
    what = random.random(BEAMS)
    seen = np.where(what < 0.08, random.uniform(1.0, np.maximum(seen, 1.1)), seen)
    seen = np.where(what > 0.92, seen + random.exponential(2.0, BEAMS), seen)
    kept = (truth > 0) & (truth < MAX_RANGE_M) & (random.random(BEAMS) > 0.4)
    ends = np.column_stack([seen * np.cos(bearing), seen * np.sin(bearing)])[kept]
    return Endpoints(np.ascontiguousarray(ends[:, None, :]), np.ones(len(ends)))


def moved(pose: Floats, step: Floats) -> Floats:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    there: Floats = pose + np.array([c * step[0] - s * step[1], s * step[0] + c * step[1], step[2]])
    return there


def nees_of_run(seed: int, kappa: float) -> float:
    random = np.random.default_rng(seed)
    truth = np.array([random.uniform(8, 18), random.uniform(10, 20), random.uniform(-3, 3)])
    odom = np.zeros(3)
    sigma = np.array([0.3, 0.3, 0.05])
    particles = ParticleFilter(filter_params(1000, 1000), seed)
    particles.start_about(truth + random.normal(0.0, sigma), np.diag(sigma**2))
    for _ in range(STEPS):
        reported = np.array(STEP)
        truth = moved(truth, reported + random.normal(0.0, 1.0, 3) * (0.03, 0.03, 0.007))
        before, odom = odom, moved(odom, reported)
        particles.predict(before, odom, "omnidirectional_drive", ALPHAS)
        particles.weigh_field(FIELD, scan_at(truth, random), "product", kappa)
        estimate = particles.estimate()
        particles.resample()
    error = estimate.mean - truth
    error[2] = math.remainder(error[2], math.tau)
    return float(error @ np.linalg.solve(estimate.covariance, error))


def nees(kappa: float) -> Floats:
    return np.array([nees_of_run(seed, kappa) for seed in range(RUNS)])


BEYOND = 11.34
"""One in a hundred of a true covariance's."""


def test_plain_log_product_is_too_sure() -> None:
    found = nees(1.0)
    assert found.mean() > 6.0
    assert (found > BEYOND).mean() > 0.1


def test_tempered_log_product_is_as_sure_as_it_may_be() -> None:
    """The mean of 100 lies within three of its deviations above 3; and the cloud is no fog."""
    found = nees(0.2)
    assert 1.0 < found.mean() < 3.0 + 3.0 * math.sqrt(6.0 / RUNS)
    assert (found > BEYOND).mean() <= 0.05
