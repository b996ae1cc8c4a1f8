"""The uncertainty of exported depths, judged by their errors on a flat floor of known depth."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from mapper_survey.export import ExportOptions, export_survey
from mapper_survey.surface import RULES, Rule

from mapperd.geometry.frames import pose_from_rpy
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap
from tests.tools.mapper_survey.maps import CONFIG, store_of

FLOORS_M = (-8.0, -8.03, -8.06)
"""Where a voxel's edge of 0.1 m is met, and between."""

ALTITUDE_M = 4.0
PINGS, STEP_M = 40, 0.25
BEARINGS_RAD = np.radians(np.linspace(-30, 30, 64))
ROWS, ROW_M = 350, 0.02
RANGES_M = (np.arange(ROWS)[:, None] + 0.5) * ROW_M


def mapped(floor_m: float, ping_noise_m: float, beam_noise_m: float) -> SonarMap:
    """A floor under a sonar that looks down, as it is with unknown heave and noise of ranges."""
    random = np.random.default_rng([41, round(-1000 * floor_m)])
    sonar_map = SonarMap(CONFIG)
    for number in range(PINGS):
        altitude_m = ALTITUDE_M + random.normal(0.0, ping_noise_m)
        noise_m = random.normal(0.0, beam_noise_m, len(BEARINGS_RAD))
        floor_ranges_m = altitude_m / np.cos(BEARINGS_RAD) + noise_m
        echo = np.where(np.abs(RANGES_M - floor_ranges_m) < 0.05, 190, 10).astype(np.float32)
        pose = pose_from_rpy((STEP_M * number, 0.0, floor_m + ALTITUDE_M), (0, 90, 0)).map_T_base
        sonar_map.integrate(PingImage(echo, BEARINGS_RAD, ROW_M), pose)
    return sonar_map


class Judge:
    """Root mean squares of errors and of their estimates, over the floors."""

    def __init__(self, folder: Path, ping_noise_m: float, beam_noise_m: float) -> None:
        self._folder = folder
        for floor_m in FLOORS_M:
            floor = mapped(floor_m, ping_noise_m, beam_noise_m)
            store_of(folder / f"{floor_m}.db", floor)

    def ratio(self, rule: Rule, given_m: float) -> float:
        """Errors by uncertainties; 1 is what standard deviations promise."""
        squares_m2 = np.zeros(2)
        for floor_m in FLOORS_M:
            options = ExportOptions(CONFIG, rule=rule, vertical_uncertainty_m=given_m)
            path = self._folder / f"{floor_m}.db"
            done = export_survey(path, self._folder, ["grid"], options=options)
            with rasterio.open(done.files["grid"]) as grid:
                depth_m, uncertainty_m, _ = grid.read(masked=True)
            assert depth_m.count() > 3000
            squares_m2 += [np.sum((depth_m + floor_m) ** 2), np.sum(uncertainty_m**2)]
        return float(np.sqrt(squares_m2[0] / squares_m2[1]))


@pytest.mark.parametrize("noise_m", [(0.0, 0.0), (0.1, 0.0), (0.0, 0.1)])
def test_noise_of_a_voxel_is_in_what_the_map_reports(
    tmp_path: Path, noise_m: tuple[float, float]
) -> None:
    judge = Judge(tmp_path, *noise_m)
    for rule in RULES:
        assert 0.4 < judge.ratio(rule, 0.0) < 1.3


def test_larger_noise_of_all_beams_has_to_be_given(tmp_path: Path) -> None:
    judge = Judge(tmp_path, 0.3, 0.0)
    for rule in RULES:
        assert 0.8 < judge.ratio(rule, 0.3) < 1.2
        assert judge.ratio(rule, 0.0) > 2.0  # as documented
