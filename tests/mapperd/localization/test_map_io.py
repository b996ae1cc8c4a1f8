import io
import math
import re
import struct
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from mapperd.errors import ExportError, MapError
from mapperd.localization.map_io import Mode, pgm_bytes, pgm_pixels, read_nav2_map, write_nav2_map
from mapperd.localization.maps import FREE, OCCUPIED, UNKNOWN, GridMap

YAML = """\
image: map.pgm
resolution: 0.05
origin: [-10, 2.5, 0.3]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
PIXELS = np.array([[0, 89, 90, 205, 206], [254, 255, 100, 50, 128]], dtype=np.uint8)


def written(
    folder: Path, text: str = YAML, image: bytes | None = None, name: str = "map.pgm"
) -> Path:
    (folder / name).write_bytes(pgm_bytes(PIXELS) if image is None else image)
    path = folder / "map.yaml"
    path.write_text(text)
    return path


def cells(folder: Path, text: str) -> list[list[int]]:
    """Of the far row first, as the image has them."""
    rows: list[list[int]] = read_nav2_map(written(folder, text)).occupancy[::-1].tolist()
    return rows


def test_trinary_is_the_default_and_row_0_is_the_far_end_of_y(tmp_path: Path) -> None:
    grid = read_nav2_map(written(tmp_path))
    # Darkness is 1, 0.651, 0.647, 0.196, 0.192 / 0.004, 0, 0.608, 0.804, 0.498.
    assert grid.occupancy.tolist() == [[0, 0, -1, 100, -1], [100, 100, -1, -1, 0]]
    assert (grid.resolution_m, grid.origin_x_m, grid.origin_y_m) == (0.05, -10, 2.5)
    assert grid.origin_yaw_rad == 0.3


def test_negate_makes_bright_occupied(tmp_path: Path) -> None:
    text = YAML.replace("negate: 0", "negate: 1")
    # Brightness is 0, 0.349, 0.353, 0.804, 0.808 / 0.996, 1, 0.392, 0.1961, 0.502.
    assert cells(tmp_path, text) == [[0, -1, -1, 100, 100], [100, 100, -1, -1, -1]]


def test_scale_has_percents_between_the_thresholds(tmp_path: Path) -> None:
    found = cells(tmp_path, YAML + "mode: scale\n")
    share = (1 - np.array([90, 205, 206, 100, 50, 128]) / 255 - 0.196) / (0.65 - 0.196)
    expected = np.rint(100 * share).astype(int)
    assert found[0] == [100, 100, expected[0], expected[1], 0]
    assert found[1] == [0, 0, expected[3], 100, expected[5]]


def test_raw_is_the_cell_whatever_else_is_reported(tmp_path: Path) -> None:
    text = YAML.replace("negate: 0", "negate: 1") + "mode: raw\n"
    assert cells(tmp_path, text) == [[0, 89, 90, -1, -1], [-1, -1, 100, 50, -1]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (YAML + "mode: fancy\n", "mode"),
        (YAML + "colour: red\n", "colour"),
        (YAML + "image: again.pgm\n", "twice|duplicate|again"),
        (YAML.replace("0.05", "0"), "resolution"),
        (YAML.replace("0.05", ".nan"), "finite|resolution"),
        (YAML.replace("0.05", "-1"), "resolution"),
        (YAML.replace("-10", ".inf"), "finite"),
        (YAML.replace("[-10, 2.5, 0.3]", "[1, 2]"), "origin|length"),
        (YAML.replace("0.65", "1.5"), "occupied_thresh"),
        (YAML.replace("0.65", "0.1"), "free_thresh is above"),
        (YAML.replace("free_thresh: 0.196\n", ""), "free_thresh"),
        (YAML.replace("map.pgm", "nowhere.pgm"), r"nowhere\.pgm: cannot be read"),
        (YAML.replace("map.pgm", "."), "no regular file"),
        (YAML.replace("map.pgm", '"a\\0b"'), "."),
        ("[]", "object"),
        ("", "object"),
        ("{", "."),
        ("# " + 70_000 * "x", "larger than"),
    ],
)
def test_files_that_are_no_map_are_reported_why(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(MapError, match=words) as caught:
        read_nav2_map(written(tmp_path, text))
    assert caught.value.reason == "bad_map_file"


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (b"", "no binary grey"),
        (b"P2\n2 1\n255\n1 2", "no binary grey"),
        (b"P6\n2 1\n255\n123456", "no binary grey"),
        (b"P5\n2 1\n65535\n1234", "8 bits"),
        (b"P5\n2 1\n0\n12", "8 bits"),
        (b"P5\n0 1\n255\n", "pixels; allowed"),
        (b"P5\n999999999 999999999\n255\n", "pixels; allowed"),
        (b"P5\n2 2\n255\n123", "3 bytes of pixels"),
        (b"P5\n2 1\n255\n123", "3 bytes of pixels"),
        (b"P5\n2 1\n10\n\x0a\x0b", "above its brightest"),
    ],
)
def test_images_that_are_invalid_are_reported_why(tmp_path: Path, image: bytes, words: str) -> None:
    with pytest.raises(MapError, match=words):
        read_nav2_map(written(tmp_path, image=image))


def test_comments_and_other_scales_are_images() -> None:
    assert pgm_pixels(b"P5 # made by\n# me\n2\t1 # size\n255\n\x01\x02", "x").tolist() == [[1, 2]]
    assert pgm_pixels(b"P5\n3 1\n2\n\x00\x01\x02", "x").tolist() == [[0, 128, 255]]


IMAGE = (b"\n2 1\n255\n", b"\1\2")
headers = st.tuples(*[st.integers(0, 9)] * 2, st.sampled_from([0, 1, 9, 255, 300]))


@given(st.binary(max_size=60) | headers.map(lambda h: b"\n%d %d\n%d\n" % h), st.binary(max_size=81))
@example(*IMAGE)
def test_any_bytes_are_an_image_or_refused(head: bytes, body: bytes) -> None:
    try:
        pixels = pgm_pixels(b"P5" + head + body, "x")
    except MapError:
        assert (head, body) != IMAGE
        return
    width, height = map(int, re.sub(rb"#.*", b"", head + body).split()[:2])
    assert pixels.shape == (height, width)
    assert pixels.dtype == np.uint8


FORMATS = ("png", "bmp")


def encoded(image: np.ndarray, kind: str) -> bytes:
    """By Pillow, another writer than the one that reads."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, kind)
    return file.getvalue()


