import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim.casting import MARGIN_BEAMS, Caster, fan_of
from sonar_sim.echo import echo_power
from sonar_sim.pattern import azimuth_amplitude
from sonar_sim.poses import Pose
from sonar_sim.scene import Scene
from sonar_sim.sonar import SonarSettings

Plate = Callable[..., Scene]
Decibel = Callable[[Any], float]
MU_DB = -25.0


def cells(
    scene: Scene, sonar: SonarSettings, pose: Pose, elevations: int = 112
) -> NDArray[np.float64]:
    fan = fan_of(sonar, elevations)
    hits = Caster(scene).cast(fan, pose, sonar.range_m)
    return echo_power(hits, fan, sonar, absorption_db_per_m=0.0)


def through_centre_beam(power: NDArray[np.float64], sonar: SonarSettings) -> NDArray[np.float64]:
    pattern = azimuth_amplitude(sonar.beam_width_rad, sonar.side_lobe_db)
    columns = power.shape[1]
    offset = (np.arange(columns) - (columns - 1) / 2.0) * sonar.sine_pitch
    return power @ np.square(pattern(offset))


@pytest.mark.parametrize(("range_m", "expected_db"), [(10, -120.65), (20, -129.47), (40, -143.10)])
def test_lambert_floor_under_a_level_sonar(
    plate: Plate, decibel: Decibel, range_m: float, expected_db: float
) -> None:
    sonar = SonarSettings(demanded_range_m=1.2 * range_m)
    floor = plate((50.0, 0.0, -2.0), (200.0, 0.0, 0.0), (0.0, 200.0, 0.0))
    power = cells(floor, sonar, Pose(np.zeros(3), np.eye(3)), elevations=900)
    row = round(range_m / sonar.range_resolution_m)
    mean = through_centre_beam(power, sonar)[row - 8 : row + 8].mean()
    # The table holds for 10 log mu = -27 and rows of 4 mm.
    expected_db += (MU_DB + 27.0) + 10.0 * math.log10(sonar.range_resolution_m / 0.004)
    assert decibel(mean) == pytest.approx(expected_db, abs=0.3)


def test_no_floor_echo_nearer_than_the_floor(plate: Plate) -> None:
    sonar = SonarSettings(demanded_range_m=6.0)
    floor = plate((0.0, 0.0, -4.0), (100.0, 0.0, 0.0), (0.0, 100.0, 0.0))
    down = Pose(np.zeros(3), np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))
    power = cells(floor, sonar, down)
    first = int(np.flatnonzero(power.sum(axis=1))[0])
    assert first * sonar.range_resolution_m == pytest.approx(4.0, abs=0.017)


def test_target_that_grows_with_range_falls_by_20_db_a_decade(
    plate: Plate, level_pose: Pose, decibel: Decibel
) -> None:
    """A target of fixed size falls by 40; this one, whose area rises by 20, is met by one set of
    rays at any range, so that nothing is left to their spacing.
    """
    sonar = SonarSettings(demanded_range_m=45.0)

    def total_db(range_m: float) -> float:
        edge_m = 0.1 * range_m
        target = plate((range_m, 0.0, 0.0), (0.0, edge_m, 0.0), (0.0, 0.0, edge_m))
        return decibel(cells(target, sonar, level_pose).sum())

    assert total_db(40.0) - total_db(4.0) == pytest.approx(-20.0, abs=0.02)


def test_surface_at_constant_grazing_falls_by_30_db_a_decade(
    plate: Plate, level_pose: Pose, decibel: Decibel
) -> None:
    sonar = dataclasses.replace(SonarSettings(), demanded_range_m=22.0)

    def cell_db(range_m: float) -> float:
        floor = plate((40.0, 0.0, -0.15 * range_m), (160.0, 0.0, 0.0), (0.0, 160.0, 0.0))
        power = through_centre_beam(cells(floor, sonar, level_pose, elevations=448), sonar)
        row = round(range_m / sonar.range_resolution_m)
        return decibel(power[row - 4 : row + 4].mean())

    assert cell_db(20.0) - cell_db(10.0) == pytest.approx(-9.03, abs=0.1)


def test_tessellation_does_not_change_the_echo(
    plate: Plate, level_pose: Pose, decibel: Decibel
) -> None:
    sonar = SonarSettings(demanded_range_m=6.0)
    sizes = ((4.0, 0.3, -0.2), (0.3, 0.5, 0.0), (-0.2, 0.0, 0.6))
    levels_db = [
        decibel(cells(plate(*sizes, cuts=cuts), sonar, level_pose).sum()) for cuts in (1, 2, 4, 8)
    ]
    assert max(levels_db) - min(levels_db) < 0.05


def test_more_rays_do_not_change_the_echo(plate: Plate, level_pose: Pose, decibel: Decibel) -> None:
    sonar = SonarSettings(demanded_range_m=8.0)
    floor = plate((6.0, 0.0, -1.0), (12.0, 0.0, 0.0), (0.0, 12.0, 0.0))
    some, twice = (
        through_centre_beam(cells(floor, sonar, level_pose, n), sonar) for n in (112, 224)
    )
    assert decibel(twice.sum()) - decibel(some.sum()) == pytest.approx(0.0, abs=0.1)


def test_grazing_floor_has_no_stripes(plate: Plate, level_pose: Pose) -> None:
    sonar = SonarSettings(demanded_range_m=10.0)
    floor = plate((6.0, 0.0, -1.0), (30.0, 0.0, 0.0), (0.0, 30.0, 0.0))
    power = cells(floor, sonar, level_pose)[:, MARGIN_BEAMS + 256]
    rows = power[300:600]
    smooth = np.convolve(rows, np.ones(9) / 9.0, "same")[5:-5]
    assert rows[5:-5] == pytest.approx(smooth, rel=0.1)


def test_nearer_surface_hides_the_farther_one(plate: Plate, level_pose: Pose) -> None:
    sonar = SonarSettings(demanded_range_m=8.0)
    near = plate((3.0, 0.0, 0.0), (0.0, 12.0, 0.0), (0.0, 0.0, 12.0))
    far = plate((6.0, 0.0, 0.0), (0.0, 12.0, 0.0), (0.0, 0.0, 12.0))
    both = Scene((*near.surfaces, *far.surfaces))
    assert np.array_equal(cells(both, sonar, level_pose), cells(near, sonar, level_pose))


def test_target_beyond_the_range_leaves_the_image_unchanged(plate: Plate, level_pose: Pose) -> None:
    sonar = SonarSettings(demanded_range_m=5.0)
    target = plate((6.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert cells(target, sonar, level_pose).sum() == 0.0
