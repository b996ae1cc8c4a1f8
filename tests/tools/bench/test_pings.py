import struct
from pathlib import Path

import numpy as np
import pytest
from bench.inputs import (
    ELEVATIONS,
    MAGIC,
    Pings,
    first_rows,
    load,
    loud_share,
    only_first_returns,
    ray_ends_m,
    write_rays,
)

APERTURE_RAD = np.radians(20.0)
ROW_M = 0.5
ABOVE, BELOW = 36, 35  # the default threshold is 35, and a return lies above it


def pings() -> Pings:
    """Two pings of three beams: returns in the outer beams of the first, none in the second."""
    images = np.zeros((2, 20, 3), dtype=np.uint8)
    images[0, 0, 0] = 255  # nearer than min_range
    images[0, 7, 0] = ABOVE
    images[0, 9, 0] = 200
    images[0, 5, 1] = BELOW
    images[0, 3, 2] = 255
    turned_left_and_moved = np.array(
        [[0.0, -1.0, 0.0, 10.0], [1.0, 0.0, 0.0, 20.0], [0.0, 0.0, 1.0, -3.0], [0, 0, 0, 1]]
    )
    poses = np.stack([turned_left_and_moved, np.eye(4)])
    return Pings(images, np.radians([-90.0, 0.0, 60.0]), ROW_M, poses)


def test_first_return_is_above_the_threshold_and_not_too_near() -> None:
    assert first_rows(pings().images[0], ROW_M).tolist() == [7, -1, 3]
    assert first_rows(pings().images[1], ROW_M).tolist() == [-1, -1, -1]


def test_loud_pixels_are_those_above_the_threshold() -> None:
    assert loud_share(pings()) == 4 / (2 * 20 * 3)


def test_image_of_first_returns_holds_nothing_else() -> None:
    kept = only_first_returns(pings().images[0], ROW_M)
    assert np.argwhere(kept).tolist() == [[3, 2], [7, 0]]
    assert (kept[7, 0], kept[3, 2]) == (ABOVE, 255)
    echo = pings().echo(0, first_returns_only=True)
    assert np.array_equal(echo.intensity, kept)
    assert echo.max_range_m == 10.0
    assert np.array_equal(pings().echo(0, first_returns_only=False).intensity, pings().images[0])


def test_each_first_return_becomes_eleven_ends_over_the_aperture() -> None:
    ends_m = ray_ends_m(pings(), 0, APERTURE_RAD).reshape(2, ELEVATIONS, 3)
    elevation = np.radians(np.arange(-10, 11, 2))
    origin_m = np.array([10.0, 20.0, -3.0])
    # Bearing -90 is to port, the sonar's y; turned left by 90 degrees that is the map's -x.
    port = 3.75 * np.stack([-np.cos(elevation), 0 * elevation, np.sin(elevation)], axis=1)
    assert ends_m[0] == pytest.approx(port + origin_m, abs=1e-12)
    # 60 degrees to starboard, seen from y: x is sin 60, y is cos 60.
    side, ahead = np.sqrt(3) / 2, 0.5
    starboard = 1.75 * np.stack(
        [side * np.cos(elevation), ahead * np.cos(elevation), np.sin(elevation)], axis=1
    )
    assert ends_m[1] == pytest.approx(starboard + origin_m, abs=1e-12)


def test_pings_are_read_back_as_they_were_saved(tmp_path: Path) -> None:
    saved = pings()
    saved.save(tmp_path / "pings.npz")
    read = load(tmp_path / "pings.npz")
    assert np.array_equal(read.images, saved.images)
    assert np.array_equal(read.bearings_rad, saved.bearings_rad)
    assert np.array_equal(read.map_T_sonar, saved.map_T_sonar)
    assert read.range_resolution_m == saved.range_resolution_m
    assert [file.name for file in tmp_path.iterdir()] == ["pings.npz"]


def test_rays_are_written_as_the_rivals_read_them(tmp_path: Path) -> None:
    write_rays(tmp_path / "rays", pings(), APERTURE_RAD)
    data = (tmp_path / "rays").read_bytes()
    assert data.startswith(MAGIC)
    assert struct.unpack_from("<I", data, 8) == (2,)
    assert struct.unpack_from("<3dI", data, 12) == (10.0, 20.0, -3.0, 2 * ELEVATIONS)
    ends = np.frombuffer(data, "<f4", count=6 * ELEVATIONS, offset=40).reshape(-1, 3)
    assert np.array_equal(ends, ray_ends_m(pings(), 0, APERTURE_RAD).astype(np.float32))
    assert struct.unpack_from("<3dI", data, 40 + ends.nbytes) == (0.0, 0.0, 0.0, 0)
    assert len(data) == 40 + ends.nbytes + 28
