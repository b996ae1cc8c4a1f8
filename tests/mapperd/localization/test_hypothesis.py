"""A second cloud against the first: who wins, and when."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.hypothesis import FADE, LONG_ODDS, AlternativeHypothesis, same_place
from mapperd.localization.map_filter import MapFilter
from mapperd.localization.particle_filter import ParticleFilter
from mapperd.localization.update_gate import PlanarPose
from tests.mapperd.localization.filter_cases import rule
from tests.mapperd.localization.test_map_filter import room, scan_from

SIGMA = np.diag([0.1**2, 0.1**2, 0.05**2])


def profile(ours: str = "alternative_interval: 2.0", policy: str = "seq") -> Config:
    """The settings that docs/guides/localization.md recommends, for a small room."""
    return config_from_text(f"""
amcl:
  execution_policy: {policy}
  robot_model_type: omnidirectional_drive
  laser_model_type: likelihood_field_prob
  laser_max_range: 10
  laser_sigma_hit: 0.1
  laser_z_hit: 0.7
  laser_z_rand: 0.3
  max_particles: 3000
  min_particles: 300
  resample_interval: 1
  selective_resampling: true
  recovery_alpha_fast: 0
  recovery_alpha_slow: 0
  odom_alpha1: 0.01
  odom_alpha2: 0.001
  odom_alpha3: 0.01
  odom_alpha4: 0.001
  odom_alpha5: 0.01
localization:
  tempering: 0.1
  tempering_spread: 0.2
  search_poses: 60000
  search_sigma: 0.3
  least_effective_share: 0.3
  draw_exponent: 0.5
  {ours}
""")


def path(count: int) -> list[tuple[float, float, float]]:
    """Around the room's middle."""
    turn = np.arange(count) * 0.1
    return [(4 + 1.5 * math.cos(t), 3.2 + 1.5 * math.sin(t), t + math.pi / 2) for t in turn]


def drive(
    particles: MapFilter, seen: list[tuple[float, float, float]], first: int = 0
) -> list[Belief]:
    """Odometry is exact; scans are those of the poses."""
    found, before = [], PlanarPose(*seen[0])
    for k, pose in enumerate(seen):
        now = PlanarPose(*pose)
        found.append(particles.update(before, now, scan_from(pose, (first + k) * 10**9), 0.0))
        before = now
    return found


def off_m(found: Belief, pose: tuple[float, float, float]) -> float:
    return math.hypot(found.best.x_m - pose[0], found.best.y_m - pose[1])


def cloud_at(x: float, spread_m: float = 0.01) -> ParticleFilter:
    made = ParticleFilter(rule(), 1)
    made.start_about(np.array([x, 0.0, 3.1]), np.diag([spread_m**2, spread_m**2, 1e-4]))
    return made


def test_odds_follow_bayes_and_fade() -> None:
    alternative = AlternativeHypothesis(cloud_at(0))
    assert alternative.share == pytest.approx(1e-3, rel=2e-3)
    reported = alternative.weighed(0.6, 0.2, 6.0)
    assert reported.log_odds == pytest.approx((1 - FADE) * LONG_ODDS + 6.0 * math.log(3.0))
    assert alternative.weighed(0.0, 0.2, 6.0) == alternative.weighed(0.2, 0.0, 6.0) == alternative
    assert not alternative.leads
    assert reported.weighed(0.6, 0.2, 6.0).leads
    assert alternative.weighed(1e-300, 1.0, 1e6).share < 1e-20


def test_rival_is_hopeless_only_after_its_trial() -> None:
    lost = AlternativeHypothesis(cloud_at(0), -20.0)
    assert not lost.hopeless
    assert lost.driven(1.1).hopeless
    assert not AlternativeHypothesis(cloud_at(0)).driven(1.1).hopeless


def test_clouds_are_at_the_same_place_if_each_is_at_one() -> None:
    here = cloud_at(0).estimate()
    assert same_place(here, cloud_at(0.3).estimate())
    assert not same_place(here, cloud_at(1.5).estimate())
    assert not same_place(here, cloud_at(0, spread_m=2.0).estimate())


def test_clouds_that_head_along_pi_are_at_the_same_place() -> None:
    clouds = []
    for yaw_rad in (math.pi - 0.01, 0.01 - math.pi):
        particles = ParticleFilter(rule(200, 200), 5)
        particles.start_about(np.array([1.0, 1.0, yaw_rad]), np.diag([1e-4, 1e-4, 1e-6]))
        clouds.append(particles.estimate())
    assert same_place(*clouds)


