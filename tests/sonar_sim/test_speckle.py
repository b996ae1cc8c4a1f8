import numpy as np
import pytest
from scipy.stats import kstest
from sonar_sim.casting import MARGIN_BEAMS
from sonar_sim.poses import Pose, rotation_of
from sonar_sim.sonar import SonarSettings
from sonar_sim.speckle import beam_former, pose_generator, scattered_field

SONAR = SonarSettings()


@pytest.fixture(scope="module")
def amplitude() -> np.ndarray:
    """Amplitudes (rows, beams) of a homogeneous surface, no noise, no quantiser."""
    generator = np.random.default_rng(3)
    power = np.ones((6000, SONAR.beams + 2 * MARGIN_BEAMS))
    beams: np.ndarray = np.abs(beam_former(SONAR)(scattered_field(power, generator)))
    return beams


def test_amplitude_of_independent_cells_is_rayleigh(amplitude: np.ndarray) -> None:
    independent = amplitude[::3, ::10].ravel().astype(np.float64)
    assert len(independent) > 100_000
    assert independent.std() / independent.mean() == pytest.approx(0.5227, abs=0.005)
    scale = np.sqrt(np.mean(np.square(independent)) / 2.0)
    assert kstest(independent, "rayleigh", args=(0.0, scale)).statistic < 0.01
    assert np.median(independent) / independent.mean() == pytest.approx(0.9394, abs=0.006)
    level_db = 20.0 * np.log10(independent)
    assert level_db.std() == pytest.approx(5.570, abs=0.06)


def test_neighbouring_beams_share_speckle_as_their_width_says(amplitude: np.ndarray) -> None:
    power = np.square(amplitude.astype(np.float64))
    correlation = np.corrcoef(power[:, :-1].ravel(), power[:, 1:].ravel())[0, 1]
    # exp(-d² / 2 s²) with s = 0.6006 widths holds for a Gaussian beam; Taylor's is close to it.
    assert correlation == pytest.approx(0.944, abs=0.015)


def test_neighbouring_rows_correlate_as_recorded(amplitude: np.ndarray) -> None:
    rows = amplitude[:, ::10].astype(np.float64)
    one = np.corrcoef(rows[:-1].ravel(), rows[1:].ravel())[0, 1]
    two = np.corrcoef(rows[:-2].ravel(), rows[2:].ravel())[0, 1]
    assert one == pytest.approx(0.19, abs=0.03)
    assert abs(two) < 0.05


def test_beam_forming_keeps_the_mean_power_level_over_the_fan(amplitude: np.ndarray) -> None:
    level = np.square(amplitude).mean(axis=0)
    assert level.min() > 0.85 * level.mean()


def test_standing_still_repeats_the_speckle_and_moving_renews_it() -> None:
    here = Pose(np.array([1.0, -2.0, -3.0]), rotation_of(0.1, 0.2, -0.3))
    there = Pose(here.position_m + np.array([0.05, 0.0, 0.0]), here.rotation)
    draws = [pose_generator(7, pose).standard_normal(2000) for pose in (here, here, there)]
    assert np.array_equal(draws[0], draws[1])
    assert abs(np.corrcoef(draws[0], draws[2])[0, 1]) < 0.1
