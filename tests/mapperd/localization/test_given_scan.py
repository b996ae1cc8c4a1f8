import numpy as np
import pytest

from mapperd.localization.scan import scan_of_ranges


def test_returns_stand_where_they_were_seen() -> None:
    level_T_sonar = np.eye(4)  # noqa: N806 frames are named
    level_T_sonar[:3, 3] = 0.5, 0.0, -0.2
    bearing = [-np.pi / 2, 0.0, 0.1, np.pi / 2]
    scan = scan_of_ranges(7, bearing, [2.0, 3.0, np.nan, 4.0], level_T_sonar)
    expected = [[0.5, 2.0, -0.2], [3.5, 0.0, -0.2], [0.5, -4.0, -0.2]]
    np.testing.assert_allclose(scan.points_m, expected, atol=1e-12)
    assert (scan.stamp_ns, scan.max_range_m) == (7, 4.0)
    assert scan.beam.tolist() == [0, 1, 3]
    assert scan.misses_bearing_rad.tolist() == [0.1]
    assert scan.quality.tolist() == [1.0, 1.0, 1.0]


def test_what_is_no_range_is_no_return() -> None:
    scan = scan_of_ranges(0, [0.0, 0.1, 0.2, 0.3], [0.0, -1.0, np.inf, np.nan], quality=0.5)
    assert (len(scan), scan.max_range_m) == (0, 0.0)
    assert len(scan_of_ranges(0, [], [])) == 0


def test_a_quality_lies_within_0_and_1() -> None:
    assert scan_of_ranges(0, [0.0, 0.1], [1.0, 1.0], quality=[10.0, -1.0]).quality.tolist() == [
        1,
        0,
    ]


@pytest.mark.parametrize(("bearing", "ranges"), [([0.0], [1.0, 2.0]), ([np.nan], [1.0])])
def test_what_is_no_scan_is_refused(bearing: list[float], ranges: list[float]) -> None:
    with pytest.raises(ValueError, match="as many ranges as bearings"):
        scan_of_ranges(0, bearing, ranges)
