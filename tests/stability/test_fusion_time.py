"""Hard cases of the fusion of odometry: gaps, stamps, order, what is carried on."""

from __future__ import annotations

import math
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from mapperd.config.odometry import OdometryFusionConfig, OwnersConfig, TimeSyncConfig
from mapperd.errors import Reject
from mapperd.odometry.fusion import FusedPose, Fusion
from mapperd.odometry.reckoning import DeadReckoning
from mapperd.odometry.records import Odometry
from mapperd.odometry.series import InterpolationLimits, Interpolator, Sample, Series, value_at
from mapperd.odometry.track import JumpDetector
from mapperd.odometry.water_linked import DeadReckoningReport
from tests.mapperd.odometry.conftest import T0, S, record

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
LIMITS = InterpolationLimits("interpolate", 500_000_000, 100_000_000)
LINE = Interpolator[float](lambda a, b, f: a + f * (b - a), lambda _value, _seconds: None)


def ahead(x_m: float) -> dict[str, Any]:
    return {"position_m": np.array([x_m, 0.0, 0.0]), "map_q_base": LEVEL}


def x_at(fusion: Fusion, t_ns: int) -> float | str:
    fused = fusion.at(t_ns)
    return fused.reason if isinstance(fused, Reject) else float(fused.pose.position_m[0])


def dives_at(speed_mps: float, stamps: list[int]) -> Fusion:
    fusion = Fusion()
    for t_ns in stamps:
        fusion.take("ekf", record(**ahead(speed_mps * (t_ns - T0) / S)), t_ns)
    return fusion


def test_nanoseconds_since_1970() -> None:
    """A moment between two records a microsecond apart is found to the nanosecond, in 2026 too.

    Naively times are float seconds: 1.7e9 of them have steps of 238 ns, single precision of 128 s.
    """
    series: Series[float] = Series()
    for k in range(3):
        series.add(T0 + 1000 * k, 1000.0 * k, 0)
    for off_ns in (1, 333, 999, 1001, 1999):
        found = value_at(series, T0 + off_ns, LIMITS, LINE)
        assert isinstance(found, Sample)
        assert found.value == pytest.approx(off_ns, abs=1e-9)


def test_float_seconds_of_a_sender() -> None:
    """A stamp that a sender writes as float seconds keeps what a double of it holds: 0.3 us.

    Naively it is added to others as float seconds again and again, and jitters by a microsecond.
    """
    for text in ("1700000000.123456", "1789999999.999999", "1234567890.000001"):
        record = DeadReckoningReport(float(text), (0, 0, 0), 0.1, (0, 0, 0), 0).odometry()
        assert isinstance(record, Odometry)
        with mp.workdps(40):
            assert abs(record.stamp_ns - mp.mpf(text) * S) < 300


