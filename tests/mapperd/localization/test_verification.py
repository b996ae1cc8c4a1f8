"""A pose is certain only if no distant one explains the last scans about as well."""

import math

import numpy as np
import pytest

from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.hypothesis import FitWatch
from mapperd.localization.map_filter import FilterState, MapFilter
from mapperd.localization.maps import GridMap
from mapperd.localization.models import core_grid
from mapperd.localization.particle_filter import RangeMap
from mapperd.localization.scan import Scan, scan_of_ranges
from mapperd.localization.update_gate import PlanarPose
from mapperd.localization.verification import (
    DECISIVE,
    DOUBTING,
    MAX_SCANS,
    MIN_RETURNS,
    MIN_SCANS,
    RECENT,
    REFUTING,
    Keyframe,
    ScanWindow,
    VerificationResult,
    verify,
)
from mapperd.localization.weighting import MapWeighing
from mapperd.store.checkpoint import decode_state, encode_state
from tests.mapperd.localization.test_hypothesis import SIGMA, off_m, profile

Pose = tuple[float, float, float]

CELL_M = 0.1
BEARING = np.linspace(-1.0, 1.0, 41)
HERE = PlanarPose(0.0, 0.0, 0.0)


def tank(*, post: bool = False) -> GridMap:
    """A round tank with a radius of 3 m around the origin."""
    x, y = np.meshgrid(*[(np.arange(70) + 0.5) * CELL_M - 3.5] * 2)
    cells = np.where(np.hypot(x, y) > 3.0, 100, 0).astype(np.int8)
    if post:
        cells[np.hypot(x - 1.5, y - 1.0) < 0.5] = 100
    return GridMap(cells, CELL_M, -3.5, -3.5)


def hall() -> GridMap:
    """8 m x 6 m with a block in two opposite corners: alike from both ends."""
    cells = np.full((62, 82), 100, dtype=np.int8)
    cells[1:-1, 1:-1] = 0
    cells[1:12, 1:20] = cells[-12:-1, -20:-1] = 100
    return GridMap(cells, CELL_M, -4.1, -3.1)


def seen(grid: GridMap, pose: Pose, stamp_ns: int = 0) -> Scan:
    rays = np.array([[pose[0], pose[1], pose[2] - bearing] for bearing in BEARING])
    ranges = np.asarray(RangeMap(core_grid(grid)).cast(rays, 10.0)).reshape(-1)
    return scan_of_ranges(stamp_ns, BEARING, ranges)


def circle(count: int, radius_m: float = 1.2, first: float = 0.0) -> list[Pose]:
    turn = first + np.arange(count) * 0.12
    return [(radius_m * math.cos(t), radius_m * math.sin(t), t + math.pi / 2) for t in turn]


def drive(particles: MapFilter, grid: GridMap, poses: list[Pose], first: int = 0) -> list[Belief]:
    """Odometry is exact; scans are those of the poses."""
    found, before = [], PlanarPose(*poses[0])
    for k, pose in enumerate(poses):
        now = PlanarPose(*pose)
        found.append(particles.update(before, now, seen(grid, pose, (first + k) * 10**9), 0.0))
        before = now
    return found


def on(grid: GridMap, seed: int = 1) -> MapFilter:
    particles = MapFilter(profile(f"alternative_interval: 2.0\n  random_seed: {seed}"))
    particles.take_map(grid)
    return particles


def test_vehicle_that_is_carried_off_in_a_round_tank_is_not_certain_again() -> None:
    """Every heading fits the wall; the particles glide to a wrong one that fits."""
    grid, poses = tank(), circle(50)
    particles = on(grid)
    particles.start_at(PlanarGaussian(*poses[0], SIGMA))
    assert not drive(particles, grid, poses[:15])[-1].ambiguous
    moved = circle(40, radius_m=0.3, first=15 * 0.12 + 1.5)
    found = drive(particles, grid, moved, 15)
    wrong = [one for one, pose in zip(found, moved, strict=True) if off_m(one, pose) > 0.3]
    assert len(wrong) > 10
    assert all(one.ambiguous for one in wrong[3:])


def test_searched_pose_in_a_round_tank_is_certain_only_with_a_landmark() -> None:
    bare, landmark = tank(), tank(post=True)
    for grid in (bare, landmark):
        particles = on(grid)
        particles.start_anywhere()
        found = drive(particles, grid, circle(40))
        if grid is bare:
            assert all(one.ambiguous for one in found)
        else:
            assert not found[-1].ambiguous
            assert off_m(found[-1], circle(40)[-1]) < 0.3


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
@pytest.mark.slow
def test_searched_pose_in_a_hall_that_is_alike_from_both_ends_is_never_certain(seed: int) -> None:
    grid, poses = hall(), circle(50)
    particles = on(grid, seed)
    particles.start_anywhere()
    particles.start_at(PlanarGaussian(*poses[0], SIGMA), given=False)
    assert all(one.ambiguous for one in drive(particles, grid, poses))


def test_given_pose_stays_certain_where_the_map_is_alike() -> None:
    grid, poses = hall(), circle(30)
    particles = on(grid)
    particles.start_at(PlanarGaussian(*poses[0], SIGMA))
    assert not any(one.ambiguous for one in drive(particles, grid, poses)[3:])


