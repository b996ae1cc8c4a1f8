"""The reference's own values of resampling, recovery, estimates and rays."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapperd import _core
from mapperd.localization.particle_filter import LikelihoodField, RangeMap
from tests.mapperd.localization.filter_cases import (
    HIT,
    Floats,
    endpoints,
    field_likelihood,
    filter_at,
    grid,
    one_obstacle,
    pose,
)

PI = math.pi
A = one_obstacle(2, 2, 0.5)


def test_kld_sizes() -> None:
    for quantile, wanted in [
        (1.28155156327703, {3: 228, 5: 388, 7: 531}),
        (2.32634787735669, {4: 569, 6: 756, 100: 6733}),
    ]:
        for buckets, size in wanted.items():
            assert _core.mcl_kld_size(buckets, 0.01, quantile) == size
    assert _core.mcl_kld_size(2, 0.01, 3.0) > 10**18


def test_number_of_particles_by_their_buckets() -> None:  # K13, K15
    """K13 has 1200 of one bucket, however sure the cloud is; ours has them while it is not."""
    rule = _core.MclRule(
        min_particles=200,
        max_particles=1200,
        kld_error=0.05,
        kld_quantile=3,
        bucket_x_m=0.5,
        bucket_y_m=0.5,
        bucket_yaw_rad=0.17,
    )
    for poses, count in [([(0, 0, 0)], 200), ([(0, 0, 0), (8, 0, 0), (16, 0, 0)], 200)]:
        some = _core.MclFilter(rule, 1)
        some.start_with(np.array(poses, float))
        some.resample()
        assert len(some.poses) == count
    spread = _core.MclFilter(rule, 1)
    spread.start_with(np.array([(0, 0, 0), (8, 0, 0)], float))
    spread.resample()
    assert len(spread.poses) == 1200


@pytest.mark.parametrize(
    ("weights", "size"), [([1] * 5, 5), ([100] * 5, 5), ([1, 0, 0], 1), ([1, 0.5, 0], 1.8)]
)
def test_effective_size(weights: list[float], size: float) -> None:  # E3, E5, E7, E9
    some = filter_at(np.zeros((len(weights), 3)), np.array(weights, np.float64))
    assert some.effective_size() == pytest.approx(size, abs=1e-12)


def test_effective_size_of_nothing() -> None:  # E1
    assert filter_at(np.zeros((0, 3))).effective_size() == 0


def test_running_average() -> None:  # X1, X3: of 4 less the inputs, beside one that stands still
    average = _core.MclRecovery(0.0, 0.1)
    for value, mean in [(1, 1), (2, 1.1), (3, 1.29), (0, 1.161)]:
        average.add(4.0 - value)
        assert 4.0 - 3.0 * (1.0 - average.injected_share) == pytest.approx(mean, abs=1e-12)
    average.reset()
    average.add(1.0)
    assert average.injected_share == 0
    average.add(0.9)
    assert average.injected_share == pytest.approx(0.01, abs=1e-12)


def test_recovery_probability() -> None:  # R1, R3, R5, R7
    recovery = _core.MclRecovery(0.5, 1.0)
    assert recovery.injected_share == 0
    shares = []
    for fit in (2.0, 1.0, 1.0):
        recovery.add(fit)
        shares.append(recovery.injected_share)
    assert shares == pytest.approx([0, 1 / 3, 0.2])
    recovery.reset()
    assert recovery.injected_share == 0
    for first, then, share in [(1.0, 2.0, 0.0), (0.5, 0.1, 0.079263)]:
        other = _core.MclRecovery(0.001, 0.1)
        other.add(first)
        other.add(then)
        assert other.injected_share == pytest.approx(share, abs=1e-6)


def test_every_third_update_and_drop_of_the_effective_size() -> None:
    third = _core.MclFilter(_rule(resample_interval=3), 1)
    third.start_with(np.zeros((5, 3)))
    due = []
    for _ in range(3):
        third.weigh(np.zeros(5), 1)
        due.append(third.resample_if_due())
    assert due == [False, False, True]
    selective = _core.MclFilter(_rule(selective=True), 1)
    for weights, expected in [([1.0] * 5, False), ([1.0, 0, 0, 0, 0], True)]:
        selective.start_with(np.zeros((5, 3)), np.array(weights))
        selective.weigh(np.zeros(5), 1)
        assert selective.resample_if_due() is expected


def _rule(**how: object) -> _core.MclRule:
    return _core.MclRule(
        min_particles=5,
        max_particles=5,
        kld_error=0.05,
        kld_quantile=3,
        bucket_x_m=0.5,
        bucket_y_m=0.5,
        bucket_yaw_rad=0.17,
        **how,  # type: ignore[arg-type]
    )


W = PI * np.array(
    [
        (0, -2 / PI, 0.1),
        (1 / PI, -1 / PI, 0.2),
        (2 / PI, 1 / PI, 0.3),
        (3 / PI, 2 / PI, 0.2),
        (2 / PI, 1 / PI, 0.2),
        (1 / PI, -1 / PI, 0.2),
        (2 / PI, -2 / PI, 0.3),
        (3 / PI, -1 / PI, 0.4),
        (2 / PI, 1 / PI, 0.5),
        (1 / PI, 2 / PI, 0.4),
    ]
)
S3 = np.array([(0, -3, PI / 6), (1, -2, PI / 2), (2, -1, PI / 3), (3, 0, 0)])


@pytest.mark.parametrize(
    ("poses", "mean", "xy", "yaw"),
    [
        (np.array([(1, 2, 0), (0, 0, 0)], float), (0.5, 1, 0), (0.5, 1, 2), 0),
        (S3, (1.5, -1.5, PI / 4), (1.6667, 1.6667, 1.6667), 0.3570185),
        (W, (1.7, 0, 0.8762), (0.9, 0.5556, 2.4444), 0.1355231),
    ],
    ids=["S1", "S3", "S5"],
)
def test_estimates(
    poses: Floats, mean: tuple[float, ...], xy: tuple[float, ...], yaw: float
) -> None:
    estimate = _core.mcl_estimate(poses, np.ones(len(poses)))
    covariance = estimate.covariance
    assert estimate.mean == pytest.approx(mean, abs=1e-4)
    got = (covariance[0, 0], covariance[0, 1], covariance[1, 1])
    assert got == pytest.approx(xy, abs=1e-4)
    assert covariance[2, 2] == pytest.approx(yaw, abs=1e-6)


def test_weighted_covariance() -> None:  # S9, S11
    values = [0, 1, 1, 2, 2, 3, 4, 4, 5, 5, 6, 7, 7, 8, 9]
    weights = [0.1, 0.15, 0.15, 0.3, 0.3, 0.4, 0.8, 0.8, 0.4, 0.4, 0.35, 0.3, 0.3, 0.15, 0.1]
    scalars = np.array([(v, 0, 0) for v in values], float)
    estimate = _core.mcl_estimate(scalars, np.array(weights))
    got = (estimate.mean[0], estimate.covariance[0, 0] ** 0.5)
    assert got == pytest.approx((4.3, 2.055), abs=1e-3)
    points = [(0, 0), (2, 2), (0, 0), (2, 2), (0, 0), (2, 0), (0, 2), (2, 2), (0, 2), (2, 0)]
    poses = np.array([(x, y, 0) for x, y in points], float)
    estimate = _core.mcl_estimate(poses, np.array([0, 1, 2, 1, 0, 1, 2, 1, 0, 1], float))
    assert estimate.mean[:2] == pytest.approx((10 / 9, 10 / 9))
    got3 = (estimate.covariance[0, 0], estimate.covariance[0, 1])
    assert got3 == pytest.approx((1.1765, 0.1176), abs=1e-4)


@pytest.mark.parametrize(
    ("ray", "most", "expected"),
    [
        ((0.5, 0, 0), 5.0, -1),
        ((0, 1, 0), 5.0, 1.0),
        ((0, 1, PI / 2), 5.0, -1),
        ((0, 0, PI / 2), 1.0, 1.0),
        ((0, 0, PI / 4), 5.0, 2**0.5),
    ],
    ids=["G1", "G2", "G3", "G5", "G7"],
)
def test_rays(ray: tuple[float, float, float], most: float, expected: float) -> None:
    found = RangeMap(A).cast(np.array([ray], float), most)
    assert found[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, PI / 2, PI, -PI, -PI / 2])
@pytest.mark.parametrize("aside", [0.0, 1e-9, 0.25])
def test_ray_along_an_edge_is_in_the_cell_above_or_to_the_right(yaw: float, aside: float) -> None:
    """The occupied cell of A is 1 to 1.5 m in x and y; all these rays begin 1 m before it."""
    along = np.round([np.cos(yaw), np.sin(yaw)])
    start = np.where(along > 0, 0.0, np.where(along < 0, 2.5, 1.0 + aside))
    found = RangeMap(A).cast(np.array([(*start, yaw)]), 5.0)
    assert found[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("marked", "limit", "squared"),
    [
        ([0, 0, 0], 9, [9**9] * 3),
        ([1] * 6, 9, [0] * 6),
        ([1, 1, 0, 0, 0, 0], 10, [0, 0, 1, 4, 9, 16]),
        ([0, 0, 0, 0, 0, 1], 3, [9**9, 9**9, 9, 4, 1, 0]),
    ],
    ids=["M1", "M3", "M5", "M7"],
)
def test_distance_map(marked: list[int], limit: int, squared: list[int]) -> None:
    found = _core.mcl_squared_distances(np.array([marked], bool), limit)
    assert np.minimum(found[0], 9**9).tolist() == squared
    assert _core.mcl_squared_distances(np.zeros((1, 0), bool), limit).size == 0  # M1 itself


def test_centre_of_a_cell_of_a_turned_grid() -> None:
    occupancy = np.zeros((5, 5), np.int8)
    occupancy[2, 2] = 100
    turned = LikelihoodField.of_grid(grid(occupancy, 1.0, (1, 1, PI / 2)), HIT)
    at_centre = field_likelihood(turned, pose(-1.5, 3.5, 0), endpoints((0, 0)))
    assert at_centre == pytest.approx(2.068577608, abs=1e-6)


def test_gaussian_draws() -> None:
    root = _core.mcl_square_root(np.ones((3, 3)))  # the reference refuses rank 1
    assert root @ root.T == pytest.approx(np.ones((3, 3)), abs=1e-12)
    for wrong in (np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]), -np.eye(3)):
        with pytest.raises(ValueError, match="covariance"):
            _core.mcl_square_root(wrong)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = [[1.5, -0.3], [-0.3, 1.5]]
    many = _core.MclFilter(
        _core.MclRule(
            min_particles=1,
            max_particles=1_000_000,
            kld_error=0.05,
            kld_quantile=3,
            bucket_x_m=1,
            bucket_y_m=1,
            bucket_yaw_rad=1,
        ),
        7,
    )
    many.start_about(pose(3, 4, 0), covariance)
    drawn = many.poses
    assert drawn[:, :2].mean(axis=0) == pytest.approx((3, 4), abs=0.01)
    assert np.cov(drawn[:, :2].T) == pytest.approx(covariance[:2, :2], abs=0.01)
    assert not drawn[:, 2].any()
