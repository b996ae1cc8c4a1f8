from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.tree import ScanExtractionConfig
from mapperd.imaging.ping_image import PingImage
from mapperd.localization.detector import (
    FirstReturns,
    RangeLimits,
    equalised,
    first_returns,
    levels_db,
)

ROW_M = 0.02


def found(echo: PingImage, min_m: float = 0.5, max_m: float = 10.0, **changes: Any) -> FirstReturns:
    settings = msgspec.structs.replace(ScanExtractionConfig(), **changes)
    levels = equalised(levels_db(echo.intensity), echo.range_resolution_m)
    return first_returns(levels, echo, RangeLimits(min_m, max_m, echo.range_resolution_m), settings)


def test_noise_has_hardly_a_return(make_echo: Any) -> None:
    returns = found(make_echo(beams=512, noise=15.0))
    assert np.isfinite(returns.range_m).mean() < 0.02
    assert (np.isnan(returns.range_m) == np.isnan(returns.height_db)).all()


def test_first_of_two_surfaces_is_found_within_a_row(make_echo: Any) -> None:
    echo = make_echo((4.01, 100, 0, 127), (6.01, 200, 0, 127))
    off = found(echo).range_m - 4.01
    assert np.abs(off).max() <= ROW_M


def test_beams_without_an_echo_have_none(make_echo: Any) -> None:
    there = np.isfinite(found(make_echo((5.0, 100, 30, 60))).range_m)
    assert there[30:61].all()
    assert there.sum() <= 33


def test_nothing_is_looked_for_outside_the_limits(make_echo: Any) -> None:
    echo = make_echo((0.3, 200, 0, 127), (3.01, 100, 0, 127), (8.0, 100, 0, 127))
    assert found(echo).range_m == pytest.approx(np.full(128, 3.01), abs=ROW_M)
    assert found(echo, min_m=0.1).range_m == pytest.approx(np.full(128, 0.3), abs=2 * ROW_M)
    assert found(echo, min_m=4.0).range_m == pytest.approx(np.full(128, 8.0), abs=2 * ROW_M)
    assert np.isnan(found(echo, max_m=2.5).range_m).all()
    assert np.isnan(found(echo, min_m=2.0, max_m=2.0).range_m).all()
    assert np.isnan(found(echo, min_m=50.0, max_m=60.0).range_m).all()


def test_an_echo_shorter_than_the_run_is_invalid(make_echo: Any) -> None:
    echo = make_echo((5.0, 100, 0, 127))
    image = echo.intensity.copy()
    image[251:256] = 2.0
    spike = PingImage(image, echo.bearings_rad, echo.range_resolution_m)
    assert np.isnan(found(spike).range_m).mean() > 0.95
    assert found(spike, min_run=1).range_m == pytest.approx(np.full(128, 5.01), abs=ROW_M)


def test_side_lobes_of_a_strong_echo_are_not_taken(make_echo: Any) -> None:
    echo = make_echo((5.0, 30, 0, 127), (5.0, 220, 60, 66), (7.0, 60, 0, 40))
    near = found(echo, side_lobe_ratio=15.0).range_m
    assert np.isnan(near[80:]).all()
    assert near[60:67] == pytest.approx(np.full(7, 5.01), abs=ROW_M)
    # The lobe does not hide what is behind it.
    assert near[:41] == pytest.approx(np.full(41, 7.01), abs=ROW_M)
    all_of_it = found(echo, side_lobe_ratio=60.0).range_m
    assert np.isfinite(all_of_it[80:]).mean() > 0.9


