"""Scans of simulated pings lie on the true first surfaces."""

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest
from studies import scan_truth
from studies.scan_picture import draw_scan
from studies.scan_truth import PLACES, JudgedScan, look

if TYPE_CHECKING:
    from sonar_sim.propagation.ground_truth import Truth

pytestmark = pytest.mark.slow

PINGS = 6


@pytest.fixture(scope="module", params=PLACES, ids=lambda place: place.scene)
def looks(request: pytest.FixtureRequest) -> tuple[str, list[JudgedScan]]:
    return request.param.scene, look(request.param, PINGS, seed=5)


MIN_TRUE = {"harbour": 0.7, "tank": 0.8}
"""Of the returns before floor and surface: what six pings give, less a tenth."""


def test_most_returns_are_within_a_cell_of_the_first_surface(
    looks: tuple[str, list[JudgedScan]],
) -> None:
    scene, made = looks
    true = np.concatenate([one.true[one.sure] for one in made])
    assert len(true) > 500
    assert true.mean() > MIN_TRUE[scene]


def test_most_surfaces_that_beams_look_at_are_found(looks: tuple[str, list[JudgedScan]]) -> None:
    _, made = looks
    assert sum(int((one.true & one.sure).sum()) for one in made) > 0.6 * sum(
        one.seen for one in made
    )


def test_report_names_place_and_shares(looks: tuple[str, list[JudgedScan]]) -> None:
    scene, made = looks
    place = next(place for place in PLACES if place.scene == scene)
    assert scan_truth.report(place, made).startswith(f"{scene}: {PINGS} pings, ")


def test_truth_is_the_first_surface_of_the_beam_s_directions() -> None:
    bearing = np.radians([-1.0, 0.0, 0.0, 2.0])
    direction = np.stack([np.cos(bearing), -np.sin(bearing), np.zeros(4)], axis=1)
    truth = SimpleNamespace(ray_direction=direction, ray_range_m=np.array([5.0, 9.0, 7.0, 3.0]))
    beams = np.radians([-1.0, 0.1, 20.0])
    found = scan_truth.first_surfaces_m(cast("Truth", truth), beams, np.radians(0.5))
    assert [sorted(set(row[np.isfinite(row)])) for row in found] == [[5.0], [7.0], []]


def test_picture_shows_every_return(looks: tuple[str, list[JudgedScan]]) -> None:
    _, made = looks
    plain = draw_scan(made[0].image, made[0].scan)
    judged = draw_scan(made[0].image, made[0].scan, np.zeros(len(made[0].scan), dtype=np.bool_))
    assert plain.shape == judged.shape == (760, 1200, 3)
    red = (judged == (70, 70, 255)).all(axis=2)
    assert red.sum() >= 5
    assert not (plain == (70, 70, 255)).all(axis=2).any()
