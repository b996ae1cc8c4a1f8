"""A searched pose is ambiguous until an independent search agrees, and so is one that scans deny.

Searches are scripted: each draws its cloud around the pose that the test has for it.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.hypothesis import MAX_UNSUPPORTED, FitWatch
from mapperd.localization.map_filter import FilterState, MapFilter
from mapperd.localization.particle_filter import ParticleFilter
from mapperd.localization.scan import Scan
from mapperd.localization.update_gate import PlanarPose
from mapperd.localization.weighting import MapWeighing
from mapperd.store.checkpoint import decode_state, encode_state
from tests.mapperd.localization.test_hypothesis import SIGMA, drive, off_m, path, profile
from tests.mapperd.localization.test_map_filter import room, scan_from

Pose = tuple[float, float, float]

THERE = path(90)
SECOND_NS = 10**9


def elsewhere(pose: Pose) -> Pose:
    """On the other side of the room's middle, facing the other way."""
    return (8 - pose[0], 6.4 - pose[1], pose[2] + math.pi)


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Pose], Pose]], list[int]]:
    """Have searches find what a function makes of the true pose; the list gets their updates."""

    def write(find: Callable[[Pose], Pose]) -> list[int]:
        searched: list[int] = []

        def draw(_: MapWeighing, particles: ParticleFilter, scan: Scan, __: float) -> None:
            searched.append(scan.stamp_ns // SECOND_NS)
            particles.start_about(np.array(find(THERE[searched[-1]])), SIGMA)

        monkeypatch.setattr(MapWeighing, "draw", draw)
        return searched

    return write


def on_the_map() -> MapFilter:
    particles = MapFilter(profile())
    particles.take_map(room())
    return particles


def first_sure(found: list[Belief]) -> int | None:
    return next((k for k, one in enumerate(found) if not one.ambiguous), None)


def test_searched_pose_is_ambiguous_until_a_search_agrees(script: Any) -> None:
    searched = script(lambda pose: pose)
    particles = on_the_map()
    particles.start_anywhere()
    found = drive(particles, THERE)
    sure = first_sure(found)
    assert sure is not None
    assert len([k for k in searched if k <= sure]) == 2
    assert max(off_m(one, pose) for one, pose in zip(found[5:], THERE[5:], strict=True)) < 0.3
    assert not any(one.ambiguous for one in found[sure:])


@pytest.mark.slow
def test_searches_that_find_other_places_keep_a_pose_ambiguous(script: Any) -> None:
    first = iter([True])
    searched = script(lambda pose: pose if next(first, False) else elsewhere(pose))
    particles = on_the_map()
    particles.start_anywhere()
    found = drive(particles, THERE)
    assert len(searched) > 5
    assert off_m(found[-1], THERE[-1]) < 0.15
    assert found[-1].elsewhere < 0.1
    assert all(one.ambiguous for one in found)


def test_given_pose_needs_no_agreement(script: Any) -> None:
    script(elsewhere)
    particles = on_the_map()
    particles.start_at(PlanarGaussian(*THERE[0], SIGMA))
    assert first_sure(drive(particles, THERE[:9])) == 0


def test_alternative_that_takes_over_needs_agreement(script: Any) -> None:
    searched = script(lambda pose: pose)
    particles = on_the_map()
    wrong = PlanarGaussian(*elsewhere(THERE[0]), SIGMA)
    particles.start_at(wrong)
    found = drive(particles, THERE)
    right = next(k for k, pose in enumerate(THERE) if off_m(found[k], pose) < 0.3)
    sure = next(k for k in range(right, len(found)) if not found[k].ambiguous)
    assert any(right <= k < sure for k in searched)
    assert not found[-1].ambiguous


def test_last_estimate_is_no_more_certain_on_a_new_map(script: Any) -> None:
    script(lambda pose: pose)
    particles = on_the_map()
    particles.start_anywhere()
    last = drive(particles, THERE[:4])[-1].best
    particles.take_map(room())
    particles.start_at(last, given=False)
    assert drive(particles, THERE[3:5], 3)[-1].ambiguous
    particles.start_at(last)
    assert not drive(particles, THERE[3:5], 3)[-1].ambiguous


@pytest.mark.parametrize("model", ["likelihood_field", "likelihood_field_prob", "beam"])
def test_without_alternatives_a_searched_pose_stays_ambiguous(model: str) -> None:
    settings = f"localization: {{alternative_interval: 0}}\namcl: {{laser_model_type: {model}}}\n"
    particles = MapFilter(config_from_text(settings))
    particles.take_map(room())
    particles.start_anywhere()
    assert all(one.ambiguous for one in drive(particles, THERE[:9]))
    particles.start_at(PlanarGaussian(*THERE[0], SIGMA))
    assert not drive(particles, THERE[:9])[-1].ambiguous


def test_a_searched_pose_stays_ambiguous_when_alternatives_are_switched_off(script: Any) -> None:
    script(lambda pose: pose)
    unconfirmed = on_the_map()
    unconfirmed.start_anywhere()
    assert drive(unconfirmed, THERE[:4])[-1].ambiguous
    unconfirmed.reconfigure(profile("alternative_interval: 0"))
    assert drive(unconfirmed, THERE[4:6], 4)[-1].ambiguous


@pytest.mark.parametrize("updates", [3, 20, 40])
@pytest.mark.slow
def test_checkpoint_holds_the_confirmation(script: Any, updates: int) -> None:
    script(lambda pose: pose)
    one, other = on_the_map(), on_the_map()
    one.start_anywhere()
    drive(one, THERE[:updates])
    other.restore(decode_state(encode_state(one.state()), FilterState))
    assert other.confirmed == one.confirmed
    assert other.watch == one.watch
    rest = [drive(each, THERE[updates - 1 :], updates - 1) for each in (one, other)]
    assert [a.ambiguous for a in rest[0]] == [b.ambiguous for b in rest[1]]
    assert np.array_equal(one.particles.poses, other.particles.poses)


def test_checkpoint_of_before_is_read(script: Any) -> None:
    script(lambda pose: pose)
    one, other = on_the_map(), on_the_map()
    one.start_at(PlanarGaussian(*THERE[0], SIGMA))
    drive(one, THERE[:5])
    other.restore(decode_state(encode_state(tuple(one.state())[:7]), FilterState))
    assert other.confirmed
    assert np.array_equal(one.particles.poses, other.particles.poses)


def test_vehicle_that_is_carried_off_is_ambiguous_at_once(script: Any) -> None:
    script(lambda pose: pose)
    particles = on_the_map()
    particles.start_at(PlanarGaussian(*THERE[0], SIGMA))
    assert not drive(particles, THERE[:9])[-1].ambiguous
    here = PlanarPose(*THERE[8])
    turned = (THERE[8][0], THERE[8][1], THERE[8][2] + 2.0)
    found = particles.update(here, here, scan_from(turned, 9 * SECOND_NS), 0.0)
    assert found.ambiguous


def test_bad_scan_counts_at_once_and_good_ones_restore_trust() -> None:
    watch = FitWatch().after(0.8).after(0.8)
    assert watch.supports(0.4)
    assert watch.after(0.1, 3).supports(0.4)
    watch = watch.after(0.1, 30)
    assert watch.fits(0.4)
    assert not watch.supports(0.4)
    assert not watch.after(0.8).supports(0.4)
    for _ in range(5):
        watch = watch.after(0.8)
    assert watch.supports(0.4)


def test_first_scans_of_a_spread_cloud_do_not_deny_a_given_pose() -> None:
    watch = FitWatch().after(0.3)
    assert not watch.supports(0.4)
    assert not watch.denies(0.4)
    for _ in range(9):
        assert not watch.denies(0.4)
        watch = watch.after(0.3)
    assert watch.denies(0.4)


def test_pose_that_no_scan_supports_for_long_is_not_certain() -> None:
    watch = FitWatch().after(0.8)
    for _ in range(MAX_UNSUPPORTED):
        watch = watch.after(None)
        assert watch.supports(0.4)
    for blind in (watch.after(None), watch.after(0.9, 2)):
        assert blind.fits(0.4)
        assert not blind.supports(0.4)
        assert blind.after(0.8).supports(0.4)
