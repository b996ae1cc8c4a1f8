"""Values that the reference's own tests hold, and our choices where its two parents differ."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from mapperd.localization.particle_filter import BeamModel, HitModel, LikelihoodField, RangeMap
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


def test_log_product_adds_up_over_scans() -> None:
    one = [(1.2, 1.2), (1.25, 1.25), (1.3, 1.3)]
    apart = filter_at(np.zeros((1, 3)))
    evidence = [apart.weigh_field(FIELD_A, endpoints(p), "product").log_evidence for p in one]
    together = filter_at(np.zeros((1, 3))).weigh_field(FIELD_A, endpoints(*one), "product")
    assert sum(evidence) == pytest.approx(together.log_evidence, abs=1e-12)
    assert all(a == b for a, b in pairwise(apart.weights))
