"""Submaps: what of a ping they keep."""

from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.alignment import submaps
from mapperd.alignment.submaps import (
    FIRST_RETURN_MAX_RANGE_M,
    MIN_RESOLUTION_M,
    SHORT_RANGE_M,
    SHORT_RESOLUTION_M,
    _HeldPing,
    _lifted_submap,
    _SubmapMapper,
    front_of_returns,
    matrix_of,
)
from mapperd.config.tree import Config
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap, Voxels

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


LONG = int(FIRST_RETURN_MAX_RANGE_M / EDGE_M) + 50
SHORT = int(FIRST_RETURN_MAX_RANGE_M / EDGE_M) - 50


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
    assert rows_kept(image, 1).tolist() == [20, 21, 22, 23]


@pytest.mark.parametrize("rows", [SHORT, LONG])
def test_nothing_is_kept_before_a_return(rows: int) -> None:
    image = image_of({1: [(20, 40)]}, rows)
    kept = front_of_returns(image, THRESHOLD, MIN_RANGE_M, 0.35).intensity
    assert np.flatnonzero(kept[:, 1]).tolist() == [20, 21, 22, 23]
    assert not kept[:, [0, 2, 3]].any()


def held_pings(
    heading: float, pings: int, range_m: float, growth_m: float = 0.0
) -> list[_HeldPing]:
    """Pings at one place, at a speed along a heading of the map that displaces what they see."""
    intensity = np.full((round(range_m / EDGE_M), 64), 20.0, dtype=np.float32)
    intensity[60:64] = 200.0
    image = PingImage(intensity, np.linspace(-0.5, 0.5, 64), EDGE_M)
    start = np.array([3.0, -2.0, heading])
    motion = PingMotion(30.0 * matrix_of(start)[:3, 0], np.zeros(3), 0.0, 1500.0)
    return [
        _HeldPing(image, matrix_of(start), motion, k * 10**8, start, 0, k * growth_m)
        for k in range(pings)
    ]


def mapper_of(
    heading: float, pings: int = 9, range_m: float = 11.0, growth_m: float = 0.0
) -> _SubmapMapper:
    mapper = _SubmapMapper(Config(), None)
    mapper._held = held_pings(heading, pings, range_m, growth_m)
    mapper.finish()
    return mapper


@pytest.mark.parametrize("heading", [1.5707963267948966, 3.141592653589793])
def test_a_submap_does_not_depend_on_the_heading_of_its_dive(heading: float) -> None:
    [east], [turned] = mapper_of(0.0).submaps, mapper_of(heading).submaps
    ours, theirs = ({tuple(voxel) for voxel in one.occupied.tolist()} for one in (east, turned))
    assert len(ours) > 20
    # Rounding moves voxels that lie on an edge.
    assert len(ours ^ theirs) < 0.1 * len(ours)


def test_fragments_are_thirds_of_a_submap() -> None:
    mapper = mapper_of(0.0)
    assert [one.pings for one in mapper.fragments] == [3, 3, 3]
    assert [one.anchor_ns for one in mapper.fragments] == [10**8, 4 * 10**8, 7 * 10**8]
    assert mapper.submaps[0].anchor_ns == 4 * 10**8
    assert [len(mapper_of(0.0, pings).fragments) for pings in (3, 8)] == [0, 2]


@pytest.mark.parametrize(("pings", "pieces"), [(48, [6] * 8), (24, [3] * 8), (9, [3] * 3), (2, [])])
def test_fragments_are_shorter_in_an_outage(pings: int, pieces: list[int]) -> None:
    mapper = mapper_of(0.0, pings, growth_m=0.1)
    assert [one.pings for one in mapper.fragments] == pieces


def test_voxels_are_finer_at_short_range() -> None:
    short, long = (mapper_of(0.0, range_m=range_m) for range_m in (8.0, SHORT_RANGE_M + 1.0))
    for mapper, edge_m in ((short, SHORT_RESOLUTION_M), (long, MIN_RESOLUTION_M)):
        [submap] = mapper.submaps
        assert {submap.resolution_m, *(f.resolution_m for f in mapper.fragments)} == {edge_m}
        far_m = np.linalg.norm((submap.occupied[:, :2] + 0.5) * edge_m, axis=1).max()
        assert far_m == pytest.approx(6.3 + 0.2, abs=0.4)  # the return, 0.2 m of speed


@pytest.mark.parametrize("range_m", [8.0, SHORT_RANGE_M + 1.0])
def test_voxels_of_long_range_count_by_their_log_odds(
    range_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = SonarMap.voxels
    of_map: list[Voxels] = []
    built: list[Any] = []

    def recorded(self: SonarMap, kind: Literal["occupied", "free"]) -> Voxels:
        voxels = read(self, kind)
        if kind == "occupied":
            of_map.append(voxels)
        return voxels

    monkeypatch.setattr(SonarMap, "voxels", recorded)
    monkeypatch.setattr(submaps, "Submap", lambda *arguments: built.append(arguments))
    mapper = _SubmapMapper(Config(), None)
    mapper._held = held_pings(0.0, 3, range_m)
    mapper._held[0].image.intensity[60:64] = np.linspace(120.0, 250.0, 64)  # shared by all
    mapper.finish()
    [submap] = mapper.submaps
    submap.build()
    (occupied_m, _, edge_m, weights), whole = built[0], of_map[0]
    assert occupied_m == pytest.approx(whole.centres_m, abs=1e-6)
    assert edge_m == submap.resolution_m
    probability = whole.probability.astype(np.float64)
    log_odds = np.log(probability / (1.0 - probability))
    assert np.ptp(log_odds) > 0.1
    is_short = range_m < SHORT_RANGE_M
    expected = np.ones_like(log_odds) if is_short else np.clip(log_odds, 0.0801, 9.2102)
    assert weights == pytest.approx(expected, rel=1e-3)


def test_a_submap_ends_where_the_size_of_its_voxels_changes() -> None:
    mapper = _SubmapMapper(Config(), None)
    [first, same, longer] = (
        held_pings(0.0, 1, range_m)[0] for range_m in (8.0, 9.0, SHORT_RANGE_M + 1.0)
    )
    mapper._held = [first]
    assert not mapper._ends_before(same)
    assert mapper._ends_before(longer)


def test_submaps_are_lifted_alike_whatever_their_voxels() -> None:
    places_m = []
    for range_m in (8.0, SHORT_RANGE_M + 1.0):
        [submap] = mapper_of(0.0, range_m=range_m).submaps
        lifted = _lifted_submap(submap, 0.3)
        assert (lifted.occupied[:, :2] == submap.occupied[:, :2]).all()
        up_m = (lifted.occupied[:, 2] - submap.occupied[:, 2]) * submap.resolution_m
        assert (lifted.free[:, 2] - submap.free[:, 2] == up_m[0] / submap.resolution_m).all()
        places_m.append(float(up_m[0]))
    assert places_m[0] == pytest.approx(places_m[1])
    assert places_m[0] == pytest.approx(0.3, abs=0.101)
