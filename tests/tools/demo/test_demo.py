import dataclasses

import numpy as np
import pytest
from demo.map_truth import MapAccuracy
from demo.picture import Camera, cubes, render
from demo.run import MAX_MEDIAN_M, MIN_COVERAGE, SCENE, report
from sonar_sim import CaptureSettings, load_scenario
from sonar_sim.capture import ping_times_s

GOOD = MapAccuracy(
    voxel_m=0.1,
    occupied_voxels=1000,
    median_m=MAX_MEDIAN_M,
    p95_m=0.2,
    max_m=1.0,
    share_within_voxel=0.8,
    seen_points=1000,
    coverage=MIN_COVERAGE,
    coverage_one_voxel=0.85,
)


def test_demo_succeeds_at_the_promised_figures_and_fails_beyond_either(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert report(GOOD, []) == 0
    assert "not as promised" not in capsys.readouterr().out
    assert report(dataclasses.replace(GOOD, median_m=0.101), []) == 1
    assert report(dataclasses.replace(GOOD, coverage=0.899), []) == 1
    assert "not as promised" in capsys.readouterr().out


def test_survey_has_pings_enough() -> None:
    assert len(ping_times_s(load_scenario(SCENE), CaptureSettings())) >= 300


def test_cube_is_drawn_where_it_stands_and_nowhere_else() -> None:
    camera = Camera((0.0, -5.0, 0.0), (0.0, 0.0, 0.0), width=90, height=60, field_of_view_deg=40)
    boxes = cubes(np.array([[0.8, 0.0, 0.5]]), 0.4)
    assert boxes.shape == (12, 3, 3)
    picture = render(boxes, np.ones((12, 3)), camera, water=(0.0, 0.0, 0.0))
    rows, columns = np.nonzero(picture[..., 0])
    # To the right of the middle and above it; the picture is 3.64 m wide there.
    assert columns.mean() == pytest.approx(44.5 + 0.8 / 3.64 * 90, abs=1.5)
    assert rows.mean() == pytest.approx(29.5 - 0.5 / 3.64 * 90, abs=1.5)