def cells_of(folder: Path, image: bytes, kind: str, more: str = "") -> list[list[int]]:
    text = YAML.replace("map.pgm", f"map.{kind}") + more
    path = written(folder, text, image, f"map.{kind}")
    rows: list[list[int]] = read_nav2_map(path).occupancy[::-1].tolist()
    return rows


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("mode", get_args(Mode))
def test_pictures_are_the_map_of_the_grey_image(tmp_path: Path, kind: str, mode: str) -> None:
    more = f"mode: {mode}\n"
    expected = cells(tmp_path, YAML + more)
    grey = PIXELS
    for image in (grey, np.dstack([grey] * 3)):
        assert cells_of(tmp_path, encoded(image, kind), kind, more) == expected
    if kind == "png":
        deep = encoded(grey.astype(np.uint16) * 257, kind)
        assert cells_of(tmp_path, deep, kind, more) == expected
        flat = Image.fromarray(grey).convert("P")
        file = io.BytesIO()
        flat.save(file, "png")
        assert cells_of(tmp_path, file.getvalue(), kind, more) == expected


def test_colours_count_by_their_mean(tmp_path: Path) -> None:
    image = np.array([[[255, 0, 0], [255, 255, 240], [0, 10, 30], [90, 90, 93]]], dtype=np.uint8)
    for kind in FORMATS:
        assert cells_of(tmp_path, encoded(image, kind), kind) == [[100, 0, 100, -1]]
        raw = cells_of(tmp_path, encoded(image, kind), kind, "mode: raw\n")
        assert raw == [[85, -1, 13, 91]]


def test_opacity_is_a_colour_in_trinary_and_makes_unknown_in_scale(tmp_path: Path) -> None:
    grey = np.array([[0, 0, 254, 254]], dtype=np.uint8)
    alpha = np.array([[255, 0, 255, 0]], dtype=np.uint8)
    image = encoded(np.dstack([grey, grey, grey, alpha]), "png")
    # Darkness is 0.75, 1, 0.003, 0.253 with the opacity as a fourth colour.
    assert cells_of(tmp_path, image, "png") == [[100, 100, 0, -1]]
    assert cells_of(tmp_path, image, "png", "mode: scale\n") == [[100, -1, 0, -1]]
    assert cells_of(tmp_path, image, "png", "mode: raw\n") == [[0, 0, -1, -1]]


@pytest.mark.parametrize("kind", FORMATS)
def test_pictures_that_are_invalid_are_reported_why(tmp_path: Path, kind: str) -> None:
    image = encoded(np.zeros((9, 7), np.uint8), kind)
    at, order = (16, ">II") if kind == "png" else (18, "<ii")
    huge = bytearray(image)
    struct.pack_into(order, huge, at, 100_000, 100_000)
    for data, words in (
        (image[:10], "not a whole image"),
        (image[:40], "not a whole image"),
        (bytes(huge), "100000 x 100000 pixels; allowed"),
        (b"GIF89a", r"no binary grey image \(PGM, P5\), PNG or BMP"),
    ):
        with pytest.raises(MapError, match=words) as caught:
            cells_of(tmp_path, data, kind)
        assert caught.value.reason == "bad_map_file"


