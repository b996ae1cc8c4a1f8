"""Hard cases of the particle filter: when random particles come, and when they must not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from mapperd import _core
from mapperd.localization.particle_filter import (
    Endpoints,
    FreeSpace,
    HitModel,
    LikelihoodField,
    ParticleFilter,
)
from tests.mapperd.localization.filter_cases import HIT, grid, pose, rule

if TYPE_CHECKING:
    from numpy.typing import NDArray

OCCUPANCY = np.zeros((50, 50), np.int8)
OCCUPANCY[:, 40] = 100
WATER = grid(OCCUPANCY, 0.5)
FIELD = LikelihoodField.of_grid(WATER, HIT)
FREE = FreeSpace(WATER)


def recovering(count: int, *, fewest: int | None = None) -> ParticleFilter:
    made = ParticleFilter(rule(fewest or count, count, alpha_slow=0.001, alpha_fast=0.1), 5)
    made.start_about(pose(12.0, 12.0, 0.0), np.diag([0.04, 0.04, 0.001]))
    return made


def scan(range_m: float, beams: int = 30) -> Endpoints:
    y = np.linspace(-3, 3, beams)
    return Endpoints(
        np.stack([np.full(beams, range_m), y], axis=1)[:, None, :].copy(), np.ones(beams)
    )


@pytest.mark.parametrize("aggregation", ["cube_sum", "product"])
@pytest.mark.parametrize("count", [100, 3000])
def test_recovery_with_a_constant_number_of_particles(aggregation: str, count: int) -> None:
    """A scan that fits nowhere brings random particles, with N constant too.

    Naively recovery hears the mean weight after normalisation, which is always 1 / N.
    """
    particles = recovering(count)
    for _ in range(5):
        particles.weigh_field(FIELD, scan(8.1), aggregation)
        particles.resample_if_due(FREE)
    assert particles.counts["injected_particles"] == 0
    for _ in range(3):
        particles.weigh_field(FIELD, scan(3.0), aggregation)
        particles.resample_if_due(FREE)
    assert particles.counts["injected_particles"] > 0


def test_random_particles_come_once_for_one_bad_moment() -> None:
    """What has been answered by random particles is forgotten.

    Naively the averages still remember it at the next update, and at hundreds after that: each
    brings random particles again, and the cloud never settles.
    """
    particles = recovering(3000)
    for range_m in (8.1, 8.1, 8.1, 3.0):
        particles.weigh_field(FIELD, scan(range_m))
        particles.resample_if_due(FREE)
    injected = particles.counts["injected_particles"]
    assert injected > 0
    for _ in range(3):
        assert particles.weigh_field(FIELD, scan(3.0)).injected_share < 0.01
        particles.resample_if_due(FREE)
    assert particles.counts["injected_particles"] - injected < 0.1 * injected


@pytest.mark.parametrize("aggregation", ["cube_sum", "product"])
def test_good_fit_triggers_no_recovery_though_numbers_change(aggregation: str) -> None:
    """A change of the number of particles is not a change of the fit.

    Naively, with 1 / N for a mean weight, a cloud that grows from 500 to 2000 looks lost.
    """
    particles = recovering(500)
    for count in (500, 2000, 4000, 300):
        particles.set_rule(rule(count, count, alpha_slow=0.001, alpha_fast=0.1))
        particles.weigh_field(FIELD, scan(8.1), aggregation)
        particles.resample_if_due(FREE)
    assert particles.counts["injected_particles"] < 10


@pytest.mark.parametrize("aggregation", ["cube_sum", "product"])
def test_fit_is_that_of_one_beam(aggregation: str) -> None:
    """How well a scan fits does not depend on how many beams it has.

    Naively a product over twice the beams is the square of a small number: the vehicle looks
    lost.
    """
    fits = []
    for beams in (30, 60, 240):
        particles = ParticleFilter(rule(1, 1), 5)
        particles.start_about(pose(12.0, 12.0, 0.0), np.zeros((3, 3)))
        fits.append(particles.weigh_field(FIELD, scan(8.1, beams), aggregation).fit)
    assert fits == pytest.approx([fits[0]] * 3, rel=1e-6)


def test_no_recovery_without_free_water() -> None:
    """Where no free cells are known, no random particles come.

    Naively they are drawn anywhere, or from an empty list.
    """
    particles = recovering(500)
    for range_m in (8.1, 8.1, 3.0, 3.0):
        particles.weigh_field(FIELD, scan(range_m))
        particles.resample_if_due(None)
    assert particles.counts["injected_particles"] == 0
    assert np.isfinite(particles.poses).all()


def seen_from(hits: NDArray[np.float64], at: NDArray[np.float64]) -> Endpoints:
    """Every third obstacle, as a sonar without shadows sees it."""
    cosine, sine = np.cos(at[2]), np.sin(at[2])
    turn = np.array([[cosine, -sine], [sine, cosine]])
    ends = ((hits - at[:2]) @ turn)[::3]
    return Endpoints(np.ascontiguousarray(ends[:, None, :]), np.ones(len(ends)))


def test_kidnapped_vehicle_is_found_again() -> None:
    """A vehicle that was carried off is found again.

    Naively all particles stay at the wrong place, for none is at the right one to be copied.
    """
    occupancy = np.zeros((40, 40), np.int8)
    occupancy[:, 36] = occupancy[4, 2:12] = occupancy[20:24, 8:12] = occupancy[33, 20:34] = 100
    water = grid(occupancy, 0.5)
    model = HitModel(z_hit=0.9, z_rand=0.1, sigma_hit_m=0.5, max_range_m=20, max_distance_m=5)
    field = LikelihoodField.of_grid(water, model)
    hits = np.argwhere(occupancy == 100)[:, ::-1].astype(np.float64) * 0.5 + 0.25
    home, truth = pose(5.0, 5.0, -2.0), pose(12.0, 10.0, 0.6)
    particles = ParticleFilter(rule(4000, 4000, alpha_slow=0.001, alpha_fast=0.9), 11)
    particles.start_about(home, np.diag([0.1, 0.1, 0.01]))
    free = FreeSpace(water)
    for k in range(60):
        particles.predict(home, home, "stationary", np.zeros(5))
        seen = seen_from(hits, home if k < 5 else truth)
        particles.weigh_field(field, seen, "product", 0.3)
        particles.resample_if_due(free)
    best, masses, _ = particles.modes(0.5, 0.35)
    assert best.mean == pytest.approx(truth, abs=0.2)
    assert masses[0] > 0.5


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_fit_that_is_no_number(wrong: float) -> None:
    """A fit that is not a number is passed over.

    Naively the running averages never forget a NaN or an infinity: recovery is off, or on, for
    ever.
    """
    recovery = _core.MclRecovery(0.1, 0.5)
    for fit in (1.0, wrong, 0.5):
        recovery.add(fit)
    assert recovery.injected_share == pytest.approx(1 - 0.75 / 0.95)


def test_fit_of_nothing_at_all() -> None:
    """A fit of 0 from the beginning asks for no random particles.

    Naively the share is 1 - 0 / 0, which is not a number, and no clamp makes it one.
    """
    recovery = _core.MclRecovery(0.1, 0.5)
    for _ in range(3):
        recovery.add(0.0)
    assert recovery.injected_share == 0.0
