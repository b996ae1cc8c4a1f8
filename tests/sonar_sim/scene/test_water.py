import dataclasses

import pytest
from sonar_sim.errors import SceneError
from sonar_sim.scene.suspended_matter import sediment_db_per_m
from sonar_sim.scene.water import Water, thermal_noise_db


def test_absorption_is_by_the_chosen_model() -> None:
    water = Water()
    assert water.absorption_db_per_m(750e3) == water.francois_garrison_db_per_m(750e3)
    other = dataclasses.replace(water, absorption_model="ainslie_mccolm")
    assert other.absorption_db_per_m(750e3) == water.ainslie_mccolm_db_per_m(750e3)
    assert other.absorption_db_per_m(750e3) > 1.05 * water.absorption_db_per_m(750e3)


@pytest.mark.parametrize(
    ("temperature_c", "salinity_ppt", "speed_mps"),
    [(20, 0, 1481.6200), (10, 35, 1489.9900), (25, 35, 1534.3563)],
)
def test_speed_of_sound_is_medwins(
    temperature_c: float, salinity_ppt: float, speed_mps: float
) -> None:
    water = Water(temperature_c, salinity_ppt, depth_m=0.0)
    assert water.speed_of_sound_mps == pytest.approx(speed_mps, abs=1e-4)


def test_profile_is_linear_between_its_depths_and_constant_beyond() -> None:
    water = Water(depth_m=5.0, profile=((0.0, 1510.0), (10.0, 1500.0), (12.0, 1490.0)))
    assert [water.speed_at_mps(z) for z in (-1.0, 5.0, 11.0, 50.0)] == [1510, 1505, 1495, 1490]
    assert water.speed_of_sound_mps == 1505.0
    assert water.largest_gradient_per_s == pytest.approx(5.0)
    assert Water().largest_gradient_per_s == 0.0
    assert Water().speed_at_mps(100.0) == Water().speed_of_sound_mps


def test_profile_must_increase_in_depth() -> None:
    with pytest.raises(SceneError, match="increase"):
        Water(profile=((5.0, 1500.0), (5.0, 1490.0)))
    with pytest.raises(SceneError, match="at least one"):
        Water(profile=())


@pytest.mark.parametrize(
    ("radius_m", "low_band", "high_band"),
    [(1e-6, 1.21, 1.82), (5e-6, 0.42, 0.54), (20e-6, 0.11, 0.14), (50e-6, 0.05, 0.08)],
)
def test_sediment_takes_what_uricks_table_has(
    radius_m: float, low_band: float, high_band: float
) -> None:
    assert sediment_db_per_m(750e3, 1.0, radius_m) == pytest.approx(low_band, abs=0.006)
    assert sediment_db_per_m(1200e3, 1.0, radius_m) == pytest.approx(high_band, abs=0.006)
    assert sediment_db_per_m(750e3, 0.1, radius_m) == pytest.approx(
        0.1 * sediment_db_per_m(750e3, 1.0, radius_m)
    )


def test_thermal_noise_fills_the_band() -> None:
    assert thermal_noise_db(750e3, 1.0) == pytest.approx(42.5, abs=0.01)
    assert thermal_noise_db(750e3, 187.5e3) == pytest.approx(95.2, abs=0.05)


@pytest.mark.parametrize("speed_mps", [0.0, -3.0, 343.0, 5000.0])
def test_a_profile_of_no_water_is_refused(speed_mps: float) -> None:
    with pytest.raises(SceneError, match="1300 to 1700 m/s"):
        Water(profile=((0.0, 1500.0), (5.0, speed_mps)))
