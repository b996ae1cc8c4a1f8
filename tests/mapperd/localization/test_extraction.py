import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.geometry.frames import rigid_transform, rotation_from_rpy
from mapperd.imaging.ping_image import PingImage, ping_image_of
from mapperd.localization.extraction import BurstWatch, ScanContext, scan_of
from mapperd.localization.scan import Scan
from oculus_driver import Ping, StreamParser, decode_ping

if TYPE_CHECKING:
    from numpy.typing import NDArray

WALL = (6.01, 120, 0, 127)


def scan(echo: Any, text: str = "{}", **around: Any) -> Scan:
    known = ScanContext(7, around.pop("level_T_sonar", np.eye(4)), **around)
    found = scan_of(echo, known, config_from_text(text))
    assert isinstance(found, Scan)
    return found


def test_every_beam_is_a_return_or_a_miss(make_echo: Any) -> None:
    echo = make_echo((6.01, 120, 30, 90))
    found = scan(echo)
    assert len(found) + len(found.misses_bearing_rad) == 128
    assert set(found.bearing_rad) | set(found.misses_bearing_rad) == set(echo.bearings_rad)
    assert found.bearing_rad.tolist() == echo.bearings_rad[found.beam].tolist()
    assert (found.stamp_ns, found.max_range_m) == (7, 10.0)


def test_returns_are_placed_with_mounting_and_attitude_taken_out(make_echo: Any) -> None:
    level_T_sonar = rigid_transform((0.3, 0, -0.2), rotation_from_rpy(5, 20, 0))  # noqa: N806
    found = scan(make_echo(WALL), level_T_sonar=level_T_sonar)
    back = (found.points_m - level_T_sonar[:3, 3]) @ level_T_sonar[:3, :3]
    assert np.linalg.norm(back, axis=1) == pytest.approx(found.range_m)
    assert back[:, 2] == pytest.approx(np.zeros(len(found)), abs=1e-12)
    assert np.arctan2(-back[:, 1], back[:, 0]) == pytest.approx(found.bearing_rad)


def test_limits_are_the_narrowest_of_the_settings(make_echo: Any) -> None:
    echo = make_echo((2.01, 120, 0, 127), WALL)
    assert np.median(scan(echo).range_m) == pytest.approx(2.01, abs=0.02)
    assert np.median(scan(echo, "filtering: {min_range: 4}").range_m) > 5
    assert np.median(scan(echo, "amcl: {laser_min_range: 4}").range_m) > 5
    near = scan(echo, "amcl: {laser_max_range: 5, laser_min_range: 3}")
    assert (len(near), near.max_range_m) == (0, 5)


def test_a_surface_that_rises_beyond_the_largest_range_is_invalid(make_echo: Any) -> None:
    echo = make_echo()
    image = echo.intensity.copy()
    image[246:250] += 40
    image[250:256] += 210
    rising = PingImage(np.minimum(image, 255), echo.bearings_rad, echo.range_resolution_m)
    assert np.median(scan(rising).range_m) > 5.0
    assert len(scan(rising, "amcl: {laser_max_range: 5}")) == 0


def test_quality_grows_with_the_echo_within_0_and_1(make_echo: Any) -> None:
    weak, strong = (scan(make_echo((6.01, level, 0, 127))).quality for level in (40, 240))
    assert 0 < weak.min() < weak.mean() < strong.mean() < strong.max() < 1


@pytest.mark.parametrize(("gate", "share"), [("weigh", 0.3), ("drop", None), ("off", 1.0)])
def test_returns_from_where_the_floor_may_be_count_less(
    make_echo: Any, gate: str, share: float | None
) -> None:
    echo, text = make_echo(WALL), f"localization: {{scan: {{floor_gate: {gate}}}}}"
    clear, low = (scan(echo, text, height_m=height) for height in (3.0, 0.9))
    if share is None:
        assert (len(clear), len(low)) == (128, 0)
        assert len(low.misses_bearing_rad) == 0
    else:
        assert low.quality == pytest.approx(share * clear.quality)


def test_burst_is_no_scan(make_echo: Any) -> None:
    watch, config = BurstWatch(1.0, 0.1), Config()
    wall, burst = make_echo(WALL), make_echo((3.0, 120, 0, 127))
    results = [
        scan_of(echo, ScanContext(k * 10**8, np.eye(4)), config, watch)
        for k, echo in enumerate((wall, wall, burst, wall))
    ]
    assert [isinstance(one, Scan) for one in results] == [True, True, False, True]
    assert isinstance(results[2], Reject)
    assert results[2].reason == "burst"


def test_scan_of_an_empty_image_is_empty(make_echo: Any) -> None:
    found = scan(make_echo(noise=0.0))
    assert (len(found), found.points_m.shape, len(found.misses_bearing_rad)) == (0, (0, 3), 128)


def test_equal_pings_give_equal_scans(make_echo: Any) -> None:
    one, two = (scan(make_echo(WALL, noise=10.0)) for _ in range(2))
    assert one.points_m.tobytes() == two.points_m.tobytes()


def test_real_pings_of_a_still_sonar_give_nearly_one_scan(shared_data: Path) -> None:
    data = (shared_data / "oculus" / "three_pings_8bit.raw").read_bytes()
    ranges: list[NDArray[np.float64]] = []
    watch = BurstWatch(1.0, math.radians(30))
    for message in StreamParser().feed(data, arrival_ns=0):
        ping = decode_ping(message)
        assert isinstance(ping, Ping)
        around = ScanContext(len(ranges) * 10**8, np.eye(4))
        found = scan_of(ping_image_of(ping, Config().sonar), around, Config(), watch)
        assert isinstance(found, Scan)
        assert len(found) > 0.95 * ping.beams
        row = np.full(ping.beams, np.nan)
        row[found.beam] = found.range_m
        ranges.append(row)
    assert len(ranges) == 3
    off = np.abs(np.diff(ranges, axis=0))
    # A rough floor seen at a grazing angle: speckle chooses where its front begins.
    assert np.nanmedian(off) < 0.1
    assert np.nanmedian(ranges[0]) == pytest.approx(0.8, abs=0.15)
