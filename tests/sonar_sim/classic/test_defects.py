import math
from pathlib import Path

import pytest
from sonar_sim.classic.defects import Defect, defect_table, defects

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reports" / "simulator-classic.md"


@pytest.fixture(scope="module")
def measured() -> dict[int, Defect]:
    return {found.number: found for found in defects()}


@pytest.mark.parametrize(
    ("number", "expected", "tolerance"),
    [
        (1, (10.0, 0.4446, 0.9904), 2e-3),
        (2, (199.0, 199.0, 199.0, 0.0), 0.0),
        (4, (0.0, 12.25, 8.9), 0.05),
        (5, (0.155, 0.038), 5e-4),
        (6, (1900.0, 56.0, 0.0), 0.0),
        (7, (0.011, 0.077), 5e-4),
        (8, (2.0,), 0.1),
        (10, (4.0, 1.0), 0.0),
        (11, (0.1,), 1e-3),
        (12, (254.0, 204.0), 0.0),
        (13, (0.5,), 0.01),
        (14, (5.0,), 0.0),
        (15, (0.0, 15.0), 0.0),
        (17, (-1.0 / 389.08 * 180.0 / math.pi,), 1e-3),
    ],
)
def test_the_defect_is_as_measured(
    measured: dict[int, Defect], number: int, expected: tuple[float, ...], tolerance: float
) -> None:
    assert measured[number].numbers == pytest.approx(expected, abs=tolerance)


def test_a_plane_across_the_view_is_lost_whole(measured: dict[int, Defect]) -> None:
    assert measured[3].numbers[0] == 1.0


def test_a_ball_changes_the_level_of_the_wall_beside_it(measured: dict[int, Defect]) -> None:
    _, alone, beside = measured[3].numbers
    assert alone - beside > 0.2


def test_empty_water_is_grey(measured: dict[int, Defect]) -> None:
    grey, share = measured[9].numbers
    assert grey == pytest.approx(0.2)
    assert 0.4 < share < 0.6


def test_infinite_depths_lose_echoes(measured: dict[int, Defect]) -> None:
    assert measured[16].numbers[0] > 0.1


def test_every_defect_has_its_number() -> None:
    assert [found.number for found in defects()] == list(range(1, 18))


def test_the_page_shows_the_table() -> None:
    assert "\n".join(defect_table()) in PAGE.read_text(encoding="utf-8")
