"""Hard cases of the particle filter: motion, headings, estimates, numbers of particles, seeds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mapperd.localization.particle_filter import FreeSpace, ParticleFilter, belief
from tests.mapperd.localization.filter_cases import filter_at, grid, pose, rule

if TYPE_CHECKING:
    from numpy.typing import NDArray

PI = math.pi
MODELS = ("differential_drive", "omnidirectional_drive", "stationary")
NOISY = np.full(5, 0.2)


def cloud(count: int = 500, seed: int = 3, **how: float) -> ParticleFilter:
    made = ParticleFilter(rule(50, count, **how), seed)  # type: ignore[arg-type]
    made.start_about(pose(1, 2, 3), np.diag([0.5, 0.5, 0.5]))
    return made


@pytest.mark.parametrize("model", MODELS[:2])
def test_alphas_zero(model: str) -> None:
    """Motion without noise is exactly that of the odometry.

    Naively a sample is divided by a sigma of 0.
    """
    particles = filter_at(np.zeros((50, 3)))
    particles.predict(pose(0, 0, 0), pose(1, 2, 0.5), model, np.zeros(5))
    assert np.ptp(particles.poses, axis=0) == pytest.approx(0, abs=0)
    assert particles.poses[0] == pytest.approx((1, 2, 0.5), abs=1e-12)


@pytest.mark.parametrize("model", MODELS[:2])
def test_no_motion(model: str) -> None:
    """Where the odometry stands still, so do the particles.

    Naively the bearing atan2(0, 0) of no translation counts as a turn, and noise comes of it.
    """
    particles = cloud()
    before = particles.poses
    particles.predict(pose(4, 5, 1), pose(4, 5, 1), model, NOISY)
    assert particles.poses == pytest.approx(before, abs=1e-15)


def test_no_motion_with_a_floor_keeps_the_cloud_alive() -> None:
    """At rest, least noises keep the particles apart.

    Naively every update resamples copies of fewer and fewer particles, until one is left.
    """
    particles = cloud()
    for _ in range(300):
        particles.predict(pose(0, 0, 0), pose(0, 0, 0), MODELS[0], NOISY, 0.01, 0.01)
        particles.weigh(-0.5 * particles.poses[:, 0] ** 2, 1)
        particles.resample()
    particles.predict(pose(0, 0, 0), pose(0, 0, 0), MODELS[0], NOISY, 0.01, 0.01)
    assert len(np.unique(particles.poses, axis=0)) == len(particles)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e9])
def test_odometry_jump_and_odometry_not_a_number(model: str, wrong: float) -> None:
    """A step that is not a number, or longer than the vehicle can go, moves nothing.

    Naively NaN enters every pose and never leaves, and a jump throws the cloud off the map.
    """
    particles = cloud(max_step_m=5.0)
    before = particles.poses
    for axis in range(2):
        bad = pose(0, 0, 0)
        bad[axis] = wrong
        assert not particles.predict(pose(0, 0, 0), bad, model, NOISY)
        assert not particles.predict(bad, pose(0, 0, 0), model, NOISY)
    assert particles.counts["refused_steps"] == 4
    assert (particles.poses == before).all()


def test_negative_and_nan_alphas_are_refused() -> None:
    """Noise parameters below 0, or no numbers, are refused.

    Naively the square root of a negative variance makes every pose NaN.
    """
    for wrong in (-0.1, np.nan):
        with pytest.raises(ValueError, match="alphas"):
            cloud().predict(pose(0, 0, 0), pose(1, 0, 0), MODELS[0], np.full(5, wrong))


def test_headings_around_pi() -> None:
    """Headings on both sides of pi have their mean at pi.

    Naively, averaged as numbers, pi - 0.01 and -pi + 0.01 look the other way.
    """
    particles = filter_at(np.array([(0, 0, PI - 0.01), (0, 0, 0.01 - PI)]))
    estimate = particles.estimate()
    assert abs(estimate.mean[2]) == pytest.approx(PI, abs=1e-12)
    assert estimate.covariance[2, 2] == pytest.approx(1e-4, rel=1e-3)


def test_cross_terms_around_pi() -> None:
    """Covariances of place and heading hold across pi.

    Naively differences of headings are multiplied unwrapped, and are off by whole turns.
    """
    off = np.linspace(-0.2, 0.2, 41)
    poses = np.stack([off, 0 * off, np.remainder(PI + off + PI, 2 * PI) - PI], axis=1)
    covariance = filter_at(poses).estimate().covariance
    assert covariance[0, 2] == pytest.approx(float(np.mean(off**2)), rel=1e-2)


def test_opposite_headings() -> None:
    """Two opposite headings have no mean, which is reported.

    Naively the mean vector of length 0 has an angle made of rounding, and a logarithm of minus
    infinity.
    """
    estimate = filter_at(np.array([(0, 0, 0.4), (1, 0, 0.4 - PI)])).estimate()
    assert not estimate.heading_known
    assert estimate.mean[2] == 0
    assert estimate.covariance[2, 2] == np.inf
    assert not np.isnan(estimate.covariance).any()


def test_opposite_headings_in_a_message() -> None:
    """An unknown heading leaves as the largest finite variance.

    Naively infinity goes into a message: it is no JSON number, and no matrix with it has
    eigenvalues.
    """
    two = filter_at(np.array([(0, 0, 0.4), (0.05, 0, 0.4 - PI)]))
    overall = belief(two).overall
    assert overall.covariance[2, 2] == pytest.approx(PI**2)
    assert np.isfinite(overall.covariance).all()
    nearly = filter_at(np.array([(0, 0, 0.4), (0.05, 0, 0.4 - PI + 1e-6)]))
    assert belief(nearly).overall.covariance[2, 2] == pytest.approx(PI**2)


def test_mean_vector_rounded_above_one() -> None:
    """The spread of equal headings is 0 or a little more, never imaginary.

    Naively the length R of the mean vector is rounded to 1 and an ulp, and -2 ln R is negative.
    """
    for yaw in np.linspace(-PI, PI, 501):
        estimate = filter_at(np.tile(pose(0, 0, yaw), (7, 1))).estimate()
        assert estimate.covariance[2, 2] >= 1e-12
        assert estimate.covariance[2, 2] < 1e-9


def test_covariance_far_from_the_origin() -> None:
    """A spread of a centimetre is resolved at 1e7 m from the origin.

    Naively, as mean of squares less square of the mean, no digit of it is left there.
    """
    generator = np.random.default_rng(5)
    near = generator.normal(0, 0.01, (5000, 3))
    far = near + pose(1e7, -1e7, 0)
    a, b = filter_at(near).estimate(), filter_at(far).estimate()
    assert a.covariance[:2, :2] == pytest.approx(b.covariance[:2, :2], rel=1e-3, abs=1e-8)


def test_one_particle() -> None:
    """One particle is an estimate, marked as one without a spread.

    Naively the covariance is divided by N - 1, which is 0.
    """
    one = filter_at(np.array([(1.0, 2.0, 3.0)]))
    estimate = one.estimate()
    assert estimate.mean == pytest.approx((1, 2, 3))
    assert not estimate.spread_known
    one.weigh(np.zeros(1), 1)
    one.resample()
    best, masses, _ = one.modes()
    assert best.mean == pytest.approx((1, 2, 3))
    assert masses == pytest.approx([1.0])


def test_no_particles() -> None:
    """Before the first pose every question has an answer.

    Naively means of nothing are 0 / 0, and the heaviest of no particles is read from before the
    list.
    """
    none = ParticleFilter(rule(), 1)
    assert none.predict(pose(0, 0, 0), pose(1, 0, 0), MODELS[0], NOISY)
    assert not none.weigh(np.zeros(0), 60).informative
    none.resample()
    assert len(none) == 0
    assert none.effective_size() == 0
    assert none.estimate().particles == 0
    assert len(none.modes()[1]) == 0


def test_identical_particles() -> None:
    """A cloud in one point has a covariance that can be inverted.

    Naively its variances are 0, and its inverse is infinite downstream.
    """
    estimate = filter_at(np.tile(pose(1, 1, 1), (300, 1))).estimate()
    assert np.linalg.inv(estimate.covariance) == pytest.approx(np.eye(3) * 1e12)


def test_converged_cloud_is_cheap() -> None:
    """A cloud that fits one bucket takes the fewest particles.

    Naively the limit is not defined for one bucket, and perfectly converged clouds take the most
    particles of all.
    """
    particles = ParticleFilter(rule(50, 5000), 1)
    particles.start_about(pose(0.25, 0.25, 0.05), np.diag([1e-6, 1e-6, 1e-6]))
    particles.resample()
    assert len(particles) == 50
    spread = ParticleFilter(rule(50, 5000), 1)
    spread.start_about(pose(0, 0, 0), np.diag([25.0, 25.0, 1.0]))
    spread.resample()
    assert len(spread) > 1000


@pytest.mark.parametrize(
    "wrong",
    [
        {"kld": (0.0, 3.0)},
        {"kld": (-0.1, 3.0)},
        {"kld": (np.nan, 3.0)},
        {"kld": (0.05, -1.0)},
        {"bucket_m": 0.0},
        {"bucket_m": np.nan},
        {"bucket_yaw_rad": 0.0},
        {"resample_interval": 0},
        {"min_particles": 0},
        {"min_particles": 3000},
        {"max_particles": 10**8},
        {"alpha_slow": 0.1, "alpha_fast": 0.01},
        {"alpha_fast": 1.5},
        {"alpha_slow": np.nan, "alpha_fast": np.nan},
        {"max_step_m": 0.0},
    ],
)
def test_settings_without_meaning(wrong: dict[str, float]) -> None:
    """Settings that cannot be meant are refused, each by name.

    Naively an error of 0 wants infinitely many particles, and an interval of 0 is a modulo by
    zero.
    """
    with pytest.raises(ValueError, match=r".+"):
        rule(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "covariance",
    [
        np.zeros((3, 3)),
        np.ones((3, 3)),
        np.diag([1.0, 0.0, 0.0]),
        np.diag([1.0, -1e-18, 0.0]),
        np.diag([1e12, 1e-12, 1e-12]),
    ],
    ids=["nothing", "rank 1", "one axis", "rounded below 0", "ill-conditioned"],
)
def test_singular_initial_covariance(covariance: NDArray[np.float64]) -> None:
    """A covariance of lower rank, or with an axis rounded below 0, draws a finite cloud.

    Naively Cholesky fails on it, or the square root of -1e-18 makes poses NaN.
    """
    particles = ParticleFilter(rule(), 1)
    particles.start_about(pose(1, 2, 3), covariance)
    assert np.isfinite(particles.poses).all()


@pytest.mark.parametrize(
    "covariance",
    [
        np.diag([1.0, -1.0, 1.0]),
        np.array([[1.0, 0.5, 0], [0.0, 1, 0], [0, 0, 1]]),
        np.diag([np.nan, 1, 1]),
        np.diag([np.inf, 1, 1]),
    ],
    ids=["negative", "asymmetric", "not a number", "infinite"],
)
def test_initial_covariance_that_is_invalid(covariance: NDArray[np.float64]) -> None:
    """A matrix that is not a covariance is refused, and the cloud there was is kept.

    Naively half of it is used, or NaN is drawn into every particle.
    """
    particles = cloud()
    before = particles.poses
    with pytest.raises(ValueError, match="covariance"):
        particles.start_about(pose(0, 0, 0), covariance)
    assert (particles.poses == before).all()


def test_initial_covariance_rounded_asymmetric() -> None:
    """A covariance whose halves differ in the last digits is taken as meant.

    Naively one that was written as text and read again is refused for not being symmetric.
    """
    covariance = np.array([[1.0, 0.5, 0], [0.5 + 1e-12, 1, 0], [0, 0, 1]])
    ParticleFilter(rule(), 1).start_about(pose(0, 0, 0), covariance)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_initial_pose_not_a_number(wrong: float) -> None:
    """A start at no number is refused, and the cloud there was is kept.

    Naively all particles become NaN, and no later scan brings one back.
    """
    particles = cloud()
    before = particles.poses
    with pytest.raises(ValueError, match="finite"):
        particles.start_about(pose(0, wrong, 0), np.eye(3))
    with pytest.raises(ValueError, match="finite"):
        particles.start_with(np.array([[0, 0, wrong]]))
    assert (particles.poses == before).all()


def test_heading_turns_for_ever() -> None:
    """Headings stay within one turn however long a vehicle circles.

    Naively they grow: one heading occupies ever more buckets, and its sine loses digits.
    """
    particles = cloud(200)
    yaw = 0.0
    for _ in range(5000):
        particles.predict(pose(0, 0, yaw), pose(0, 0, yaw + 2.5), MODELS[1], np.zeros(5))
        yaw += 2.5
    headings = particles.poses[:, 2]
    assert (headings > -PI).all()
    assert (headings <= PI).all()
    expected = np.remainder(cloud(200).poses[:, 2] + yaw + PI, 2 * PI) - PI
    assert np.abs(np.sin(0.5 * (headings - expected))).max() < 1e-9


def run(seed: int, threads: int) -> NDArray[np.float64]:
    particles = ParticleFilter(rule(500, 2000, alpha_slow=0.01, alpha_fast=0.5), seed, threads)
    particles.start_about(pose(1, 1, 0), np.diag([1.0, 1.0, 0.5]))
    free = FreeSpace(grid(np.zeros((20, 20), np.int8), 0.5))
    for k in range(10):
        particles.predict(pose(0, 0, 0), pose(0.1, 0, 0.1), MODELS[k % 3], NOISY, 0.01, 0.01)
        particles.weigh(-(particles.poses[:, 0] ** 2) - k, 10)
        particles.resample_if_due(free)
    assert particles.counts["injected_particles"] > 0
    return particles.poses


def test_one_seed_is_one_run_on_any_number_of_threads() -> None:
    """Equal seeds give equal particles, on any number of threads.

    Naively each thread draws from a generator of its own, and no run can be repeated.
    """
    first = run(7, 1)
    for threads in (1, 2, 5):
        assert (run(7, threads) == first).all()
    assert run(8, 1).shape != first.shape or not (run(8, 1) == first).all()


def test_initialising_does_not_restart_the_generator() -> None:
    """Each start draws other particles.

    Naively a generator seeded again by every start draws the same unlucky cloud again and again.
    """
    particles = cloud()
    first = particles.poses
    particles.start_about(pose(1, 2, 3), np.diag([0.5, 0.5, 0.5]))
    assert not (particles.poses == first).any()
