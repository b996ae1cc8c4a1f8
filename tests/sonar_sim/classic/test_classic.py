import cv2
import numpy as np
import pytest
from sonar_sim.classic import classic_camera, classic_images, defects, scan
from sonar_sim.classic import pipeline as normals
from sonar_sim.classic import scan as visual
from sonar_sim.classic.pipeline import places


def test_the_gradients_are_those_of_an_even_slope() -> None:
    depth = np.full((20, 30), 5.0, dtype=np.float32)
    depth += 0.01 * np.arange(20, dtype=np.float32)[:, None]
    depth -= 0.02 * np.arange(30, dtype=np.float32)[None, :]
    down, across, ahead = normals.gradients(depth, 100.0)[10, 10]
    assert down / ahead == pytest.approx(0.01 / (depth[10, 10] / 100.0), rel=1e-4)
    assert across / ahead == pytest.approx(-0.02 / (depth[10, 10] / 100.0), rel=1e-4)


def test_gradients_vanish_well_inside_what_is_nothing() -> None:
    depth = np.zeros((20, 20), dtype=np.float32)
    depth[:, 10:] = 5.0
    unit = normals.gradients(depth, 100.0)
    assert np.all(unit[:, :8] == 0.0)
    assert np.all(unit[:, 8:, 2] == [0.0, 0.0, *unit[0, 10:, 2]])
    assert np.all(unit[:, 9, 1] > 0.0)
    wide = np.zeros((20, 20), dtype=np.float32)
    wide[:, ::4] = 5.0
    assert np.count_nonzero(normals.gradients(wide, 100.0)[:, 1:4, 1]) > 0


def test_each_channel_spans_its_range() -> None:
    depth, _ = defects.depth_image(classic_camera(), defects.floor(2.0), defects.sphere(5.0, 0.5))
    bent = normals.normals(depth, classic_camera().focal_px)
    assert bent.reshape(-1, 3).min(axis=0) == pytest.approx(0.0, abs=1e-6)
    assert bent.reshape(-1, 3).max(axis=0) == pytest.approx(1.0, abs=1e-6)


def test_the_later_pixel_keeps_the_cell() -> None:
    depth = np.full((2, 1), 5.0, dtype=np.float32)
    level = np.array([[0.9], [0.3]], dtype=np.float32)
    zero = np.zeros(1, dtype=np.float32)
    made = scan.projected(
        depth, level, zero, np.zeros(2, np.float32), np.zeros((400, 578), np.float32)
    )
    assert made[399 - int(400 * 5 / 17), 289] == np.float32(0.3)
    assert np.count_nonzero(made) == 1


def test_the_dilation_leaves_echoes_alone() -> None:
    made = np.zeros((400, 578), dtype=np.float32)
    made[200, 289], made[203, 289] = 0.9, 0.3
    grown = scan.blurred(made)
    assert grown[203, 289] == np.float32(0.3)
    assert grown[202, 289] == np.float32(0.9)


def test_colours_are_the_published_ones() -> None:
    values = np.array([0.4, 0.9, 1.2], dtype=np.float32)
    assert visual.colours(values).tolist() == [[127, 79, 51], [229, 207, 50], [255, 255, 0]]


def test_the_same_depth_gives_the_same_pictures_and_another_stream_other_speckle() -> None:
    depth, _ = defects.depth_image(classic_camera(), defects.floor(2.0), defects.sphere(8.0, 0.5))
    first, again = classic_images(depth), classic_images(depth)
    other = classic_images(depth, generator=np.random.default_rng(2))
    assert np.array_equal(first.fan, again.fan)
    assert not np.array_equal(first.raw_scan, other.raw_scan)
    assert np.array_equal(first.snr, other.snr)


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_a_frame_without_echoes_is_empty_water() -> None:
    images = classic_images(np.zeros((169, 760), dtype=np.float32))
    assert images.fan.shape == (400, 578, 3)
    level = images.raw_scan[images.raw_scan > 0.0]
    assert float(np.median(level)) == pytest.approx(0.2, abs=0.001)


def test_the_plan_view_s_places_miss_the_axis_by_a_pixel() -> None:
    x, y = places((169, 760), 389.0)
    assert x[380] == pytest.approx(-0.5 / 389.0, rel=1e-5)
    assert y[85] == 0.0


def test_arcs_and_spokes_are_white() -> None:
    fan = visual.picture(
        scan.sector_mask(classic_camera().horizontal_rad), classic_camera().horizontal_rad
    )
    assert fan[400 - 266, 289].min() > 200
    assert tuple(fan[0, 0]) == visual.BLUE
    assert cv2.countNonZero(cv2.inRange(fan, (250, 250, 250), (255, 255, 255))) > 300
