import pytest
from sonar_sim.water import Water, thermal_noise_db


@pytest.mark.parametrize(
    ("conditions", "low_band", "high_band"),
    [
        ((4, 35, 10, 8), 0.2570, 0.6112),
        ((10, 35, 10, 8), 0.2223, 0.4952),
        ((15, 35, 10, 8), 0.2139, 0.4423),
        ((20, 35, 10, 8), 0.2187, 0.4135),
        ((25, 35, 10, 8), 0.2366, 0.4077),
        ((10, 0, 1, 7), 0.1748, 0.4475),
        ((20, 0, 1, 7), 0.1238, 0.3169),
        ((10, 35, 1000, 8), 0.2091, 0.4718),
    ],
)
def test_absorption_equals_the_published_table(
    conditions: tuple[float, float, float, float], low_band: float, high_band: float
) -> None:
    water = Water(*conditions)
    assert water.absorption_db_per_m(750e3) == pytest.approx(low_band, rel=1e-3)
    assert water.absorption_db_per_m(1200e3) == pytest.approx(high_band, rel=1e-3)


@pytest.mark.parametrize(
    ("frequency_hz", "depth_m", "db_per_km"),
    [(50e3, 100, 15.18), (100e3, 0, 33.63), (1000e3, 0, 358.6)],
)
def test_absorption_holds_over_frequency(
    frequency_hz: float, depth_m: float, db_per_km: float
) -> None:
    found = Water(depth_m=depth_m).absorption_db_per_m(frequency_hz)
    assert found * 1e3 == pytest.approx(db_per_km, rel=1e-3)


@pytest.mark.parametrize(
    ("temperature_c", "salinity_ppt", "speed_mps"),
    [(20, 0, 1481.6200), (10, 35, 1489.9900), (25, 35, 1534.3563)],
)
def test_speed_of_sound_is_medwins(
    temperature_c: float, salinity_ppt: float, speed_mps: float
) -> None:
    water = Water(temperature_c, salinity_ppt, depth_m=0.0)
    assert water.speed_of_sound_mps == pytest.approx(speed_mps, abs=1e-4)


def test_thermal_noise_fills_the_band() -> None:
    assert thermal_noise_db(750e3, 1.0) == pytest.approx(42.5, abs=0.01)
    assert thermal_noise_db(750e3, 187.5e3) == pytest.approx(95.2, abs=0.05)