def test_peak_lies_behind_the_edge_of_a_surface_that_rises(make_echo: Any) -> None:
    echo = make_echo()
    image = echo.intensity.copy()
    for row, level in zip(
        range(250, 260), (30, 40, 60, 80, 100, 130, 150, 100, 60, 20), strict=True
    ):
        image[row] += level
    slant = PingImage(image, echo.bearings_rad, echo.range_resolution_m)
    edge = np.median(found(slant, beam_width=2.0).range_m)
    peak = np.median(found(slant, beam_width=2.0, place="peak").range_m)
    assert peak == pytest.approx(256.5 * ROW_M, abs=1e-9)
    # Half of 150 lies three quarters between the middles of rows 252 and 253, and half a row on.
    assert edge == pytest.approx(253.75 * ROW_M, abs=0.3 * ROW_M)


def test_height_is_that_over_the_background(make_echo: Any) -> None:
    weak = np.nanmedian(found(make_echo((5.0, 25, 0, 127))).height_db)
    strong = np.nanmedian(found(make_echo((5.0, 250, 0, 127))).height_db)
    assert strong - weak == pytest.approx(20, abs=1.5)


def test_a_slowly_rising_haze_is_no_surface(make_echo: Any) -> None:
    echo = make_echo(noise=1.0)
    haze = np.linspace(1, 12, 500)[:, None]
    image = np.clip(echo.intensity * haze, 0, 255).astype(np.float32)
    assert np.isfinite(found(PingImage(image, echo.bearings_rad, ROW_M)).range_m).mean() < 0.05


def test_a_haze_in_few_beams_is_no_surface_and_a_surface_in_it_is(make_echo: Any) -> None:
    echo = make_echo(noise=2.0)
    image = echo.intensity.copy()
    image[:, :20] *= np.linspace(1, 12, 500)[:, None]
    hazy = PingImage(np.clip(image, 0, 255), echo.bearings_rad, ROW_M)
    assert np.isfinite(found(hazy).range_m).sum() <= 3
    image[400:404, :20] += 240
    wall = PingImage(np.clip(image, 0, 255), echo.bearings_rad, ROW_M)
    assert np.nanmedian(found(wall).range_m[:20]) == pytest.approx(8.01, abs=ROW_M)


def test_the_guard_keeps_a_surface_that_rises_slowly_out_of_its_background(make_echo: Any) -> None:
    echo, limits = make_echo(), RangeLimits(0.5, 10.0, ROW_M)
    bright = PingImage(np.full(echo.intensity.shape, 50, np.float32), echo.bearings_rad, ROW_M)
    levels = np.zeros(echo.intensity.shape, np.float32)
    levels[240:280] = 0.7 * np.arange(1, 41)[:, None]
    for guard_m, there in ((ROW_M, False), (5 * ROW_M, True)):
        settings = msgspec.structs.replace(ScanExtractionConfig(), guard=guard_m)
        assert (np.isfinite(first_returns(levels, bright, limits, settings).range_m) == there).all()


def test_what_is_fainter_than_the_noise_is_no_surface(make_echo: Any) -> None:
    echo, limits = make_echo(), RangeLimits(0.5, 10.0, ROW_M)
    bright = PingImage(np.full(echo.intensity.shape, 50, np.float32), echo.bearings_rad, ROW_M)
    levels = np.full(echo.intensity.shape, -30, np.float32)
    for level_db, there in ((-3.0, False), (40.0, True)):
        levels[250:256] = level_db
        returns = first_returns(levels, bright, limits, ScanExtractionConfig())
        assert (np.isfinite(returns.range_m) == there).all()


@pytest.mark.parametrize("level", [0.0, 255.0])
def test_empty_and_full_images_have_no_returns(make_echo: Any, level: float) -> None:
    echo = make_echo()
    image = np.full(echo.intensity.shape, level, dtype=np.float32)
    assert np.isnan(found(PingImage(image, echo.bearings_rad, ROW_M)).range_m).all()


@pytest.mark.parametrize(("rows", "beams"), [(1, 1), (3, 2), (30, 1)])
def test_tiny_images_are_taken(make_echo: Any, rows: int, beams: int) -> None:
    assert found(make_echo(rows=rows, beams=beams), min_m=0.0).range_m.shape == (beams,)
