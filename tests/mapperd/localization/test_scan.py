import re
from pathlib import Path

import numpy as np
import pytest

from mapperd.localization.scan import Scan, decimated, decimation


def scan_of(count: int) -> Scan:
    numbers = np.arange(float(count))
    points = np.stack([numbers, numbers, numbers], axis=1)
    beam = np.arange(count)
    return Scan(
        1, numbers, numbers, points, numbers / max(count, 1), beam, np.ones(3), 9, np.eye(4)
    )


@pytest.mark.parametrize(
    ("count", "most", "values"),
    [
        (4, 0, []),
        (4, 1, [1]),
        (4, 10, [1, 2, 3, 4]),
        (5, 3, [1, 3, 5]),
        (9, 3, [1, 5, 9]),
        (10, 6, [1, 3, 5, 7, 9, 10]),
        (0, 3, []),
    ],
    ids=["T1", "one", "T3", "T5", "T7", "T9", "none"],
)
def test_evenly_spaced_as_published(count: int, most: int, values: list[int]) -> None:
    assert (decimation(count, most) + 1).tolist() == values


def test_evenly_spaced_as_recorded(shared_data: Path) -> None:
    recorded = np.load(shared_data / "amcl" / "agreement.npz")
    names = [name for name in recorded.files if name.startswith("take_evenly")]
    assert names
    for name in names:
        count, most = map(int, re.findall(r"\d+", name))
        assert decimation(count, most).tolist() == recorded[name].tolist(), name


def test_decimated_scan_keeps_rows_together() -> None:
    scan = decimated(scan_of(10), 4)
    assert scan.range_m.tolist() == [0, 3, 6, 9]
    assert scan.beam.tolist() == [0, 3, 6, 9]
    assert scan.points_m[:, 2].tolist() == scan.bearing_rad.tolist() == [0, 3, 6, 9]
    assert len(scan) == 4
    assert len(scan.misses_bearing_rad) == 3


def test_scan_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        scan_of(3).range_m[0] = 7
