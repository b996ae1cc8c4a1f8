"""A cloud that was written and read goes on as if nothing had happened."""

import numpy as np
import pytest

from mapperd.localization.particle_filter import (
    FreeSpace,
    ParticleFilter,
    cloud_state,
    restore_cloud,
)
from tests.mapperd.localization.filter_cases import Floats, cells, grid, rule

FREE = FreeSpace(grid(cells(["0 0 0 0"] * 4), 1.0))
NOISE = np.full(5, 0.1)


def run_on(particles: ParticleFilter, updates: int) -> None:
    """Move, weigh and resample, with particles that recovery throws in."""
    for k in range(updates):
        odometry = np.array([[0.1 * k, 0.0, 0.0], [0.1 * (k + 1), 0.0, 0.05]])
        particles.predict(odometry[0], odometry[1], "omnidirectional_drive", NOISE)
        logs: Floats = -((particles.poses[:, 0] - 2.0) ** 2) - 3.0 * k
        particles.weigh(logs, 10)
        particles.resample_if_due(FREE)


def cloud(seed: int, alpha_fast: float = 0.5) -> ParticleFilter:
    return ParticleFilter(
        rule(50, 400, alpha_slow=0.01, alpha_fast=alpha_fast, resample_interval=3), seed
    )


@pytest.mark.parametrize("updates", range(1, 8))
def test_restored_cloud_goes_on_to_the_bit(updates: int) -> None:
    one, other = cloud(7), cloud(8)
    one.start_anywhere(FREE)
    run_on(one, updates)
    restore_cloud(other, cloud_state(one))
    for each in (one, other):
        run_on(each, 7)
    assert one.counts["injected_particles"] > 0
    assert np.array_equal(one.poses, other.poses)
    assert np.array_equal(one.log_weights, other.log_weights)
    assert one.counts == other.counts


def test_weight_of_nothing_is_kept() -> None:
    one, other = cloud(7), cloud(7)
    one.start_with(np.zeros((3, 3)), np.array([1.0, 0.0, 1.0]))
    restore_cloud(other, cloud_state(one))
    assert other.weights.tolist() == [0.5, 0.0, 0.5]


@pytest.mark.parametrize(
    ("poses", "logs", "averages"),
    [
        ([[0.0, 0.0, np.nan]], [0.0], (0.0, 0.0, False)),
        ([[0.0, 0.0, 0.0]], [1.0], (0.0, 0.0, False)),
        ([[0.0, 0.0, 0.0]], [np.nan], (0.0, 0.0, False)),
        ([[0.0, 0.0, 0.0]], [0.0, 0.0], (0.0, 0.0, False)),
        ([[0.0, 0.0, 0.0]], [0.0], (np.nan, 0.0, True)),
    ],
)
def test_what_is_no_state_changes_nothing(
    poses: list[list[float]], logs: list[float], averages: tuple[float, float, bool]
) -> None:
    particles = cloud(7)
    particles.start_anywhere(FREE)
    before = particles.poses
    with pytest.raises(ValueError, match=r"finite|weight"):
        particles.restore(np.array(poses), np.array(logs), (0,) * 10, averages)
    assert np.array_equal(particles.poses, before)