def test_verdicts_need_a_decisive_ratio() -> None:
    sound = VerificationResult(DECISIVE + 0.1, 1.0, 0.0, found=True, scans=MIN_SCANS)
    assert sound.verified
    assert not sound.refuted
    for weak in (
        sound._replace(margin=DECISIVE - 0.1),
        sound._replace(found=False),
        sound._replace(scans=MIN_SCANS - 1),
    ):
        assert not weak.verified
    for sign in (1.0, -1.0):
        worse = -REFUTING - sign * 0.1
        for doubtful in (
            sound._replace(margin=worse),
            sound._replace(recent_margin=worse),
            sound._replace(cloud_margin=worse),
        ):
            assert doubtful.refuted == (sign > 0.0)


def test_pose_is_compared_with_poses_far_from_the_best_one_of_its_place() -> None:
    """An estimate that is 0.9 m off lies as far from the truth as poses beyond it."""
    grid, poses = tank(post=True), circle(MAX_SCANS)
    particles, window = on(grid), ScanWindow()
    x_m, y_m, yaw_rad = poses[-1]
    place = np.array([x_m - 0.9 * math.cos(yaw_rad), y_m - 0.9 * math.sin(yaw_rad), yaw_rad])
    particles.start_at(PlanarGaussian(place[0], place[1], place[2], SIGMA))
    for k, pose in enumerate(poses):
        now = PlanarPose(*pose)
        window = window.after(window.last or now, Keyframe(now, 0.0, seen(grid, pose, k)), 0.1)
    weighing = MapWeighing(grid, profile())
    verdict = verify(weighing, window, place, [particles.particles], (1, 1))
    assert verdict is not None
    assert verdict.verified
    far = np.array([x_m - 1.1 * math.cos(yaw_rad), y_m - 1.1 * math.sin(yaw_rad), yaw_rad])
    verdict = verify(weighing, window, far, [particles.particles], (1, 1))
    assert verdict is not None
    assert not verdict.verified


@pytest.mark.parametrize("dropped", [False, True])
def test_better_distant_pose_counts_more_where_scans_suddenly_fit_worse(
    monkeypatch: pytest.MonkeyPatch, *, dropped: bool
) -> None:
    doubtful = VerificationResult(9.0, 9.0, -DOUBTING - 0.1, found=True, scans=1)
    monkeypatch.setattr("mapperd.localization.map_filter.verify", lambda *_: doubtful)
    monkeypatch.setattr(FitWatch, "dropped", lambda *_: dropped)
    grid, poses = tank(), circle(20)
    particles = on(grid)
    particles.start_at(PlanarGaussian(*poses[0], SIGMA))
    assert drive(particles, grid, poses)[-1].ambiguous == dropped


def keyframe(x_m: float, yaw_rad: float = 0.0, returns: int = MIN_RETURNS) -> Keyframe:
    scan = scan_of_ranges(0, np.linspace(-1.0, 1.0, returns), np.ones(returns))
    return Keyframe(PlanarPose(x_m, 0.0, yaw_rad), -3.0, scan)


def test_scans_of_a_window_are_spaced_and_old_ones_go() -> None:
    window = ScanWindow().after(HERE, keyframe(0.0), 0.5)
    assert window.after(HERE, keyframe(0.4), 0.5).keyframes == window.keyframes
    few = keyframe(0.6, returns=MIN_RETURNS - 1)
    assert window.after(HERE, few, 0.5).keyframes == window.keyframes
    assert len(window.after(HERE, keyframe(0.0, 0.3), 0.5).keyframes) == 2
    before = HERE
    for k in range(1, 40):
        window = window.after(before, keyframe(float(k)), 0.5)
        before = PlanarPose(float(k), 0.0, 0.0)
    assert [one.odom.x_m for one in window.keyframes] == list(range(40 - MAX_SCANS, 40))
    assert [one.odom.x_m for one in window.recent().keyframes] == list(range(40 - RECENT, 40))
    assert window.last == before


def test_window_begins_again_where_odometry_jumps() -> None:
    window = ScanWindow().after(HERE, keyframe(0.0), 0.5).after(HERE, keyframe(1.0), 0.5)
    jumped = PlanarPose(9.0, 0.0, 0.0)
    assert [one.odom.x_m for one in window.after(jumped, keyframe(9.0), 0.5).keyframes] == [9.0]


def test_checkpoint_holds_the_window(monkeypatch: pytest.MonkeyPatch) -> None:
    grid, poses = tank(post=True), circle(30)
    one, other = on(grid), on(grid)
    one.start_anywhere()
    drive(one, grid, poses[:12])
    other.restore(decode_state(encode_state(one.state()), FilterState))
    verdicts: list[VerificationResult | None] = []

    def noted(*args: object) -> VerificationResult | None:
        verdicts.append(verify(*args))  # type: ignore[arg-type]
        return verdicts[-1]

    monkeypatch.setattr("mapperd.localization.map_filter.verify", noted)
    counts = []
    for each in (one, other):
        drive(each, grid, poses[11:], 11)
        counts.append(len(verdicts))
    assert verdicts[: counts[0]] == verdicts[counts[0] :]
    assert counts[0] > 0
    assert one.confirmed == other.confirmed