@pytest.mark.slow
def test_vehicle_that_is_carried_off_is_reported_and_is_found_again() -> None:
    particles = MapFilter(profile())
    particles.take_map(room())
    there = path(90)
    particles.start_at(PlanarGaussian(*there[0], SIGMA))
    assert off_m(drive(particles, there[:20])[-1], there[19]) < 0.15
    # Put to the other side and turned: odometry goes on as if nothing had been.
    turned = [(8 - x, 6.4 - y, yaw + 2.0) for x, y, yaw in there]
    found = drive(particles, turned[:1] + turned[20:], 20)
    assert off_m(found[1], turned[20]) > 1.0
    assert any(one.ambiguous for one in found[1:15])
    assert off_m(found[-1], turned[-1]) < 0.15
    assert not found[-1].ambiguous


def test_without_alternatives_it_stays_lost_and_is_reported() -> None:
    particles = MapFilter(profile("alternative_interval: 0"))
    particles.take_map(room())
    there = path(60)
    particles.start_at(PlanarGaussian(1.0, 5.0, 2.0, SIGMA))
    found = drive(particles, there)
    assert off_m(found[-1], there[-1]) > 0.5
    assert found[-1].elsewhere < 0.1
    assert found[-1].ambiguous


def test_model_that_reports_no_hits_keeps_no_verdict_of_one_that_did() -> None:
    particles = MapFilter(profile("alternative_interval: 1"))
    particles.take_map(room())
    there = path(40)
    particles.start_at(PlanarGaussian(1.0, 5.0, 2.0, SIGMA))
    tried = 0
    while particles.alternative is None or particles.watch.fits(0.4):
        drive(particles, there[tried : tried + 2], tried)
        tried += 1
    other = profile("alternative_interval: 1")
    cubes = structs.replace(other.amcl, laser_model_type="likelihood_field")
    particles.reconfigure(structs.replace(other, amcl=cubes))
    found = drive(particles, there[tried : tried + 2], tried)[-1]
    assert found.fits
    assert particles.alternative is None


@pytest.mark.slow
def test_vehicle_that_is_followed_is_not_thrown_off() -> None:
    particles = MapFilter(profile())
    particles.take_map(room())
    there = path(120)
    particles.start_at(PlanarGaussian(*there[0], SIGMA))
    first = particles.particles
    found = drive(particles, there)
    assert particles.alternatives >= 3
    assert particles.particles is first
    assert max(off_m(one, pose) for one, pose in zip(found[5:], there[5:], strict=True)) < 0.3
    assert not any(one.ambiguous for one in found[5:])


@pytest.mark.slow
def test_both_policies_and_two_runs_give_equal_bits() -> None:
    found: list[Any] = []
    for policy in ("seq", "par", "par"):
        particles = MapFilter(profile(policy=policy))
        particles.take_map(room())
        particles.start_anywhere()
        drive(particles, path(25))
        assert particles.alternatives > 0
        found.append(particles.particles.poses)
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[1], found[2])


def test_odometry_that_is_no_number_neither_moves_nor_counts() -> None:
    particles = MapFilter(profile())
    particles.take_map(room())
    there = path(40)
    particles.start_at(PlanarGaussian(*there[0], SIGMA))
    drive(particles, there[:5])
    lost = PlanarPose(math.nan, 0.0, 0.0)
    particles.update(lost, lost, scan_from(there[4], 5 * 10**9), 0.0)
    found = drive(particles, there[4:], 6)
    assert particles.alternatives > 0
    assert off_m(found[-1], there[-1]) < 0.15


def test_cloud_that_found_itself_by_few_beams_is_not_drawn_again() -> None:
    particles = MapFilter(profile())
    particles.take_map(room())
    particles.start_anywhere()
    here = np.tile([4.0, 3.0, 0.0], (1000, 1))
    particles.particles.start_with(here)
    found = particles.update(
        PlanarPose(4, 3, 0), PlanarPose(4, 3, 0), scan_from((2.0, 4.0, 1.0)), 0.0
    )
    assert found.overall.x_m == pytest.approx(4.0)


def test_clouds_that_change_places_keep_their_odds() -> None:
    first, second = ParticleFilter(rule(), 1), ParticleFilter(rule(), 2)
    changed = AlternativeHypothesis(second, 1.25, 7.0).changed(first)
    assert changed.particles is first
    assert (changed.log_odds, changed.way_m) == (-1.25, 7.0)