def test_two_records_of_one_stamp() -> None:
    """The second is refused: there is no motion in no time.

    Naively the velocity between them is their noise divided by 0, and interpolation 0 / 0.
    """
    fusion = dives_at(1.0, [T0, T0 + S // 10])
    again = fusion.take("ekf", record(**ahead(0.15)), T0 + S // 10)
    assert again is not None
    assert again.reason == "back_in_time"
    assert x_at(fusion, T0 + S // 10) == pytest.approx(0.1, abs=1e-15)
    fused = fusion.at(T0 + S // 20)
    assert isinstance(fused, FusedPose)
    assert fused.velocity_mps == pytest.approx([1.0, 0, 0])


@pytest.mark.parametrize(("later_ns", "agrees"), [(0, True), (1, True), (-S, False)])
def test_jump_confirmed_at_no_time_later(later_ns: int, agrees: bool) -> None:  # noqa: FBT001
    """A second stray at the stamp of the first confirms a jump, and an older one does not.

    Naively the speed between them is their noise divided by 0 s, or by less: nothing ever agrees.
    """
    watch = JumpDetector[float](lambda a, b, seconds: abs(b - a) - 5.0 * seconds)
    assert watch.check(T0, 0.0) is False
    assert watch.check(T0 + 2 * S, 1000.0) is None
    assert watch.check(T0 + 2 * S + later_ns, 1000.5) is (True if agrees else None)
    assert watch.check(T0 + 3 * S, 1001.0) is (not agrees)


def test_records_out_of_order() -> None:
    """Records that others overtook are left out, and the poses are those of the others.

    Naively they are appended: bisection over times that do not rise finds any place, and the
    vehicle goes back and forth.
    """
    stamps = [T0 + k * S // 20 for k in range(60)]
    order = np.arange(60) + np.random.default_rng(2).uniform(0, 4, 60)
    shuffled = [stamps[k] for k in np.argsort(order)]
    fusion = dives_at(2.0, shuffled)
    rising = [t for k, t in enumerate(shuffled) if t == max(shuffled[: k + 1])]
    assert len(rising) < 50
    same = dives_at(2.0, rising)
    for t_ns in range(T0, stamps[-1], 7_777_777):
        assert x_at(fusion, t_ns) == x_at(same, t_ns)
        assert x_at(fusion, t_ns) == pytest.approx(2.0 * (t_ns - T0) / S, abs=1e-12)


def test_motion_is_carried_on_to_its_limit_and_not_a_nanosecond_further() -> None:
    """100 ms after the last record there is a pose, and no pose a nanosecond later.

    Naively the age of a record is a difference of float seconds of 1970, 238 ns sharp, and whether
    a ping at the limit is mapped changes from run to run.
    """
    fusion = dives_at(1.0, [T0 + k * S // 10 for k in range(6)])
    assert x_at(fusion, T0 + 600_000_000) == pytest.approx(0.6, abs=1e-12)
    assert x_at(fusion, T0 + 600_000_001) == "after_odometry"
    assert x_at(fusion, T0 - 100_000_000) == pytest.approx(-0.1, abs=1e-12)
    assert x_at(fusion, T0 - 100_000_001) == "before_odometry"


def test_gap_between_records_to_its_limit_and_not_a_nanosecond_further() -> None:
    """Over half a second is interpolated, over a nanosecond more is not.

    Naively a straight line is drawn over any silence, and a minute's turn is a short cut.
    """
    for more_ns, expected in ((0, 0.25), (1, "odometry_gap")):
        fusion = dives_at(1.0, [T0, T0 + 500_000_000 + more_ns])
        found = x_at(fusion, T0 + 250_000_000)
        assert found == (expected if more_ns else pytest.approx(expected, abs=1e-9))


def test_silence_of_ten_hours() -> None:
    """After it nothing is believed of before: no pose in it, and the map goes on where it is heard.

    Naively a velocity of 1 m/s is carried on for 36 km, or the way is one trapezoid of 10 hours.
    """
    settings = OdometryFusionConfig(owners=OwnersConfig(position="none"))
    fusion = Fusion(settings)
    hours = 36_000 * S
    for start in (T0, T0 + hours):
        for k in range(21):
            fields = {"velocity_mps": np.array([1.0, 0, 0]), "map_q_base": LEVEL}
            fusion.take("dvl", record(**fields), start + k * S // 10)
    assert x_at(fusion, T0 + hours // 2) in ("after_odometry", "odometry_gap")
    last, first = fusion.at(T0 + 2 * S), fusion.at(T0 + hours)
    assert isinstance(last, FusedPose)
    assert isinstance(first, FusedPose)
    assert np.linalg.norm(first.pose.position_m - last.pose.position_m) < 1e-9
    assert first.segment > last.segment


def test_motion_of_one_nanosecond() -> None:
    """Two records a nanosecond and a millimetre apart do not determine the vehicle's speed.

    Naively it does 1000 km/s, and a pose carried on by that for 10 ms lies 10 km away.
    """
    fusion = Fusion(time_sync=TimeSyncConfig(max_stamp_diff_sec=0.2))
    for t_ns, x_m in ((T0, 0.0), (T0 + 1, 0.001)):
        fusion.take("ekf", record(**ahead(x_m)), t_ns)
    for off_ns in (0, 1, 1000, 10_000_000, 100_000_000):
        fused = fusion.at(T0 + off_ns)
        assert isinstance(fused, FusedPose)
        assert abs(fused.pose.position_m[0]) <= 0.002
        assert fused.velocity_mps is None


def test_two_velocities_of_one_stamp() -> None:
    """A velocity that is not newer than the last adds no way, and breaks none.

    Naively the fraction between them is 0 / 0, and the way NaN from there on.
    """
    way = DeadReckoning(S // 2, 0.1)
    for t_ns, v in (
        (T0, 1.0),
        (T0 + S // 10, 1.0),
        (T0 + S // 10, 9.0),
        (T0, 4.0),
        (T0 + S // 5, 1.0),
    ):
        way.add(t_ns, np.array([v, 0, 0]), in_map=True)
    way.advance(lambda _t: None, None)
    end = way.at(T0 + S // 5)
    assert end is not None
    assert end.value.displacement_m == pytest.approx([0.2, 0, 0], abs=1e-12)
    assert math.isfinite(end.value.variance_m2)


def test_way_summed_up_for_an_hour() -> None:
    """36 000 steps add up to the exact sum, to a nanometre.

    Naively single precision adds 10 cm to 3 km with an error of up to 0.1 mm each: the way is off
    by a centimetre or two.
    """
    way, chance = DeadReckoning(S // 2, 0.1), np.random.default_rng(5)
    speeds = chance.uniform(0.5, 1.5, (36_001, 3))
    for k, velocity in enumerate(speeds):
        way.add(T0 + k * S // 10, velocity, in_map=True)
        if k % 1000 == 0 or k == len(speeds) - 1:
            way.advance(lambda _t: None, None)
    end = way.at(T0 + 3600 * S)
    assert end is not None
    for axis in range(3):
        column = speeds[:, axis].tolist()
        exact = 0.1 * math.fsum([*column[1:-1], 0.5 * column[0], 0.5 * column[-1]])
        assert end.value.displacement_m[axis] == pytest.approx(exact, abs=1e-9)
        steps = 0.05 * (speeds[1:, axis] + speeds[:-1, axis])
        assert abs(np.cumsum(steps.astype(np.float32), dtype=np.float32)[-1] - exact) > 1e-3
    assert end.value.variance_m2 == pytest.approx(3600 * 0.1**2, rel=1e-9)


@pytest.mark.parametrize("stamp_ns", [0, 1, 2**63 - 1])
def test_stamp_at_the_ends_of_64_bits(stamp_ns: int) -> None:
    """A stamp of 1970 or of 2262 is refused as one of a clock that is off, and fits no line.

    Naively its difference to now overflows 64 bits, and the oldest record looks like the newest.
    """
    fusion = dives_at(1.0, [T0, T0 + S // 10])
    wrong = Odometry(stamp_ns, "unix", **ahead(0.2))
    reject = fusion.take("ekf", wrong, T0 + S // 5)
    assert reject is not None
    assert reject.reason == "clock_off"
    assert x_at(fusion, T0 + S // 5) == pytest.approx(0.2, abs=1e-12)


@pytest.mark.parametrize("t_ns", [-(10**30), -1, 0, 10**30])
def test_moment_that_no_clock_has(t_ns: int) -> None:
    """Asked for a pose at a time far outside its records, fusion reports the distance in time.

    Naively the time is cast to 64 bits and wraps to some other moment, or motion is carried there.
    """
    for policy in ("interpolate", "nearest", "latest"):
        fusion = Fusion(time_sync=TimeSyncConfig(policy=policy))
        for k in range(5):
            fusion.take("ekf", record(**ahead(k * 0.1)), T0 + k * S // 10)
        found = fusion.at(t_ns)
        assert isinstance(found, Reject)
        assert found.reason in ("before_odometry", "after_odometry", "odometry_gap")
