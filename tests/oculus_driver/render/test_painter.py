"""FanGeometry pictures: what the sonar heard stands where it was heard."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver import OculusError, Ping, bearing_table_cdeg, decode_ping
from oculus_driver.fan import ring_ranges_m
from oculus_driver.ping import caption_lines, format_time
from oculus_driver.render import Painter, Style, fit_fan, warp_to_fan
from oculus_driver.render.files import PngFolder, VideoFile
from oculus_driver.render.painter import spoke_bearings_deg

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from oculus_driver import Message

ROWS, BEAMS = 300, 256
RESOLUTION_M = 0.1


@pytest.fixture
def ping_of(
    make_ping: Callable[..., bytes], parse: Callable[[bytes], Message]
) -> Callable[..., Ping]:
    def make(image: Any, **changes: Any) -> Ping:
        values = {"image": image, "range_resolution_m": RESOLUTION_M} | changes
        ping = decode_ping(parse(make_ping(**values)))
        assert isinstance(ping, Ping)
        return ping

    return make


def spot(row: int, beam: int) -> Any:
    image = np.zeros((ROWS, BEAMS), dtype=np.uint8)
    image[row - 1 : row + 2, beam - 1 : beam + 2] = 250
    return image


@pytest.mark.parametrize("row", [60, 150, 280])
@pytest.mark.parametrize("beam", [10, 64, 128, 200, 250])
@pytest.mark.parametrize("half_deg", [30, 65])
def test_a_target_stands_at_its_range_and_bearing(
    ping_of: Callable[..., Ping], row: int, beam: int, half_deg: int
) -> None:  # quirks 26, 31: by the table, port left, ahead up
    ping = ping_of(spot(row, beam), bearings_cdeg=bearing_table_cdeg(BEAMS, np.radians(half_deg)))
    frame = Painter(Style(height_px=800, colours="grey", gamma=1.0, labels=False)).paint(ping)
    grey = frame[:, :, 0].astype(np.float64)
    grey[grey < 100.0] = 0.0
    y_px, x_px = np.nonzero(grey)
    metres_per_px = ping.max_range_m / 800
    across_m = (float(x_px.mean()) + 0.5 - frame.shape[1] / 2) * metres_per_px
    ahead_m = (800 - float(y_px.mean()) - 0.5) * metres_per_px
    range_m, bearing_rad = float(ping.ranges_m[row]), float(ping.bearings_rad[beam])
    assert across_m == pytest.approx(range_m * np.sin(bearing_rad), abs=1.5 * metres_per_px)
    assert ahead_m == pytest.approx(range_m * np.cos(bearing_rad), abs=1.5 * metres_per_px)


def test_the_real_ping_is_laid_out_sample_by_sample(captured: list[Message]) -> None:
    ping = decode_ping(captured[0])
    assert isinstance(ping, Ping)
    frame = Painter(Style(height_px=1600, colours="grey", gamma=1.0, labels=False)).paint(ping)
    fan = fit_fan(ping.bearings_rad, ping.max_range_m, frame.shape[1::-1], (0, 0, 0, 0))
    drawn, heard = [], []
    for row in range(200, 700, 20):
        for beam in range(5, 250, 10):
            x, y = fan.pixel(float(ping.ranges_m[row]), float(ping.bearings_rad[beam]))
            drawn.append(float(frame[round(y - 0.5), round(x - 0.5), 0]))
            heard.append(float(ping.image[row, beam]))
    assert np.corrcoef(drawn, heard)[0, 1] > 0.97
    assert np.median(np.abs(np.subtract(drawn, heard))) < 6.0


def test_beyond_the_fan_there_is_no_water(ping_of: Callable[..., Ping]) -> None:
    ping = ping_of(np.full((ROWS, BEAMS), 255, dtype=np.uint8))
    frame = Painter(Style(height_px=400, colours="grey", labels=False)).paint(ping)
    white = (frame == 255).all(axis=2)
    fan_share = (np.pi / 3) / (2 * np.sin(np.pi / 3))  # sector of ±60° over its rectangle
    assert white.mean() == pytest.approx(fan_share, abs=0.01)
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) == 2


def test_a_new_table_is_a_new_fan(ping_of: Callable[..., Ping]) -> None:  # quirk 26
    painter = Painter(Style(height_px=400, colours="grey", gamma=1.0, labels=False))
    wide = ping_of(spot(200, 250), bearings_cdeg=bearing_table_cdeg(BEAMS, np.radians(65)))
    narrow = ping_of(spot(200, 250), bearings_cdeg=bearing_table_cdeg(BEAMS, np.radians(20)))
    frames = [painter.paint(ping) for ping in (wide, narrow)]
    assert frames[0].shape == frames[1].shape
    right = [np.nonzero(frame[:, :, 0] > 100)[1].mean() for frame in frames]
    assert right[1] < right[0] - 50


def test_shape_and_resolution_may_change_from_ping_to_ping(
    ping_of: Callable[..., Ping],
) -> None:  # quirk 25
    painter = Painter(Style(height_px=400, labels=False, colours="grey", gamma=1.0))
    near = painter.paint(ping_of(spot(150, 128)[:200]))
    far = painter.paint(ping_of(spot(150, 128), range_resolution_m=0.2))
    y_px = [np.nonzero(frame[:, :, 0] > 100)[0].mean() for frame in (near, far)]
    assert y_px == pytest.approx([400 * (1 - 150.5 / 200), 400 * (1 - 150.5 / 300)], abs=2.0)


def test_gain_words_are_taken_out_and_rows_without_one_are_dark(
    ping_of: Callable[..., Ping],
) -> None:  # quirk 13
    image = np.full((ROWS, BEAMS), 100, dtype=np.uint16)
    gains = np.full(ROWS, 4, dtype=np.uint32)
    gains[150:] = 16
    gains[:50] = 0
    ping = ping_of(image, gains=gains)
    frame = Painter(Style(height_px=600, colours="grey", gamma=1.0, labels=False)).paint(ping)
    middle = frame[:, frame.shape[1] // 2, 0]
    assert middle[[550, 400, 100]].tolist() == [0, 255, 128]


def test_what_is_brighter_than_white_is_white_and_a_black_ping_is_black(
    ping_of: Callable[..., Ping],
) -> None:
    gains = np.ones(ROWS, dtype=np.uint32)
    painter = Painter(Style(height_px=600, colours="grey", gamma=1.0, labels=False))
    image = np.full((ROWS, BEAMS), 100, dtype=np.uint16)
    image[150:153, 127:130] = 250  # so few that they do not settle what is white
    frame = painter.paint(ping_of(image, gains=gains))
    assert (frame[200:400, frame.shape[1] // 2, 0] == 255).all()
    frame = painter.paint(ping_of(np.zeros_like(image), gains=gains))
    assert (frame[200:400, frame.shape[1] // 2] == 0).all()


def test_samples_stand_at_the_middles_of_their_rows() -> None:
    fan = fit_fan(np.radians(np.linspace(-30, 30, 8)), 10.0, (400, 400), (0, 0, 0, 0))
    level = np.repeat(np.arange(4, dtype=np.float32)[:, np.newaxis], 8, axis=1)
    laid = warp_to_fan(level, fan)
    expected = np.clip(4.0 * fan.row_share - 0.5, 0.0, 3.0)
    assert laid[~fan.outside] == pytest.approx(expected[~fan.outside], abs=0.05)


def test_labels_change_nothing_about_where_the_fan_may_be(ping_of: Callable[..., Ping]) -> None:
    ping = ping_of(spot(150, 128))
    frame = Painter(Style(height_px=700)).paint(ping)
    assert frame.shape[0] == 700
    assert all(size % 2 == 0 for size in frame.shape[:2])
    bare = Painter(Style(height_px=700, labels=False)).paint(ping)
    assert (frame[:60, :300] > 200).any()  # a caption
    assert not (bare[:60, :300] > 200).any()


def test_rings_are_round_numbers_that_end_within_the_image() -> None:
    assert ring_ranges_m(1.998) == [0.5, 1.0, 1.5, 2.0]
    assert ring_ranges_m(30.0) == [5.0, 10.0, 15.0, 20.0, 25.0, 30.0]
    assert ring_ranges_m(120.0) == [20.0, 40.0, 60.0, 80.0, 100.0, 120.0]


@given(st.floats(1e-5, 1e5))
def test_rings_are_few_whatever_the_range(range_m: float) -> None:
    rings = ring_ranges_m(range_m)
    assert len(rings) <= 6
    assert all(0.0 < ring <= range_m * 1.00201 for ring in rings)


def test_spokes_are_whole_degrees_of_the_aperture() -> None:
    assert spoke_bearings_deg(np.radians([-30.0, 0.0, 30.0])) == [-30, -20, -10, 0, 10, 20, 30]
    assert spoke_bearings_deg(np.radians([-65.0, 65.0])) == [-60, -45, -30, -15, 0, 15, 30, 45, 60]
    assert spoke_bearings_deg(np.radians([-3.0, 3.0])) == [0]
    assert spoke_bearings_deg(np.radians([11.0, 43.0])) == [15, 20, 25, 30, 35, 40]


def test_the_caption_reports_what_the_ping_is(captured: list[Message]) -> None:
    ping = decode_ping(captured[0])
    assert isinstance(ping, Ping)
    assert caption_lines(ping) == [
        "ping 415323   703 rows x 256 beams   8 bit",
        "range 2.00 m   mode 2   2.099 MHz   gain 50 %   sound 1490.7 m/s",
        "2001-09-09 01:46:40.000 UTC",
    ]
    assert format_time(1 << 90) == f"{1 << 90} ns"


@pytest.mark.parametrize(
    "changes",
    [
        {"rows": 1, "beams": 1},
        {"rows": 5000, "beams": 3},
        {"rows": 2, "beams": 20000},
        {"rows": 1, "beams": 2, "range_resolution_m": 1e-5},
        {"rows": 1, "beams": 2, "range_resolution_m": 9.0},
        {"bearings_cdeg": np.zeros(256, dtype=np.int16)},
        {"bearings_cdeg": np.arange(256, 0, -1).astype(np.int16)},
        {"dtype": np.uint32},
        {"frequency_hz": float("nan"), "gain_percent": float("inf"), "speed_of_sound_mps": 1e300},
    ],
)
def test_no_ping_is_too_strange_to_draw(
    make_ping: Callable[..., bytes], parse: Callable[[bytes], Message], changes: dict[str, Any]
) -> None:
    ping = decode_ping(parse(make_ping(**changes)))
    assert isinstance(ping, Ping)
    frame = Painter(Style(height_px=200)).paint(ping)
    assert frame.shape[0] == 200


@pytest.mark.parametrize(
    "style",
    [Style(height_px=5), Style(colours="pink"), Style(gamma=0.0), Style(gamma=float("nan"))],
)
def test_a_style_that_cannot_be_is_refused(style: Style) -> None:
    with pytest.raises(OculusError, match=r"style|height"):
        Painter(style)


def test_a_film_has_all_frames(tmp_path: Path) -> None:
    path = tmp_path / "dive.mp4"
    with VideoFile(path, 5.0) as film:
        for level in (20, 120, 220):
            film.add(np.full((120, 160, 3), level, dtype=np.uint8), "")
    reader = cv2.VideoCapture(str(path))
    levels = []
    while (read := reader.read())[0]:
        levels.append(float(np.mean(read[1])))
    assert reader.get(cv2.CAP_PROP_FPS) == 5.0
    reader.release()
    assert levels == pytest.approx([20, 120, 220], abs=4.0)


def test_a_place_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OculusError, match="cannot be written"):
        PngFolder(tmp_path / "file")
    with (
        pytest.raises(OculusError, match="cannot be written"),
        VideoFile(tmp_path / "no" / "a.mp4", 5),
    ):
        VideoFile(tmp_path / "no" / "a.mp4", 5).add(np.zeros((120, 160, 3), dtype=np.uint8), "")


def test_detections_are_marked_where_they_are(ping_of: Callable[..., Ping]) -> None:
    image = np.random.default_rng(3).integers(1, 5, (ROWS, BEAMS)).astype(np.uint8)
    image[140:161, 120:137] = 250
    ping = ping_of(image, bearings_cdeg=bearing_table_cdeg(BEAMS, np.radians(65)))
    plain, marked = (
        Painter(Style(600, "grey", labels=False, echo_factor=factor)) for factor in (0.0, 5.0)
    )
    changed = (plain.paint(ping) != marked.paint(ping)).any(axis=2)
    fan = fit_fan(ping.bearings_rad, ping.max_range_m, (changed.shape[1], 600), (0, 0, 0, 0))
    row, beam = fan.row_share * ROWS, fan.beam
    inside = (row > 141) & (row < 160) & (beam > 121) & (beam < 135)
    around = (row > 138) & (row < 163) & (beam > 118) & (beam < 138)
    assert inside.sum() > 100
    assert changed[inside].all()
    assert not changed[~around].any()
