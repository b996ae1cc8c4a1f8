"""What fusion is made of: the way summed up, turns between attitudes, clocks of links."""

import numpy as np
import pytest

from mapperd.geometry.frames import rotation_from_rpy
from mapperd.odometry.clock import OdometryClock
from mapperd.odometry.reckoning import DeadReckoning
from mapperd.odometry.records import Odometry
from mapperd.odometry.states import POSITION, BasePosition, turn_between
from tests.mapperd.odometry.conftest import T0, S, record


def test_a_last_velocity_is_carried_on_for_a_gap_and_no_longer() -> None:
    reckoning = DeadReckoning(S, 0.1)
    for k in range(3):
        reckoning.add(k * S // 2, np.array([1.0, 0.0, 0.0]), in_map=True)
    reckoning.advance(lambda _: None, None)
    carried = reckoning.at(2 * S)
    assert carried is not None
    assert carried.value.displacement_m == pytest.approx([2.0, 0.0, 0.0])
    assert reckoning.at(2 * S + 1) is None


def test_variance_between_two_velocities_leads_from_one_to_the_other() -> None:
    reckoning = DeadReckoning(S, 0.02)
    for k in range(3):
        reckoning.add(k * S // 2, np.zeros(3), in_map=True, noise=0.2)
    reckoning.advance(lambda _: None, None)
    found = [reckoning.at(t * S // 4) for t in range(5)]
    variances_m2 = [sample.value.variance_m2 for sample in found if sample is not None]
    assert variances_m2 == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04])


def test_a_quaternion_and_its_negative_are_one_turn() -> None:
    start, end = np.array([1.0, 0, 0, 0]), rotation_from_rpy(0, 0, 40.0)
    for sign in (1.0, -1.0):
        assert turn_between(start, sign * end) == pytest.approx([0, 0, np.radians(40.0)])


def test_a_known_delay_of_a_link_is_taken_off() -> None:
    clock = OdometryClock(S, S // 5)
    assert clock.t_host_ns(record(), T0) == T0 - S // 5


@pytest.mark.parametrize(("ahead_ns", "is_off"), [(0, False), (S // 50, True), (-3600 * S, True)])
def test_a_stalled_computer_is_no_clock_that_is_off(*, ahead_ns: int, is_off: bool) -> None:
    """Records that waited are fitted from then on; only a clock that is off is reported."""
    clock = OdometryClock(S)
    for k in range(60):
        t_ns = T0 + k * S // 10
        delay_ns = S // 10 if 20 <= k < 40 else S // 250
        clock.t_host_ns(Odometry(stamp_ns=t_ns + ahead_ns, clock="unix"), t_ns + delay_ns)
    assert clock.state().distrusted
    assert (clock.offset_ns is not None) is is_off


def test_between_a_good_place_and_a_bad_one_places_are_bad() -> None:
    good, bad = (
        BasePosition(np.zeros(3), None, s * np.eye(3), has_height=True) for s in (1.0, 9.0)
    )
    for pair in ((good, bad), (bad, good)):
        assert POSITION.interpolate(*pair, 0.5).covariance_m2[0, 0] == 9.0
