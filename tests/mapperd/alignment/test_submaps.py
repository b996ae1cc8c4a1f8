"""Submaps: what of a ping they keep."""

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.alignment.submaps import FIRST_ONLY_M, front_of_returns
from mapperd.imaging.ping_image import PingImage

EDGE_M = 0.1
THRESHOLD = 50.0
MIN_RANGE_M = 0.5


def image_of(beams: dict[int, list[tuple[int, int]]], rows: int) -> PingImage:
    """Returns of 100 from and to a row, in each beam."""
    intensity = np.full((rows, 4), 20.0, dtype=np.float32)
    for beam, spans in beams.items():
        for begin, end in spans:
            intensity[begin:end, beam] = 100.0
    return PingImage(intensity, np.linspace(-0.5, 0.5, 4), EDGE_M)


def rows_kept(image: PingImage, beam: int, depth_m: float = 0.35) -> NDArray[np.intp]:
    kept = front_of_returns(image, THRESHOLD, MIN_RANGE_M, depth_m).intensity
    return np.flatnonzero(kept[:, beam] > THRESHOLD)


LONG = int(FIRST_ONLY_M / EDGE_M) + 50
SHORT = int(FIRST_ONLY_M / EDGE_M) - 50


def test_the_front_of_each_return_is_kept() -> None:
    image = image_of({1: [(20, 40), (60, 62)], 2: [(5, 10)]}, LONG)
    assert rows_kept(image, 0).tolist() == []
    assert rows_kept(image, 1).tolist() == [20, 21, 22, 23, 60, 61]
    assert rows_kept(image, 2).tolist() == [5, 6, 7, 8]


def test_speckle_does_not_divide_a_return() -> None:
    spans = [(k, k + 1) for k in range(20, 80, 3)]  # gaps of 0.2 m
    assert rows_kept(image_of({0: spans}, LONG), 0).tolist() == [20, 23]


def test_at_short_range_only_the_first_return_is_kept() -> None:
    image = image_of({1: [(20, 40), (60, 62)]}, SHORT)
    assert rows_kept(image, 1).tolist() == [20, 21, 22, 23]
    assert rows_kept(image, 0).tolist() == []


@pytest.mark.parametrize("rows", [SHORT, LONG])
def test_no_other_sample_becomes_a_return_and_the_ping_stays(rows: int) -> None:
    # Free space ends at the first return.
    image = image_of({1: [(20, 40)]}, rows)
    kept = front_of_returns(image, THRESHOLD, MIN_RANGE_M, 0.3).intensity
    assert kept.dtype == np.float32
    assert (kept[kept > THRESHOLD] == image.intensity[kept > THRESHOLD]).all()
    assert (kept[:20] <= THRESHOLD).all()
    assert (image.intensity[20:40, 1] == 100.0).all()


@pytest.mark.parametrize("rows", [SHORT, LONG])
def test_the_ringing_of_the_transmitter_hides_nothing(rows: int) -> None:
    image = image_of({1: [(0, 3), (20, 40)]}, rows)
    assert [row for row in rows_kept(image, 1) if row > 3] == [20, 21, 22, 23]
