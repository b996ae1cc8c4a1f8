"""Hard cases of the particle filter: weights."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.localization.particle_filter import (
    BeamModel,
    Beams,
    Endpoints,
    HitModel,
    LikelihoodField,
    ParticleFilter,
    RangeMap,
)
from tests.mapperd.localization.filter_cases import BEAM, HIT, filter_at, grid, pose, rule

Floats = NDArray[np.float64]
FAR = LikelihoodField.of_grid(grid(np.zeros((50, 50), np.int8), 0.5), HIT)


def cloud(count: int = 200, seed: int = 3) -> ParticleFilter:
    made = ParticleFilter(rule(50, count), seed)
    made.start_about(pose(12, 12, 0.3), np.diag([1.0, 1.0, 0.1]))
    return made


def scan(beams: int, range_m: float = 5.0) -> Endpoints:
    bearing = np.linspace(-1.1, 1.1, max(beams, 1))[:beams]
    ends = np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing)], axis=1)
    return Endpoints(np.ascontiguousarray(ends[:, None, :]), np.ones(beams))


def sound(particles: ParticleFilter) -> None:
    estimate = particles.estimate()
    assert np.isfinite(particles.poses).all()
    assert np.isfinite(particles.weights).all()
    assert particles.weights.sum() == pytest.approx(1, abs=1e-9)
    assert np.isfinite(estimate.mean).all()
    assert not np.isnan(estimate.covariance).any()


def distinct(particles: ParticleFilter) -> int:
    return len(np.unique(particles.poses, axis=0))


@pytest.mark.parametrize("beams", [140, 170, 256, 4096])
def test_product_underflow(beams: int) -> None:
    """The product of thousands of small densities keeps its logarithm.

    Naively multiplied, 256 missing beams are exactly 0, and every weight 0 / 0.
    """
    particles = cloud()
    weighed = particles.weigh_field(FAR, scan(beams), "product")
    assert weighed.informative
    assert weighed.log_evidence == pytest.approx(beams * np.log(FAR.background), rel=1e-6)
    sound(particles)


def test_all_weights_zero() -> None:
    """A scan that no particle explains leaves the weights there were, and is counted.

    Naively 0 / 0 makes all weights NaN, and resampling copies the first particle N times.
    """
    particles = cloud()
    before = particles.weights
    weighed = particles.weigh(np.full(200, -np.inf), 60)
    assert not weighed.informative
    assert (particles.weights == before).all()
    assert particles.counts["uninformative_scans"] == 1
    particles.resample()
    assert distinct(particles) > 40
    sound(particles)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_one_weight_not_a_number(wrong: float) -> None:
    """One particle's NaN costs that particle alone.

    Naively it makes the sum NaN, and with it every weight.
    """
    particles = cloud()
    logs = np.zeros(200)
    logs[17] = wrong
    assert particles.weigh(logs, 1).informative
    assert particles.weights[17] == 0
    assert particles.counts["not_a_number"] == 1
    sound(particles)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_all_weights_not_a_number(wrong: float) -> None:
    """Where no particle can be distinguished from another, the scan has no effect.

    Naively every weight is NaN, and so is the estimate.
    """
    particles = cloud()
    before = particles.weights
    assert not particles.weigh(np.full(200, wrong), 1).informative
    assert (particles.weights == before).all()
    sound(particles)


def test_weights_grow_without_resampling() -> None:
    """Likelihoods above 1 may be multiplied for ever.

    Naively their product overflows a double after some hundred scans, and infinity / infinity is
    NaN.
    """
    particles = cloud()
    for _ in range(2000):
        particles.weigh_field(FAR, scan(60), "cube_sum")
        particles.weigh(np.full(200, 700.0), 60)
    sound(particles)
    assert particles.effective_size() == pytest.approx(200)


@pytest.mark.parametrize("aggregation", ["cube_sum", "product"])
def test_empty_scan(aggregation: str) -> None:
    """A scan without beams changes no weight.

    Naively the sum over no beam is 0 for every particle, and after 0 / 0 one distinct particle is
    left.
    """
    particles = cloud()
    before = particles.weights
    none = np.zeros(0)
    ranges = RangeMap(grid(np.zeros((50, 50), np.int8), 0.5))
    empty = Beams(bearing_rad=none, range_m=none, quality=none)
    assert not particles.weigh_beams(ranges, empty, BEAM, aggregation).informative
    assert not particles.weigh_field(FAR, scan(0), aggregation).informative
    assert (particles.weights == before).all()
    assert particles.counts["empty_scans"] == 2
    particles.resample()
    assert distinct(particles) > 40


def test_no_random_readings_and_no_hit() -> None:
    """Without a floor of random readings a miss is very unlikely, not impossible.

    Naively the logarithm of 0 is minus infinity for all particles at once.
    """
    model = HitModel(z_hit=1.0, z_rand=0.0, sigma_hit_m=0.05, max_range_m=20.0, max_distance_m=2.0)
    occupancy = np.zeros((50, 50), np.int8)
    occupancy[25, 25] = 100
    particles = cloud()
    field = LikelihoodField.of_grid(grid(occupancy, 0.5), model)
    assert np.isfinite(particles.weigh_field(field, scan(60), "product").log_evidence)
    sound(particles)
    missed = cloud().weigh_field(field, scan(60, 20.0), "product")
    assert missed.log_evidence == pytest.approx(60 * np.log(1e-12 * model.density(0)), rel=1e-6)


def test_beams_that_no_particle_explains_without_random_readings() -> None:
    """A beam model without random readings takes a reading beside all that it expects.

    Naively each such beam is a factor of 0, and the evidence of the others is lost.
    """
    model = BeamModel(
        z_hit=1.0,
        z_short=0.0,
        z_max=0.0,
        z_rand=0.0,
        sigma_hit_m=0.05,
        lambda_short_per_m=0.1,
        max_range_m=20.0,
    )
    occupancy = np.zeros((50, 50), np.int8)
    occupancy[:, 40] = 100
    ranges = RangeMap(grid(occupancy, 0.5))
    seen = Beams(bearing_rad=np.zeros(60), range_m=np.full(60, 12.0), quality=np.ones(60))
    weighed = filter_at(pose(12, 12, 0).reshape(1, 3)).weigh_beams(ranges, seen, model, "product")
    peak = 1.0 / (0.05 * np.sqrt(2 * np.pi))
    assert weighed.log_evidence == pytest.approx(60 * np.log(1e-12 * peak), rel=1e-9)


def test_density_above_one() -> None:
    """Densities of several hundred a beam are summed as logarithms.

    Naively 256 of them multiplied overflow a double.
    """
    model = HitModel(z_hit=1.0, z_rand=0.1, sigma_hit_m=0.001, max_range_m=20.0, max_distance_m=2.0)
    field = LikelihoodField.of_grid(grid(np.full((50, 50), 100, np.int8), 0.5), model)
    for aggregation in ("cube_sum", "product"):
        particles = cloud()
        weighed = particles.weigh_field(field, scan(256), aggregation)
        assert np.isfinite(weighed.log_evidence)
        sound(particles)
    assert weighed.log_evidence == pytest.approx(256 * np.log(model.density(0)), rel=1e-6)


def test_field_in_single_precision() -> None:
    """The field's single-precision values are summed in double precision.

    Naively sums of 4096 float cubes lose digits at every addition.
    """
    values = np.full((50, 50), 0.1, np.float32)
    field = LikelihoodField.of_values(values, 0.5, pose(0, 0, 0), 0.1)
    particles = filter_at(pose(12, 12, 0).reshape(1, 3))
    evidence = particles.weigh_field(field, scan(4096)).log_evidence
    exact = np.log1p(4096 * float(np.float32(0.1)) ** 3)
    assert evidence == pytest.approx(exact, rel=1e-13)


def test_512_correlated_beams() -> None:
    """Beams that agree count as one if tempering is set so.

    Naively 512 copies of one reading are 512 votes, and the cloud collapses to one particle.
    """
    occupancy = np.zeros((50, 50), np.int8)
    occupancy[:, 40] = 100
    field = LikelihoodField.of_grid(grid(occupancy, 0.5), HIT)
    same = Endpoints(np.tile([[[8.0, 0.0]]], (512, 1, 1)), np.ones(512))
    sharp, tempered = cloud(2000), cloud(2000)
    sharp.weigh_field(field, same, "product", 1.0)
    tempered.weigh_field(field, same, "product", 1 / 512)
    alone = cloud(2000)
    alone.weigh_field(field, Endpoints(np.array([[[8.0, 0.0]]]), np.ones(1)), "product")
    assert tempered.effective_size() == pytest.approx(alone.effective_size(), rel=1e-9)
    for particles in (sharp, tempered):
        particles.resample()
        sound(particles)
    assert distinct(tempered) > 10


def test_one_particle_explains_everything() -> None:
    """Where one particle has all the weight, the spread is marked as unknown.

    Naively 1 - sum of squared weights is 0, and the covariance 0 / 0.
    """
    particles = cloud()
    logs = np.full(200, -1e9)
    logs[5] = 0
    particles.weigh(logs, 60)
    estimate = particles.estimate()
    assert not estimate.spread_known
    assert estimate.mean == pytest.approx(particles.poses[5])
    assert np.diag(estimate.covariance) == pytest.approx(1e-12)
    sound(particles)
    particles.resample()
    sound(particles)


@pytest.mark.parametrize("range_m", [0.0, 1e-9, 20.0, 1e9])
def test_range_of_nothing_and_beyond_all(range_m: float) -> None:
    """Readings of 0 and beyond the limit weigh all particles finitely.

    Naively a reading of 0 has no bearing, and one beyond the limit no density to take a logarithm
    of.
    """
    ranges = RangeMap(grid(np.zeros((50, 50), np.int8), 0.5))
    odd = Beams(bearing_rad=np.zeros(3), range_m=np.full(3, range_m), quality=np.ones(3))
    for aggregation in ("cube_sum", "product"):
        particles = cloud()
        particles.weigh_beams(ranges, odd, BEAM, aggregation)
        sound(particles)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_beam_not_a_number(wrong: float) -> None:
    """A reading that is not a number is refused before it counts.

    Naively it makes every particle's weight NaN.
    """
    with pytest.raises(ValueError, match="finite"):
        Beams(bearing_rad=np.zeros(1), range_m=np.array([wrong]), quality=np.ones(1))
    with pytest.raises(ValueError, match="finite"):
        Endpoints(np.array([[[1.0, wrong]]]), np.ones(1))
