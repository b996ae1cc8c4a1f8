import io

import numpy as np
import pytest

from mapperd.export.picture import MAX_PIXELS, can_draw, project, write_picture
from mapperd.mapping.sonar_map import Voxels

pytestmark = pytest.mark.skipif(not can_draw(), reason="matplotlib (extra topside) is missing")


def cloud(centres: np.ndarray) -> Voxels:
    count = len(centres)
    return Voxels(centres, np.full(count, 0.9, np.float32), np.ones(count, np.uint16))


def drawn(centres: np.ndarray, resolution_m: float) -> tuple[int, int]:
    """Width and height of the picture, read from its first chunk."""
    file = io.BytesIO()
    write_picture(file, cloud(centres), resolution_m, "a map")
    data = file.getvalue()
    assert data.startswith(b"\x89PNG")
    return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("centres", "resolution_m"),
    [
        (np.zeros((0, 3)), 0.1),
        (np.array([[1.05, 2.05, -3.05]]), 0.1),
        (np.array([[1e6, 1e6, -5.0], [1e6 + 0.1, 1e6, -5.0]]), 0.1),
        (np.array([[0.0, 0.0, z / 1000] for z in range(20)]), 0.001),
        (np.array([[x, 0.0, 0.0] for x in np.arange(0, 5000, 0.5)]), 0.5),
        (np.array([[-1e5, -1e5, -1e4], [1e5, 1e5, 1e4]]), 0.1),
    ],
    ids=["empty", "one voxel", "far away", "tiny pole", "long line", "huge"],
)
def test_any_map_is_a_picture(centres: np.ndarray, resolution_m: float) -> None:
    width, height = drawn(centres, resolution_m)
    assert width > 1000
    assert height > 700


def test_highest_voxel_colours_the_pixel() -> None:
    centres = np.array([[0.05, 0.05, 1.05], [0.05, 0.05, 3.05], [0.25, 0.05, 2.05]])
    [view] = project(cloud(centres), 0.1, [(0, 1)])
    assert view.height_m.shape == (1, 3)
    assert view.height_m[0, 0] == 3.05
    assert np.isnan(view.height_m[0, 1])
    assert view.height_m[0, 2] == 2.05
    assert view.extent_m == pytest.approx((0.0, 0.3, 0.0, 0.1))


def test_every_voxel_falls_on_a_pixel_of_its_own() -> None:
    axis = np.arange(50) * 0.05 + 0.025 - 1e4
    centres = np.stack(np.meshgrid(axis, axis, [0.0]), axis=-1).reshape(-1, 3)
    [view] = project(cloud(centres), 0.05, [(0, 1)])
    assert view.height_m.shape == (50, 50)
    assert not np.isnan(view.height_m).any()


def test_long_map_shares_pixels_along_its_length_only() -> None:
    centres = np.array([[x, y, 0.0] for x in range(10 * MAX_PIXELS) for y in (0.0, 5.0)])
    [view] = project(cloud(centres), 1.0, [(0, 1)])
    rows, columns = view.height_m.shape
    assert rows == 6
    assert columns <= MAX_PIXELS
    left, right, bottom, top = view.extent_m
    assert right - left >= 10 * MAX_PIXELS
    assert top - bottom == pytest.approx(6.0)
