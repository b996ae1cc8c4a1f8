"""What fire messages make of the sonar, without pings."""

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sonar_sim.device.fire_settings import (
    PROCESSING_S,
    initial_request,
    part_number_of,
    period_s,
    settings_for,
)
from sonar_sim.errors import SceneError
from sonar_sim.geometry.trajectory import Motion, Route, Trajectory, Waypoint
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.sonar import sonar_preset
from sonar_sim.scene.water import Water

from oculus_driver.models import model_of
from oculus_driver.virtual_sonar.device import FireRequest
from oculus_driver.wire import FireFlags, PingRate

METRES = FireFlags.RANGE_IN_METRES | FireFlags.SIMPLE_RETURN
WATER = Water()


@pytest.mark.parametrize("model", ["M370s", "M750d", "M1200d", "M3000d"])
def test_every_model_has_its_part_number(model: str) -> None:
    assert model_of(part_number_of(model)).family.name == model


def test_an_unknown_model_is_reported() -> None:
    with pytest.raises(SceneError, match=r"M9 does not speak .*M750d"):
        part_number_of("M9")


def test_the_first_demand_asks_for_the_scenarios_sonar(
    floor_scenario: Callable[..., Scenario],
) -> None:
    for changes in ({}, {"beams": 512, "bits": 16}, {"bits": 32, "gain_percent": 20.0}):
        sonar = floor_scenario(**changes).sonar
        assert settings_for(initial_request(sonar, 5.0), sonar, WATER) == sonar


@pytest.mark.parametrize(
    ("rate_hz", "setting"), [(2, 4), (5, 3), (7, 0), (10, 0), (15, 1), (40, 2), (99, 2)]
)
def test_the_first_ping_rate_is_the_slowest_that_will_do(rate_hz: float, setting: int) -> None:
    assert initial_request(sonar_preset(), rate_hz).ping_rate == setting


def test_mode_range_gain_gamma_beams_and_bits_are_obeyed() -> None:
    demand = FireRequest(
        mode=2,
        gamma=127,
        flags=METRES | FireFlags.FULL_BEAMS | FireFlags.SIXTEEN_BIT,
        range_demand=7.5,
        gain_percent=33.0,
    )
    made = settings_for(demand, sonar_preset(), WATER)
    assert (made.mode, made.frequency_hz) == (2, 1.2e6)
    assert (made.demanded_range_m, made.gain_percent, made.gamma_byte) == (7.5, 33.0, 127)
    assert (made.beams, made.bits) == (512, 16)


def test_ranges_are_of_the_mode() -> None:
    far = settings_for(FireRequest(flags=METRES, range_demand=500.0), sonar_preset(), WATER)
    assert far.demanded_range_m == 120.0
    share = FireRequest(mode=2, flags=FireFlags.SIMPLE_RETURN, range_demand=50.0)
    assert settings_for(share, sonar_preset(), WATER).demanded_range_m == 20.0
    near = settings_for(FireRequest(flags=METRES, range_demand=math.nan), sonar_preset(), WATER)
    assert 0.1 <= near.demanded_range_m <= 120.0


def test_a_mode_that_the_model_has_not_got_is_its_first() -> None:
    made = settings_for(FireRequest(mode=2, flags=METRES), sonar_preset("M370s"), WATER)
    assert (made.mode, made.demanded_range_m) == (1, 10.0)


def test_the_sonar_believes_the_speed_and_salinity_that_is_set() -> None:
    sonar = sonar_preset()
    assert settings_for(FireRequest(flags=METRES), sonar, WATER).told_speed_mps is None
    request = FireRequest(flags=METRES, speed_of_sound_demand_mps=1450.0)
    assert settings_for(request, sonar, WATER).told_speed_mps == 1450.0
    fresh = settings_for(FireRequest(flags=METRES, salinity_ppt=0.0), sonar, WATER)
    assert fresh.told_speed_mps is not None
    assert fresh.told_speed_mps < WATER.speed_of_sound_mps - 30.0  # 1.3 m/s per ppt


@pytest.mark.parametrize(
    ("rate", "range_m", "hz"), [(PingRate.HIGHEST, 3.0, 40.0), (PingRate.LOWEST, 3.0, 2.0)]
)
def test_short_ranges_come_at_the_rate(rate: PingRate, range_m: float, hz: float) -> None:
    sonar = sonar_preset(demanded_range_m=range_m)
    demand = FireRequest(ping_rate=rate, flags=METRES)
    assert period_s(demand, sonar, WATER, 1000) == pytest.approx(1.0 / hz)


