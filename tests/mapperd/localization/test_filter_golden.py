"""Values that the reference's own tests hold, and our choices where its two parents differ."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from mapperd import _core
from mapperd.localization.filter import BeamModel, HitModel, LikelihoodField, RangeMap
from mapperd.localization.gates import MotionGate, evenly_spaced
from tests.mapperd.localization.filter_cases import (
    HIT,
    Floats,
    beam_likelihood,
    beams,
    cells,
    endpoints,
    field_likelihood,
    filter_at,
    grid,
    one_obstacle,
    pose,
)

QUARTER = math.pi / 2
A = one_obstacle(2, 2, 0.5)
BEAM = BeamModel(
    z_hit=0.5,
    z_short=0.05,
    z_max=0.05,
    z_rand=0.5,
    sigma_hit_m=0.2,
    lambda_short_per_m=0.1,
    max_range_m=60.0,
)


@pytest.mark.parametrize(
    ("ranges", "point", "expected", "tolerance"),
    [
        (RangeMap(A), (1.0, 1.0), 1.0171643824743635, 1e-6),
        (RangeMap(A), (2.25, 2.25), 5.787037e-7, 1e-12),
        # B5 has z* = r_max where a ray leaves the map; here nothing is expected off the map.
        (RangeMap(grid(np.zeros((400, 400), np.int8), 0.5)), (1.0, 1.0), 2.041006e-6, 1e-11),
    ],
    ids=["B1", "B3", "B5"],
)
def test_beam_model(
    ranges: RangeMap, point: tuple[float, float], expected: float, tolerance: float
) -> None:
    got = beam_likelihood(ranges, pose(0, 0, 0), beams(point), BEAM)
    assert got == pytest.approx(expected, abs=tolerance)


def c(*origin: float) -> LikelihoodField:
    return LikelihoodField.of_grid(one_obstacle(4, 4, 2.0, *origin), HIT)


FIELD_A = LikelihoodField.of_grid(A, HIT)


@pytest.mark.parametrize(
    ("field", "at", "points", "expected"),
    [
        (FIELD_A, pose(0, 0, 0), [(1.25, 1.25)], 2.068577608),
        (FIELD_A, pose(0, 0, 0), [(-50, 50)], 1.0 + 0.025**3),  # L3: background, not 1 / r_max
        (FIELD_A, pose(1.25, 1.25, 0), [(0, 0)], 2.068577608),
        (c(-5, -5, 0), pose(-5, -5, 0), [(9.5, 9.5)], 2.068577608),
        (c(0, 0, QUARTER), pose(0, 0, QUARTER), [(9.5, 9.5)], 2.068577608),
        (c(5, -5, QUARTER), pose(5, -5, QUARTER), [(9.5, 9.5)], 2.068577608),
        (
            LikelihoodField.of_grid(one_obstacle(4, 4, 0.5), HIT),
            pose(0, 0, 0),
            [(1, 1)],
            1.000015625,
        ),
    ],
    ids=["L1", "L3", "L5", "L7", "L9", "L11", "L13"],
)
def test_likelihood_field(
    field: LikelihoodField, at: Floats, points: list[tuple[float, float]], expected: float
) -> None:
    got = field_likelihood(field, at, endpoints(*points))
    assert got == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize(
    ("field", "points", "expected"),
    [
        (FIELD_A, [(2.25, 2.25)], 0.025),
        (FIELD_A, [(1.2, 1.2), (1.25, 1.25), (1.3, 1.3)], 1.068577608),
        (c(-5, -5, 0), [(4.5, 4.5)], 1.022355701),
        (c(0, 0, QUARTER), [(-9.5, 9.5)], 1.022355701),
        (c(5, -5, QUARTER), [(-4.5, 4.5)], 1.022355701),
        (FIELD_A, [(1, 1)], 1.0223556756973267),
    ],
    ids=["L2", "L4", "L6", "L8", "L10", "L12"],
)
def test_likelihood_field_prob(
    field: LikelihoodField, points: list[tuple[float, float]], expected: float
) -> None:
    got = field_likelihood(field, pose(0, 0, 0), endpoints(*points), "product")
    assert got == pytest.approx(expected, abs=2e-7)


def test_density_of_distances() -> None:
    for distance_m, expected in [
        (0, 1.022355701),
        (0.5, 0.068820751),
        (0.5**0.5, 0.026925349),
        (2, 0.025),
        (9, 0.025),
    ]:
        assert HIT.density(distance_m) == pytest.approx(expected, abs=1e-9)


def test_field_of_a_diagonal() -> None:  # F1
    field = LikelihoodField.of_grid(grid(np.eye(5, dtype=np.int8)[::-1].copy() * 100, 0.5), HIT)
    rows = [
        [0.025, 0.025, 0.025, 0.069, 1.022],
        [0.025, 0.027, 0.069, 1.022, 0.069],
        [0.025, 0.069, 1.022, 0.069, 0.025],
        [0.069, 1.022, 0.069, 0.027, 0.025],
        [1.022, 0.069, 0.025, 0.025, 0.025],
    ]
    expected = np.array(rows)
    # The reference lets a cell two across and one up be far; exactly it lies sqrt(0.5) m away.
    assert np.abs(field.values() - expected).max() < 0.003


def test_field_of_a_hollow_box_with_boundaries_only() -> None:  # F3
    occupancy = np.zeros((7, 7), np.int8)
    occupancy[1:6, 1:6] = 100
    occupancy[3, 3] = 0
    model = HitModel(z_hit=0.5, z_rand=0.5, sigma_hit_m=0.2, max_range_m=2.0, max_distance_m=10.0)
    field = LikelihoodField.of_grid(grid(occupancy, 1.0), model, only_boundaries=True).values()
    assert field[3, 3] == pytest.approx(0.250003717, abs=1e-6)
    assert field[2, 2] == pytest.approx(0.250003717, abs=1e-6)


def test_field_with_unknown_space_modelled() -> None:  # F5
    rows = ["U U U 1 1", "U 0 0 0 1", "U 0 0 0 1", "1 0 0 0 1", "1 1 1 1 1"]
    field = LikelihoodField.of_grid(
        grid(cells(rows), 0.5), HIT, only_boundaries=True, unknown="uniform"
    )
    u = 1 / 20
    expected = [
        [u, u, u, 1.022, u],
        [u, 0.025, 0.027, 0.069, 1.022],
        [u, 0.027, 0.025, 0.069, 1.022],
        [1.022, 0.069, 0.069, 0.069, 1.022],
        [u, 1.022, 1.022, 1.022, u],
    ]
    assert np.abs(field.values() - np.array(expected)).max() < 0.003


@pytest.mark.parametrize(
    ("points", "expected", "tolerance"),
    [
        ([(0.0, 0.0)], 1.000125, 1e-6),
        ([(2.25, 2.25)], 1.000125, 1e-6),
        ([(1.2, 1.2), (1.25, 1.25), (1.3, 1.3)], 4.205, 0.01),
    ],
    ids=["U1", "U3", "U5"],
)
def test_weights_in_unknown_space(
    points: list[tuple[float, float]], expected: float, tolerance: float
) -> None:
    rows = ["U U U 0 0", "U 0 0 0 0", "U 0 1 0 U", "0 0 0 0 U", "0 0 U U U"]
    field = LikelihoodField.of_grid(grid(cells(rows), 0.5), HIT, unknown="uniform")
    got = field_likelihood(field, pose(0, 0, 0), endpoints(*points))
    assert got == pytest.approx(expected, abs=tolerance)


PI = math.pi


@pytest.mark.parametrize(
    ("model", "before", "now", "particle", "result"),
    [
        ("differential_drive", (1, -2, PI), (1, -2, PI), (2, 5, PI / 3), (2, 5, PI / 3)),
        ("differential_drive", (0, 0, 0), (1, 0, 0), (0, 3, 0), (1, 3, 0)),
        ("differential_drive", (0, 0, 0), (0, 1, PI / 2), (2, 3, -PI / 2), (3, 3, 0)),
        ("differential_drive", (0, 0, 0), (0, 0, PI / 4), (0, 0, -PI / 2), (0, 0, -PI / 4)),
        ("omnidirectional_drive", (0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)),
        ("omnidirectional_drive", (0, 0, 0), (0, 1, PI / 2), (0, 0, 0), (0, 1, PI / 2)),
        ("omnidirectional_drive", (0, 0, 0), (0, 0, PI / 4), (0, 0, PI), (0, 0, -3 * PI / 4)),
        ("omnidirectional_drive", (0, 0, 0), (0, 1, 0), (0, 0, 0), (0, 1, 0)),
    ],
    ids=["D1", "D3", "D5", "D7", "O2", "O4", "O6", "O8"],
)
def test_motion_without_noise(
    model: str,
    before: tuple[float, float, float],
    now: tuple[float, float, float],
    particle: tuple[float, float, float],
    result: tuple[float, float, float],
) -> None:
    one = filter_at(np.array([particle]))
    assert one.predict(pose(*before), pose(*now), model, np.zeros(5))
    assert one.poses[0] == pytest.approx(result, abs=1e-12)


def spread(model: str, alpha: int, now: Floats, particle: Floats) -> Floats:
    alphas = np.zeros(5)
    alphas[alpha - 1] = 0.2
    many = filter_at(np.tile(particle, (100_000, 1)))
    many.predict(pose(0, 0, 0), now, model, alphas)
    return many.poses


def test_spread_of_motion() -> None:  # D9, D11, D13, O10
    x = spread("differential_drive", 3, pose(3, 0, 0), pose(5, 0, 0))[:, 0]
    assert (x.mean(), x.std()) == pytest.approx((8, 1.341641), abs=0.015)
    for model in ("differential_drive", "omnidirectional_drive"):
        yaw = spread(model, 1, pose(0, 0, PI / 4), pose(0, 0, PI / 6))[:, 2]
        assert (yaw.mean(), yaw.std()) == pytest.approx((5 * PI / 12, 0.351241), abs=0.01)
    moved = spread("differential_drive", 4, pose(1, 1, 0), pose(0, 0, 0))
    along = moved[:, :2] @ np.array([0.5**0.5, 0.5**0.5])
    assert (along.mean(), along.std()) == pytest.approx((2**0.5, 0.496729), abs=0.01)


def test_kld_sizes() -> None:
    for quantile, wanted in [
        (1.28155156327703, {3: 228, 5: 388, 7: 531}),
        (2.32634787735669, {4: 569, 6: 756, 100: 6733}),
    ]:
        for buckets, size in wanted.items():
            assert _core.mcl_kld_size(buckets, 0.01, quantile) == size
    assert _core.mcl_kld_size(2, 0.01, 3.0) > 10**18


@pytest.mark.parametrize(
    ("count", "wanted", "indices"),
    [
        (4, 0, []),
        (4, 10, [0, 1, 2, 3]),
        (5, 3, [0, 2, 4]),
        (9, 3, [0, 4, 8]),
        (10, 6, [0, 2, 4, 6, 8, 9]),
        (7, 1, [0]),
        (0, 5, []),
    ],
    ids=["T1", "T3", "T5", "T7", "T9", "one", "none"],
)
def test_decimation(count: int, wanted: int, indices: list[int]) -> None:
    assert evenly_spaced(count, wanted).tolist() == indices


@pytest.mark.parametrize(
    ("weights", "size"), [([1] * 5, 5), ([100] * 5, 5), ([1, 0, 0], 1), ([1, 0.5, 0], 1.8)]
)
def test_effective_size(weights: list[float], size: float) -> None:  # E3 ... E9
    some = filter_at(np.zeros((len(weights), 3)), np.array(weights, np.float64))
    assert some.effective_size() == pytest.approx(size, abs=1e-12)


def test_effective_size_of_nothing() -> None:  # E1
    assert filter_at(np.zeros((0, 3))).effective_size() == 0


def test_recovery_probability() -> None:  # R3, R5, R7
    recovery = _core.MclRecovery(0.5, 1.0)
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


def test_motion_gate() -> None:
    gate = MotionGate(0.1, 0.05)
    assert gate.passes(pose(0, 0, 0))
    assert not gate.passes(pose(0, 0, 0))
    assert gate.passes(pose(0.2, 0.2, 0.05))
    assert not gate.passes(pose(0.2, 0.2, 0.05 - 2 * PI))
    gate.reset()
    assert gate.passes(pose(0.2, 0.2, 0.05))


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
        ((0, 1, PI / 2), 5.0, -1),
        ((0, 0, PI / 2), 1.0, 1.0),
        ((0, 0, PI / 4), 5.0, 2**0.5),
    ],
    ids=["G1", "G3", "G5", "G7"],
)
def test_rays(ray: tuple[float, float, float], most: float, expected: float) -> None:
    found = RangeMap(A).cast(np.array([ray], float), most)
    assert found[0] == pytest.approx(expected, abs=1e-9)


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


def test_log_product_adds_up_over_scans() -> None:
    one = [(1.2, 1.2), (1.25, 1.25), (1.3, 1.3)]
    apart = filter_at(np.zeros((1, 3)))
    evidence = [apart.weigh_field(FIELD_A, endpoints(p), "product").log_evidence for p in one]
    together = filter_at(np.zeros((1, 3))).weigh_field(FIELD_A, endpoints(*one), "product")
    assert sum(evidence) == pytest.approx(together.log_evidence, abs=1e-12)
    assert all(a == b for a, b in pairwise(apart.weights))
