"""Files of position fixes: columns, frames and what is refused."""

import math
from pathlib import Path

import pytest

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.odometry.trajectory_files import FixFile
from oculus_driver.errors import RecordingError

ORIGIN = config_of({"odometry": {"origin": {"latitude": 54.0, "longitude": 10.0}}}, "")


def read(folder: Path, text: str, config: Config | None = None) -> tuple[tuple[float, ...], ...]:
    path = folder / "fixes.csv"
    path.write_text(text)
    return FixFile(path).fixes(config or Config())


def test_metres_and_deviation(tmp_path: Path) -> None:
    found = read(tmp_path, "time_s,x_m,y_m,deviation_m\n100.5,3,-4,0.2\n90,1,2,1.5\n")
    assert found == ((100_500_000_000, 3.0, -4.0, 0.2), (90_000_000_000, 1.0, 2.0, 1.5))


def test_other_names_separators_and_the_default_deviation(tmp_path: Path) -> None:
    [fix] = read(tmp_path, "north_m;east_m;note;timestamp_ns\n7;5;GPS;12\n")
    assert fix[:3] == (12, 5.0, 7.0)
    assert fix[3] > 0


def test_geographic_positions_are_east_and_north_of_the_origin(tmp_path: Path) -> None:
    text = "time,latitude_deg,longitude_deg,deviation_m\n1,54.001,10.002,2\n"
    [(_, x_m, y_m, _)] = read(tmp_path, text, ORIGIN)
    # Radii of curvature of WGS-84 at 54 degrees: 6377.3 km (meridian), 6392.2 km (prime vertical).
    assert y_m == pytest.approx(math.radians(0.001) * 6_377_300, abs=0.1)
    across_m = math.radians(0.002) * 6_392_200 * math.cos(math.radians(54.0005))
    assert x_m == pytest.approx(across_m, abs=0.1)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("time_s,x_m\n1,2\n", "position"),
        ("x_m,y_m\n1,2\n", "time"),
        ("time_s,x_m,y_m\n", "no position fix"),
        ("time_s,x_m,y_m\n1,2\n", "line 2"),
        ("time_s,x_m,y_m\n1,2,east\n", "not a number"),
        ("time_s,x_m,y_m\n1,2,nan\n", "line 2"),
        ("time_s,x_m,y_m,deviation_m\n1,2,3,0\n", "deviation_m"),
        ("time_s,x_m,y_m,deviation_m\n1,2,3,nan\n", "deviation_m"),
        ("time_s,latitude_deg,longitude_deg\n1,54,10\n", "odometry.origin"),
    ],
)
def test_what_is_refused_names_file_and_place(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(RecordingError, match=problem) as caught:
        read(tmp_path, text)
    assert "fixes.csv" in str(caught.value)


def test_a_place_that_is_not_on_earth_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="line 2"):
        read(tmp_path, "time_s,latitude_deg,longitude_deg\n1,154,10\n", ORIGIN)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"none\.csv"):
        FixFile(tmp_path / "none.csv").fixes(Config())
