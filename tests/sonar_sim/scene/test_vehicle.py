import itertools
import math

import numpy as np
import pytest
from sonar_sim.errors import SceneError
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.scene.vehicle import (
    OdometryErrors,
    OdometrySample,
    SimulatedOdometry,
    Vehicle,
    in_order_of_arrival,
)

CALM = Motion(speed_mps=1.0, sway_deg=0.0, heave_m=0.0)
PATH = Trajectory([Waypoint(0, 0, -5, 0), Waypoint(60, 0, -5, 0)], CALM)
TRUE = {"position_noise_m": 0.0, "attitude_noise_deg": 0.0}


def records(seed: int = 0, rate_hz: float = 10.0, **errors: object) -> list[OdometrySample]:
    vehicle = Vehicle("v", rate_hz, OdometryErrors(**{**TRUE, **errors}))  # type: ignore[arg-type]
    return list(SimulatedOdometry(PATH, vehicle, seed).samples())


def off_m(samples: list[OdometrySample]) -> np.ndarray:
    return np.array([s.pose.position_m - PATH.pose(s.time_s).position_m for s in samples])


def test_without_errors_the_records_are_the_path() -> None:
    samples = records(latency_s=0.0)
    assert len(samples) == 601
    assert np.abs(off_m(samples)).max() < 1e-12
    assert all(s.arrival_s == s.time_s for s in samples)
    assert samples[300].velocity_mps == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


def test_white_noise_has_its_deviation() -> None:
    off = off_m(records(position_noise_m=0.05))
    assert off.std() == pytest.approx(0.05, rel=0.08)
    assert abs(np.corrcoef(off[:-1, 0], off[1:, 0])[0, 1]) < 0.1


def test_bias_drift_and_scale_add_up() -> None:
    samples = records(position_bias_m=(0.1, 0.0, 0.0), drift_mps=(0.0, 0.01, 0.0), scale=0.02)
    assert off_m(samples)[0] == pytest.approx([0.1, 0.0, 0.0], abs=1e-9)
    travelled = PATH.pose(60.0).position_m[0] - PATH.pose(0.0).position_m[0]
    assert off_m(samples)[-1] == pytest.approx([0.1 + 0.02 * travelled, 0.6, 0.0], abs=1e-9)
    assert samples[300].velocity_mps[0] == pytest.approx(1.02, abs=1e-6)


@pytest.mark.slow
def test_random_walk_grows_with_the_root_of_time() -> None:
    walks = [off_m(records(seed, 1.0, walk_m_per_sqrt_s=0.1)) for seed in range(120)]
    spread = np.std([walk[[9, 49]] for walk in walks], axis=(0, 2))
    assert spread == pytest.approx([0.3, 0.7], rel=0.15)


def test_heading_drifts_by_the_minute_and_is_biased() -> None:
    samples = records(yaw_drift_deg_per_min=6.0, attitude_bias_deg=(0.0, 0.0, 1.0))
    rotation = samples[-1].pose.rotation
    assert math.degrees(math.atan2(rotation[1, 0], rotation[0, 0])) == pytest.approx(7.0, abs=1e-6)


def test_records_come_late_are_lost_and_stay_out() -> None:
    samples = records(
        rate_hz=50.0, latency_s=0.1, jitter_s=0.05, dropout=0.2, outages_s=((10.0, 20.0),)
    )
    assert not [s for s in samples if 10.0 <= s.time_s < 20.0]
    assert len(samples) / (50.0 * 50.0) == pytest.approx(0.8, abs=0.03)
    late = np.array([s.arrival_s - s.time_s for s in samples])
    assert late.min() >= 0.1
    assert late.mean() == pytest.approx(0.15, abs=0.01)
    arrivals = [s.arrival_s for s in in_order_of_arrival(iter(samples))]
    assert all(a <= b for a, b in itertools.pairwise(arrivals))
    overtaken = [a.arrival_s > b.arrival_s for a, b in itertools.pairwise(samples)]
    assert any(overtaken)


def test_equal_seeds_give_equal_records() -> None:
    errors = {"position_noise_m": 0.1, "walk_m_per_sqrt_s": 0.1, "dropout": 0.1}
    one, again, other = (off_m(records(seed, **errors)) for seed in (3, 3, 4))
    assert np.array_equal(one, again)
    assert one.shape != other.shape or not np.array_equal(one, other)


@pytest.mark.parametrize("wrong", [{"dropout": 1.0}, {"latency_s": -0.1}, {"jitter_s": -1.0}])
def test_impossible_errors_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(SceneError):
        OdometryErrors(**wrong)  # type: ignore[arg-type]


def test_an_outage_that_ends_before_it_began_is_refused() -> None:
    with pytest.raises(SceneError, match="from 5 s to 2 s"):
        OdometryErrors(outages_s=((5.0, 2.0),))
