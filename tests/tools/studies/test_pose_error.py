"""The surfaces of a moving dive: odometry's poses are nearly as good as true ones."""

from pathlib import Path

import numpy as np
import pytest
from studies.pose_error import (
    START_NS,
    TARGET,
    CircularDive,
    by_odometry,
    by_truth,
    pings_of,
    rms,
    table,
)
from studies.report import write_section


@pytest.fixture(scope="module")
def dive() -> CircularDive:
    return CircularDive(seconds=9.0, ping_hz=2.0, posts=40, rows=300, voxel_m=0.07)


@pytest.fixture(scope="module")
def perfect_m(dive: CircularDive) -> float:
    return rms(dive.errors_m(by_truth(dive, dive.config())))


def test_odometry_with_jitter_and_drift_is_as_good_as_asked(
    dive: CircularDive, perfect_m: float
) -> None:
    found_m = rms(dive.errors_m(by_odometry(dive, dive.config())))
    assert found_m <= TARGET * perfect_m
    rigid_m = rms(dive.errors_m(by_odometry(dive, dive.config(motion=False))))
    assert rigid_m > 1.3 * found_m


@pytest.mark.parametrize("policy", ["nearest", "latest"])
def test_other_policies_are_worse(dive: CircularDive, perfect_m: float, policy: str) -> None:
    found_m = rms(dive.errors_m(by_odometry(dive, dive.config(policy))))
    assert found_m > 1.1 * perfect_m


def test_arrivals_alone_would_not_do(dive: CircularDive, perfect_m: float) -> None:
    found_m = rms(dive.errors_m(by_odometry(dive, dive.config(), stamped=False)))
    assert found_m > TARGET * perfect_m


def test_image_of_a_slow_vehicle_is_where_the_posts_are() -> None:
    still = CircularDive(speed_mps=1e-6, rate_dps=1e-5, seconds=2.0, posts=5, rows=3000, beams=4096)
    ping = pings_of(still, still.ping(0), START_NS)
    row, beam = np.nonzero(ping.image)
    place_m = still.base_T_sonar[:2, 3]
    bearing = np.radians(30.0) - ping.bearings_rad[beam]
    heard_m = place_m + ping.ranges_m[row, None] * np.column_stack(
        [np.cos(bearing), np.sin(bearing)]
    )
    off_m = np.linalg.norm(heard_m[:, None] - still.axes_m, axis=2).min(axis=1)
    assert off_m == pytest.approx(0.15, abs=0.02)


def test_table_stands_between_its_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- mine: begin, written by me -->\nold\n<!-- mine: end -->\nb\n")
    write_section(page, "mine", table({"true": np.array([0.1]), "found": np.array([0.2])}))
    text = page.read_text()
    assert "| found | 200 mm | 2.00 | 200 mm | 200 mm |" in text
    assert "old" not in text
    assert text.endswith("<!-- mine: end -->\nb\n")
    with pytest.raises(ValueError, match="no section"):
        write_section(page, "yours", "")