def test_long_ranges_take_the_sounds_way_there_and_back() -> None:
    sonar = sonar_preset(demanded_range_m=120.0)
    demand = FireRequest(ping_rate=PingRate.HIGHEST, flags=METRES)
    way_s = 2.0 * sonar.range_m / WATER.speed_of_sound_mps
    assert way_s == pytest.approx(0.161, abs=0.001)
    assert period_s(demand, sonar, WATER, 1000) == pytest.approx(way_s + PROCESSING_S)


def test_a_network_limit_makes_pings_fewer() -> None:
    demand = FireRequest(ping_rate=PingRate.HIGHEST, flags=METRES, network_speed_mbps=10)
    sonar = sonar_preset(demanded_range_m=3.0)
    assert period_s(demand, sonar, WATER, 250_000) == pytest.approx(0.2)


def test_a_route_comes_back_stern_first() -> None:
    path = Trajectory(
        [Waypoint(0.0, 0.0, -1.0, 30.0), Waypoint(4.0, 0.0, -1.0, 60.0)], Motion(speed_mps=0.5)
    )
    length_s = path.duration_s
    back = Route(path, "back")
    for ahead_s in (1.0, 3.3):
        there, again = back.pose(ahead_s), back.pose(2 * length_s - ahead_s)
        assert again.position_m == pytest.approx(there.position_m)
        late_s = 2 * length_s - ahead_s
        assert back.velocity_mps(late_s) == pytest.approx(-back.velocity_mps(ahead_s))
        assert back.turn_rates_rps(late_s) == pytest.approx(-back.turn_rates_rps(ahead_s))
        third_s = 2 * length_s + ahead_s
        assert back.pose(third_s).position_m == pytest.approx(there.position_m)
    stay = Route(path, "stay")
    assert stay.pose(1e4).position_m == pytest.approx(path.pose(length_s).position_m)
    assert not stay.velocity_mps(1e4).any()
    assert Route(path, "stop").duration_s == length_s


BYTES = st.integers(0, 255)
ANY_DEMAND = st.builds(
    FireRequest,
    version=st.sampled_from([1, 2]),
    mode=BYTES,
    ping_rate=BYTES,
    network_speed_mbps=BYTES,
    gamma=BYTES,
    flags=BYTES,
    range_demand=st.floats(),
    gain_percent=st.floats(),
    speed_of_sound_demand_mps=st.floats(),
    salinity_ppt=st.floats(),
    extended_flags=st.integers(0, 2**32 - 1),
)


@given(ANY_DEMAND, st.sampled_from(["M370s", "M750d", "M1200d", "M3000d"]))
def test_no_fire_message_asks_for_what_cannot_be(demand: FireRequest, model: str) -> None:
    sonar = settings_for(demand, sonar_preset(model), WATER)
    assert 0.1 <= sonar.demanded_range_m <= sonar.max_range_m
    assert 1 <= sonar.rows <= 720
    assert 0.0 <= sonar.gain_percent <= 100.0
    assert sonar.told_speed_mps is None or 1300.0 <= sonar.told_speed_mps <= 1700.0
    period = period_s(demand, sonar, WATER, 10_000)
    assert 2.0 * sonar.range_m / 1600.0 < period <= 1.0


@pytest.mark.parametrize("max_rows", [1, 720])
def test_a_range_shorter_than_a_row_is_one_row(max_rows: int) -> None:
    sonar = sonar_preset(base_row_m=0.5, max_rows=max_rows)
    made = settings_for(FireRequest(flags=METRES, range_demand=0.3), sonar, WATER)
    assert (made.rows, made.range_m) == (1, 0.5)
    forced = sonar_preset(base_row_m=0.5, max_rows=max_rows, forced_rows=200)
    made = settings_for(FireRequest(flags=METRES, range_demand=0.3), forced, WATER)
    assert made.rows == 200
    assert made.range_m == pytest.approx(0.3)


def test_settings_that_modes_share_stay_when_the_mode_changes() -> None:
    own = {"side_lobe_db": 20.0, "tvg_spreading_log": 20.0, "pulse_s": 5e-4, "forced_rows": 200}
    sonar = sonar_preset("M1200d", 1, array_gain_db=30.0, crosstalk_db=None, **own)
    made = settings_for(FireRequest(mode=2, flags=METRES, range_demand=5.0), sonar, WATER)
    assert made.frequency_hz == sonar_preset("M1200d", 2).frequency_hz
    assert (made.array_gain_db, made.crosstalk_db) == (30.0, None)
    assert {name: getattr(made, name) for name in own} == own
