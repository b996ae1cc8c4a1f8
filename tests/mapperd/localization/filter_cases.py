"""Grids, fields and filters of the localization tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapperd.localization.particle_filter import (
    BeamModel,
    Beams,
    Endpoints,
    FilterParams,
    Grid,
    HitModel,
    LikelihoodField,
    ParticleFilter,
    RangeMap,
)

Floats = NDArray[np.float64]
HIT = HitModel(z_hit=0.5, z_rand=0.5, sigma_hit_m=0.2, max_range_m=20.0, max_distance_m=2.0)
BEAM = BeamModel(
    z_hit=0.5,
    z_short=0.05,
    z_max=0.05,
    z_rand=0.5,
    sigma_hit_m=0.2,
    lambda_short_per_m=0.1,
    max_range_m=20.0,
)


def cells(rows: list[str]) -> NDArray[np.int8]:
    """Row 0 first: `1` occupied, `0` free, `U` unknown."""
    values = {"0": 0, "1": 100, "U": -1}
    return np.array([[values[mark] for mark in row.split()] for row in rows], np.int8)


def pose(x: float, y: float, yaw: float) -> Floats:
    return np.array([x, y, yaw], np.float64)


def grid(
    occupancy: NDArray[np.int8], resolution_m: float, origin: tuple[float, float, float] = (0, 0, 0)
) -> Grid:
    return Grid(occupancy, resolution_m, pose(*origin))


def one_obstacle(row: int, column: int, resolution_m: float, *origin: float) -> Grid:
    occupancy = np.zeros((5, 5), np.int8)
    occupancy[row, column] = 100
    x, y, yaw = origin or (0.0, 0.0, 0.0)
    return grid(occupancy, resolution_m, (x, y, yaw))


def rule(
    min_particles: int = 100,
    max_particles: int = 2000,
    *,
    resampling: str = "low_variance",
    alpha_slow: float = 0.0,
    alpha_fast: float = 0.0,
    resample_interval: int = 1,
    selective: bool = False,
    max_step_m: float = 1e6,
    kld: tuple[float, float] = (0.05, 3.0),
    bucket_yaw_rad: float = 0.1745,
    bucket_m: float = 0.5,
) -> FilterParams:
    return FilterParams(
        min_particles=min_particles,
        max_particles=max_particles,
        kld_error=kld[0],
        kld_quantile=kld[1],
        bucket_x_m=bucket_m,
        bucket_y_m=bucket_m,
        bucket_yaw_rad=bucket_yaw_rad,
        resampling=resampling,
        alpha_slow=alpha_slow,
        alpha_fast=alpha_fast,
        resample_interval=resample_interval,
        selective=selective,
        max_step_m=max_step_m,
    )


def filter_at(poses: Floats, weights: Floats | None = None, **how: int) -> ParticleFilter:
    made = ParticleFilter(rule(max_particles=max(len(poses), 100)), how.get("seed", 1))
    made.start_with(np.ascontiguousarray(poses, np.float64), weights)
    return made


def endpoints(*points: tuple[float, float]) -> Endpoints:
    ends = np.array(points, np.float64).reshape(-1, 1, 2)
    return Endpoints(ends, np.ones(len(ends)))


def beams(*points: tuple[float, float]) -> Beams:
    ends = np.array(points, np.float64).reshape(-1, 2)
    return Beams(
        bearing_rad=np.arctan2(ends[:, 1], ends[:, 0]),
        range_m=np.hypot(ends[:, 0], ends[:, 1]),
        quality=np.ones(len(ends)),
    )


def field_likelihood(
    field: LikelihoodField, at: Floats, ends: Endpoints, aggregation: str = "cube_sum"
) -> float:
    """Of one particle: with one, the evidence is its likelihood."""
    return float(
        np.exp(filter_at(at.reshape(1, 3)).weigh_field(field, ends, aggregation).log_evidence)
    )


def beam_likelihood(ranges: RangeMap, at: Floats, seen: Beams, model: BeamModel) -> float:
    return float(np.exp(filter_at(at.reshape(1, 3)).weigh_beams(ranges, seen, model).log_evidence))


def log_likelihoods(
    field: LikelihoodField, poses: Floats, ends: Endpoints, aggregation: str
) -> Floats:
    """Of many particles: equal weights before, so that weights and evidence give them."""
    many = filter_at(poses)
    before = many.log_weights
    weighed = many.weigh_field(field, ends, aggregation)
    return many.log_weights - before + weighed.log_evidence
