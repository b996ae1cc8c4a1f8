"""Clouds that are spread: drawn from a scan, kept from collapsing, light modes kept alive."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mapperd.localization.maps import GridMap
from mapperd.localization.models import core_grid, field_of
from mapperd.localization.particle_filter import (
    Endpoints,
    FilterParams,
    FreeSpace,
    LikelihoodField,
    ParticleFilter,
)
from tests.mapperd.localization.test_map_filter import config, room, scan_from

if TYPE_CHECKING:
    from numpy.typing import NDArray

TRUTH = (5.5, 3.5, 0.7)
SETTINGS = config("laser_model_type: likelihood_field_prob, laser_sigma_hit: 0.1")


def rule(
    count: int = 2000, *, share: float = 0.0, exponent: float = 1.0, recovery: float = 0.0
) -> FilterParams:
    return FilterParams(
        min_particles=count,
        max_particles=count,
        kld_error=0.05,
        kld_quantile=3.0,
        bucket_x_m=0.5,
        bucket_y_m=0.5,
        bucket_yaw_rad=0.17,
        least_effective_share=share,
        draw_exponent=exponent,
        alpha_fast=recovery,
    )


def ends_of(known: GridMap) -> tuple[FreeSpace, LikelihoodField, Endpoints]:
    scan = scan_from(TRUTH)
    ends = Endpoints(scan.points_m[:, None, :2].copy(), scan.quality)
    return FreeSpace(core_grid(known)), field_of(known, SETTINGS, 0.5), ends


def near(poses: NDArray[np.float64]) -> float:
    """Share of the poses that a following filter needs."""
    off = np.abs(poses - TRUTH)
    off[:, 2] = np.abs(np.angle(np.exp(1j * (poses[:, 2] - TRUTH[2]))))
    return float(np.mean((off < (0.4, 0.4, 0.2)).all(axis=1)))


def test_scan_reports_where_to_look() -> None:
    """Blindly a 500th of the cloud is near the truth, by the scan ten times as much."""
    free, field, ends = ends_of(room())
    blind, drawn = ParticleFilter(rule(), 3), ParticleFilter(rule(), 3)
    blind.start_anywhere(free)
    drawn.start_by_scan(free, field, ends, 100_000, 0.3)
    assert near(blind.poses) < 0.003
    assert near(drawn.poses) > 0.02
    assert np.ptp(drawn.weights) == 0.0
    assert len(np.unique(drawn.poses, axis=0)) == 2000


def test_scan_that_is_too_sharp_is_tempered_until_many_poses_count() -> None:
    """At full strength a few poses of 20 000 would carry all, and jitter hide it."""
    free, field, ends = ends_of(room())
    drawn = ParticleFilter(rule(), 3)
    drawn.start_by_scan(free, field, ends, 20_000, 1.0)
    cells = np.unique(np.round(drawn.poses / (0.5, 0.5, 0.5)), axis=0)
    assert len(cells) > 50


def test_threads_change_no_bit_of_a_search() -> None:
    free, field, ends = ends_of(room())
    found: list[Any] = []
    for threads in (1, 3):
        particles = ParticleFilter(rule(), 3, threads)
        particles.start_by_scan(free, field, ends, 50_001, 0.3)
        found.append(particles.poses)
    assert np.array_equal(*found)


def test_search_needs_as_many_poses_as_particles() -> None:
    free, field, ends = ends_of(room())
    with pytest.raises(ValueError, match="as many poses"):
        ParticleFilter(rule(), 3).start_by_scan(free, field, ends, 1999)


def test_search_without_a_surface_in_sight_keeps_all_poses() -> None:
    """Uninformative scans and scans without beams leave the cloud spread."""
    known = GridMap(np.zeros((60, 80), np.int8), 0.1)
    free, field, _ = ends_of(known)
    for ends in (ends_of(room())[2], Endpoints(np.empty((0, 1, 2)), np.empty(0))):
        particles = ParticleFilter(rule(), 3)
        particles.start_by_scan(free, field, ends, 5000)
        assert np.isfinite(particles.poses).all()
        assert np.ptp(particles.poses[:, 0]) > 7
        assert np.abs(particles.poses[:, 2]).max() <= np.pi  # also of those that jitter turned


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_sparse_cloud_keeps_its_share_of_the_effective_size(share: float) -> None:
    particles = ParticleFilter(rule(share=share), 3)
    particles.start_with(np.random.default_rng(1).normal(size=(2000, 3)))
    reported = -50.0 * np.random.default_rng(2).uniform(size=2000)
    weighed = particles.weigh(reported, 60)
    size = particles.effective_size()
    if share == 0.0:
        assert weighed.exponent == 1.0
        assert size < 100
        return
    assert share * 2000 <= size < 1.1 * share * 2000
    assert particles.log_weights - particles.log_weights.max() == pytest.approx(
        weighed.exponent * (reported - reported.max())
    )
    assert weighed.log_evidence == pytest.approx(math.log(np.exp(reported).mean()))


def test_scan_that_a_cloud_can_bear_counts_in_full() -> None:
    particles = ParticleFilter(rule(share=0.3), 3)
    particles.start_with(np.zeros((2000, 3)))
    reported = np.random.default_rng(2).uniform(-1, 0, 2000)
    assert particles.weigh(reported, 60).exponent == 1.0
    reported[5] = np.nan
    assert particles.weigh(reported, 60).exponent == 1.0
    assert np.isfinite(particles.poses).all()


@pytest.mark.parametrize("exponent", [1.0, 0.5])
def test_light_mode_keeps_its_weight_and_more_particles(exponent: float) -> None:
    """Two modes, the light one a thousandth: drawn by weight it has two particles left."""
    poses = np.zeros((2000, 3))
    poses[1000:, 0] = 9.0
    weights = np.where(poses[:, 0] > 5, 0.001, 1.0)
    particles = ParticleFilter(rule(exponent=exponent), 3)
    particles.start_with(poses, weights)
    particles.resample()
    light = particles.poses[:, 0] > 5
    mass = particles.weights[light].sum()
    if exponent == 1.0:
        assert light.sum() <= 3
        assert np.ptp(particles.weights) == 0.0
    else:
        assert 50 < light.sum() < 75
        assert mass == pytest.approx(0.001, rel=0.05)
    assert particles.weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("exponent", [1.0, 0.5])
def test_random_particles_weigh_as_much_as_others(exponent: float) -> None:
    """A sixteenth of the cloud, whatever its others keep of their parents' weight."""
    particles = ParticleFilter(rule(exponent=exponent, recovery=0.5), 3)
    poses = np.full((2000, 3), 100.0)
    particles.start_with(poses, np.random.default_rng(4).exponential(size=2000))
    particles.weigh(np.full(2000, -60.0), 60)
    share = particles.weigh(np.full(2000, -60.0 + 60 * np.log(0.875)), 60).injected_share
    assert share == pytest.approx(1 / 16)
    particles.resample(FreeSpace(core_grid(room())))
    random = particles.poses[:, 0] < 90
    assert random.mean() == pytest.approx(share, abs=0.02)
    assert particles.weights[random].sum() == pytest.approx(random.mean(), rel=0.02)
