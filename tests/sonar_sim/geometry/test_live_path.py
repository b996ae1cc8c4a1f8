import math
from typing import Any

import numpy as np
import pytest
from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.driving import SURFACE_M, DriveCommand, DrivenBody
from sonar_sim.geometry.live_path import MAX_AHEAD_S, LivePath
from sonar_sim.geometry.pose import (
    FramePose,
    quaternion_of,
    rotation_by,
    rotation_of,
    rotation_of_quaternion,
    rotation_vector,
)
from sonar_sim.scene_file import load_scenario


def at(x: float, yaw_rad: float = 0.0) -> FramePose:
    return FramePose(np.array([x, 0.0, -2.0]), rotation_of(0.0, 0.0, yaw_rad))


def test_a_path_told_at_ten_hertz_is_the_true_one_between() -> None:
    truth = load_scenario("harbour").trajectory
    live = LivePath(truth.pose(0.0))
    for k in range(400):
        time_s = k / 10.0
        live.update(
            time_s, truth.pose(time_s), truth.velocity_mps(time_s), truth.turn_rates_rps(time_s)
        )
    for time_s in np.linspace(36.0, 39.85, 50):
        assert live.pose(time_s).position_m == pytest.approx(
            truth.pose(time_s).position_m, abs=2e-3
        )
        turned = rotation_vector(live.pose(time_s).rotation.T @ truth.pose(time_s).rotation)
        assert np.linalg.norm(turned) < math.radians(0.1)
        assert live.velocity_mps(time_s) == pytest.approx(truth.velocity_mps(time_s), abs=0.03)
        assert live.turn_rates_rps(time_s) == pytest.approx(truth.turn_rates_rps(time_s), abs=0.02)


@pytest.mark.parametrize("velocity_is_told", [True, False])
def test_a_vehicle_goes_on_for_a_while_and_then_stands(*, velocity_is_told: bool) -> None:
    live = LivePath(at(0.0))
    live.update(1.0, at(1.0), np.array([2.0, 0.0, 0.0]) if velocity_is_told else None)
    live.update(1.1, at(1.2), np.array([2.0, 0.0, 0.0]) if velocity_is_told else None)
    assert live.pose(1.4).position_m[0] == pytest.approx(1.8)
    assert live.velocity_mps(1.4)[0] == pytest.approx(2.0)
    assert live.pose(60.0).position_m[0] == pytest.approx(1.2 + 2.0 * MAX_AHEAD_S)
    assert live.velocity_mps(60.0) == pytest.approx([0.0, 0.0, 0.0])


def test_a_turning_vehicle_is_carried_on_round_its_own_axis() -> None:
    live = LivePath(at(0.0))
    live.update(2.0, at(0.0, 0.3), turn_rates_rps=np.array([0.0, 0.0, 0.5]))
    assert live.pose(2.2).rotation[:, 0] == pytest.approx([math.cos(0.4), math.sin(0.4), 0.0])


def test_what_comes_late_is_ignored_and_a_jump_is_no_motion() -> None:
    live = LivePath(at(5.0))
    assert live.pose(3.0).position_m[0] == 5.0
    live.update(1.0, at(1.0))
    live.update(0.9, at(9.0))
    assert (live.updates, live.pose(1.0).position_m[0]) == (1, 1.0)
    live.jump(1.2, at(50.0))
    assert live.pose(1.3).position_m[0] == 50.0
    assert live.velocity_mps(1.3) == pytest.approx([0.0, 0.0, 0.0])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_path_refuses_what_is_not_finite_and_stays(value: float) -> None:
    live = LivePath(at(0.0))
    live.update(1.0, at(1.0))
    wrong = np.array([0.0, value, 0.0])
    turned = FramePose(np.zeros(3), np.full((3, 3), value))
    moves: list[tuple[Any, ...]] = [(value, at(2.0)), (1.1, at(value)), (1.1, turned)]
    with pytest.raises(SonarSimError, match="not finite"):
        LivePath(at(value))
    for move in moves:
        with pytest.raises(SonarSimError, match="not finite"):
            live.jump(*move)
    for move in (*moves, (1.1, at(2.0), wrong), (1.1, at(2.0), np.zeros(3), wrong)):
        with pytest.raises(SonarSimError, match="not finite"):
            live.update(*move)
    assert (live.updates, live.last_s, live.pose(1.1).position_m[0]) == (1, 1.0, 1.0)


def test_rotations_and_their_vectors_and_quaternions_are_inverse() -> None:
    generator = np.random.default_rng(3)
    for length in (0.0, 1e-9, 0.3, 2.0, math.pi - 1e-6):
        axis = generator.standard_normal(3)
        vector = axis * length / np.linalg.norm(axis)
        rotation = rotation_by(vector)
        assert rotation_vector(rotation) == pytest.approx(vector, abs=1e-6)
        quaternion = 7.0 * quaternion_of(rotation)
        assert rotation_of_quaternion(quaternion) == pytest.approx(rotation, abs=1e-9)
    with pytest.raises(ValueError, match="no rotation"):
        rotation_of_quaternion(np.zeros(4))


def test_a_driven_body_follows_its_command_with_a_lag() -> None:
    body = DrivenBody(at(0.0, math.pi / 2))
    body.advance(0.6, DriveCommand(ahead_mps=1.0))
    assert body.velocity_mps[0] == pytest.approx(1.0 - math.exp(-1.0))
    body.advance(10.0, DriveCommand(ahead_mps=1.0))
    # Integral of 1 - exp(-t / 0.6), northwards.
    assert body.pose.position_m == pytest.approx([0.0, 10.6 - 0.6, -2.0], abs=0.02)
    body.advance(20.0, DriveCommand(up_mps=1.0))
    assert body.pose.position_m[2] == SURFACE_M


def test_a_driven_body_goes_round_in_a_circle() -> None:
    body = DrivenBody(at(0.0))
    command = DriveCommand(ahead_mps=0.5, turn_rps=0.25)
    body.advance(10.0, command)
    places = []
    for _ in range(251):
        body.advance(0.1, command)
        places.append(body.pose.position_m[:2])
    middle = (np.max(places, axis=0) + np.min(places, axis=0)) / 2
    assert np.linalg.norm(places - middle, axis=1) == pytest.approx(2.0, abs=0.01)
