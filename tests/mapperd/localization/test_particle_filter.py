"""Results of the particle filter for a scan, and what it refuses."""

import numpy as np
import pytest

from mapperd.localization.particle_filter import Endpoints, LikelihoodField, ParticleFilter
from tests.mapperd.localization.filter_cases import HIT, filter_at, grid, pose, rule

OCCUPANCY = np.zeros((50, 50), np.int8)
OCCUPANCY[:, 40] = 100
FIELD = LikelihoodField.of_grid(grid(OCCUPANCY, 0.5), HIT)
ENDS = Endpoints(np.array([[[8.1, 0.0]], [[8.1, 1.0]], [[7.6, 2.0]]]), np.ones(3))


def one_particle() -> ParticleFilter:
    particles = ParticleFilter(rule(1, 1), 5)
    particles.start_about(pose(12.0, 12.0, 0.0), np.zeros((3, 3)))
    return particles


def test_fit_does_not_depend_on_the_tempering() -> None:
    fits = [one_particle().weigh_field(FIELD, ENDS, "product", k).fit for k in (1.0, 0.5, 0.02)]
    assert fits == pytest.approx([fits[0]] * 3, rel=1e-6)


@pytest.mark.parametrize("kappa", [0.0, -0.1, 1.1, np.nan])
def test_tempering_that_is_invalid_is_refused(kappa: float) -> None:
    particles = one_particle()
    with pytest.raises(ValueError, match="tempering"):
        particles.weigh_field(FIELD, ENDS, "product", kappa)
    assert particles.counts["updates"] == 0


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_heading_that_is_no_number_is_a_refused_step(wrong: float) -> None:
    particles = one_particle()
    still, turned = pose(0, 0, 0), pose(0, 0, wrong)
    assert not particles.predict(still, turned, "differential_drive", np.zeros(5))
    assert not particles.predict(turned, still, "differential_drive", np.zeros(5))
    assert particles.counts["refused_steps"] == 2
    assert np.isfinite(particles.poses).all()


@pytest.mark.parametrize("wrong", [-0.1, np.nan, np.inf])
@pytest.mark.parametrize("floor", ["floor_xy_m", "floor_yaw_rad"])
def test_noise_that_is_no_number_is_refused(floor: str, wrong: float) -> None:
    particles = one_particle()
    before, still = particles.poses.copy(), pose(0, 0, 0)
    with pytest.raises(ValueError, match="floors of motion noise"):
        particles.predict(still, pose(1, 0, 0), "differential_drive", np.zeros(5), **{floor: wrong})
    assert np.array_equal(particles.poses, before)


def test_given_particles_have_headings_that_are_wrapped() -> None:
    particles = filter_at(np.array([pose(1, 2, 4.0), pose(1, 2, -9.0)]))
    assert particles.poses[:, 2] == pytest.approx([4.0 - 2 * np.pi, -9.0 + 2 * np.pi])


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_given_particles_that_are_no_numbers_are_refused(wrong: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        filter_at(np.array([pose(1, 2, 0), pose(1, wrong, 0)]))
