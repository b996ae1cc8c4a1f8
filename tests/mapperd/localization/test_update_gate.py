import math

import pytest

from mapperd.config.tree import AmclConfig
from mapperd.localization.update_gate import PlanarPose, UpdateGate

AMCL = AmclConfig(update_min_d=0.1, update_min_a=0.05)


def reasons(*poses: tuple[float, float, float], gate: UpdateGate | None = None) -> list[str]:
    gate, found = gate or UpdateGate(), []
    for k, pose in enumerate(poses):
        gate, decision = gate.decide(PlanarPose(*pose), k * 10**9, AMCL, max_step_m=5.0)
        found.append(decision.reason)
    return found


def test_first_scan_updates_and_standing_still_does_not() -> None:
    assert reasons((0, 0, 0), (0, 0, 0), (0.2, 0.2, 0.05)) == ["first", "still", "motion"]


def test_limits_are_strict_and_euclidean() -> None:
    assert reasons((0, 0, 0), (0.1, 0, 0), (0.08, 0.08, 0)) == ["first", "still", "motion"]
    assert reasons((0, 0, 0), (0, 0, 0.05), (0, 0, 0.0501)) == ["first", "still", "motion"]


def test_angle_is_the_short_way_round() -> None:
    assert reasons((0, 0, math.pi - 0.01), (0, 0, -math.pi + 0.01)) == ["first", "still"]


def test_motion_adds_up_from_where_it_last_called_for_an_update() -> None:
    found = reasons((0, 0, 0), (0.06, 0, 0), (0.12, 0, 0), (0.18, 0, 0), (0.23, 0, 0))
    assert found == ["first", "still", "motion", "still", "motion"]


def test_forced_update_is_one_and_does_not_move_the_reference() -> None:
    gate, _ = UpdateGate().decide(PlanarPose(0, 0, 0), 0, AMCL)
    gate, decision = gate.force().decide(PlanarPose(0.06, 0, 0), 1, AMCL)
    assert (decision.reason, decision.before) == ("forced", PlanarPose(0, 0, 0))
    gate, decision = gate.decide(PlanarPose(0.06, 0, 0), 2, AMCL)
    assert not decision.is_update
    _, decision = gate.decide(PlanarPose(0.11, 0, 0), 3, AMCL)
    assert (decision.reason, decision.before) == ("motion", PlanarPose(0.06, 0, 0))


def test_after_a_new_start_nothing_is_moved_by_what_was_driven_before() -> None:
    gate, _ = UpdateGate().decide(PlanarPose(0, 0, 0), 0, AMCL)
    gate, decision = gate.restarted().decide(PlanarPose(3, 0, 0), 1, AMCL)
    assert (decision.reason, decision.before) == ("first", PlanarPose(3, 0, 0))
    assert not gate.forced


def test_a_hovering_vehicle_has_its_updates_in_time() -> None:
    gate, now = UpdateGate(), PlanarPose(0, 0, 0)
    found = []
    for k in range(7):
        gate, decision = gate.decide(now, k * 10**9, AMCL, max_interval_s=3.0)
        found.append(decision.reason)
    assert found == ["first", "still", "still", "time", "still", "still", "time"]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_odometry_that_is_invalid_leaves_the_gate(bad: float) -> None:
    gate, _ = UpdateGate().decide(PlanarPose(0, 0, 0), 0, AMCL)
    after, decision = gate.force().decide(PlanarPose(bad, 0, 0), 1, AMCL)
    assert decision.reason == "bad_odometry"
    assert after == gate.force()


def test_single_step_too_far_is_passed_over() -> None:
    found = reasons((0, 0, 0), (100, 0, 0), (0.2, 0, 0), (100, 0, 0), (0.2, 0, 0))
    assert found == ["first", "odometry_jump", "motion", "odometry_jump", "still"]
    found = reasons((0, 0, 0), (100, 0, 0), (0, 0, 0), (100, 0, 0), (0, 0, 0))
    assert found == ["first", "odometry_jump", "still", "odometry_jump", "still"]


def test_odometry_that_goes_on_elsewhere_has_jumped_and_moves_nothing() -> None:
    gate, _ = UpdateGate().decide(PlanarPose(0, 0, 0), 0, AMCL, max_step_m=5.0)
    gate, first = gate.decide(PlanarPose(100, 0, 0), 1, AMCL, max_step_m=5.0)
    gate, second = gate.decide(PlanarPose(100.1, 0, 0), 2, AMCL, max_step_m=5.0)
    assert (first.reason, second.reason) == ("odometry_jump", "odometry_jumped")
    assert second.before == PlanarPose(100.1, 0, 0)
    _, third = gate.decide(PlanarPose(100.3, 0, 0), 3, AMCL, max_step_m=5.0)
    assert (third.reason, third.before) == ("motion", PlanarPose(100.1, 0, 0))