def test_picture_without_its_library_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(MapError, match="OpenCV cannot be imported"):
        cells_of(tmp_path, encoded(PIXELS, "png"), "png")


def random_cells(values: list[int]) -> NDArray[np.int8]:
    return np.random.default_rng(2).choice(np.array(values, dtype=np.int8), (17, 23))


@pytest.mark.parametrize(
    ("mode", "values"),
    [
        ("trinary", [UNKNOWN, FREE, OCCUPIED]),
        ("scale", list(range(101))),
        ("raw", list(range(-1, 101))),
    ],
)
def test_written_maps_are_read_as_they_were(tmp_path: Path, mode: Any, values: list[int]) -> None:
    assert mode in get_args(Mode)
    grid = GridMap(random_cells(values), 0.1, -3.25, 1e-3, -2.0)
    write_nav2_map(grid, tmp_path / "m.yaml", mode)
    again = read_nav2_map(tmp_path / "m.yaml")
    assert np.array_equal(again.occupancy, grid.occupancy)
    for name in ("resolution_m", "origin_x_m", "origin_y_m", "origin_yaw_rad"):
        assert getattr(again, name) == getattr(grid, name)


def test_trinary_rounds_percents_to_what_they_mean(tmp_path: Path) -> None:
    grid = GridMap(np.array([[5, 30, 64, 65, 90]], dtype=np.int8), 0.1)
    write_nav2_map(grid, tmp_path / "m.yaml")
    assert read_nav2_map(tmp_path / "m.yaml").occupancy.tolist() == [[0, -1, -1, 100, 100]]


def test_scale_writes_the_nearest_pixel(tmp_path: Path) -> None:
    percents = np.array([[0, 2, 6, 98, 100]], dtype=np.int8)
    write_nav2_map(GridMap(percents, 1), tmp_path / "m.yaml", "scale")
    pixels = pgm_pixels((tmp_path / "m.pgm").read_bytes(), "m.pgm")
    assert pixels.tolist() == [[255, 250, 240, 5, 0]]  # of 255, 249.9, 239.7, 5.1, 0


def test_scale_refuses_unknown_cells_and_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="no pixel for unknown"):
        write_nav2_map(GridMap(np.array([[-1]], dtype=np.int8), 1), tmp_path / "m.yaml", "scale")
    assert list(tmp_path.iterdir()) == []


def test_folder_that_is_not_there_is_an_export_error(tmp_path: Path) -> None:
    with pytest.raises(ExportError):
        write_nav2_map(GridMap(np.array([[0]], dtype=np.int8), 1), tmp_path / "no" / "m.yaml")


@pytest.mark.parametrize(
    "arguments",
    [
        (np.zeros((0, 3), np.int8), 1.0),
        (np.zeros(3, np.int8), 1.0),
        (np.full((1, 1), -2, np.int8), 1.0),
        (np.full((1, 1), 101, np.int8), 1.0),
        (np.zeros((1, 1), np.int8), 0.0),
        (np.zeros((1, 1), np.int8), np.nan),
        (np.zeros((1, 1), np.int8), 1.0, np.inf),
    ],
)
def test_what_is_no_map_is_refused(arguments: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match=r"map|cells|edge|origin"):
        GridMap(*arguments)


def test_cells_and_points_agree_in_a_turned_map() -> None:
    grid = GridMap(random_cells([-1, 0, 100]), 1.0, 1.0, 1.0, np.pi / 2)
    row, column = (index.ravel() for index in np.indices(grid.occupancy.shape))
    centres = grid.centres_m(row, column)
    assert np.array_equal(grid.cells_at(centres), grid.occupancy.ravel())
    assert grid.centres_m(np.array([2]), np.array([2]))[0] == pytest.approx([-1.5, 3.5])
    outside = np.array([[1.1, 1.1], [np.nan, 0.0], [1e300, 0.0]])
    assert grid.cells_at(outside).tolist() == [UNKNOWN] * 3


def test_what_lies_just_outside_of_a_map_is_unknown() -> None:
    water = GridMap(np.full((2, 3), FREE, np.int8), 0.5, 1.0, 2.0)
    outside = [(0.9, 2.1), (1.1, 1.9), (2.6, 2.1), (1.1, 3.1), (math.nan, 2.1)]
    assert water.cells_at(np.array(outside)).tolist() == [UNKNOWN] * 5
    inside = [(1.01, 2.01), (2.49, 2.99)]
    assert water.cells_at(np.array(inside)).tolist() == [FREE] * 2
