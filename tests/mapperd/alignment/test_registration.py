"""Registration of submaps against known displacements, and what it must not claim."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd import _core
from mapperd.alignment import registration
from mapperd.alignment.registration import (
    LoopFinder,
    Pair,
    Trial,
    joined_submap,
    register_dives,
    usable_information,
)
from mapperd.alignment.submaps import SonarSubmap
from mapperd.errors import ReplayError

Floats = NDArray[np.float64]

EDGE_M = 0.2


def scene(kind: str = "room") -> Floats:
    """Points of surfaces, dense."""
    rng = np.random.default_rng(5)
    z = rng.uniform(-2, 0, 6000)
    along = rng.uniform(-6, 6, 6000)
    if kind == "wall":
        return np.column_stack([2 * along, np.full_like(along, 4.0), z])
    wall = np.column_stack([along, np.full_like(along, 4.0), z])
    side = np.column_stack([np.full_like(along, -5.0), along * 0.6, z])
    angle = rng.uniform(0, 2 * math.pi, 3000)
    pillars = [
        np.column_stack([x + 0.5 * np.cos(angle), y + 0.5 * np.sin(angle), z[:3000]])
        for x, y in ((1.0, 0.5), (3.5, -2.5), (-2.0, -1.5))
    ]
    return np.vstack([wall, side, *pillars])


def voxels_of(points: Floats, frame: Floats) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Occupied and free voxels in a frame at (x, y, yaw); all else around is free."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    moved = points - [frame[0], frame[1], 0.0]
    local = np.column_stack([c * moved[:, 0] + s * moved[:, 1], -s * moved[:, 0] + c * moved[:, 1]])
    voxels = np.floor(np.column_stack([local, points[:, 2]]) / EDGE_M).astype(int)
    occupied = np.unique(voxels, axis=0)
    low, high = occupied.min(axis=0) - [0, 2, 0], occupied.max(axis=0) + 1
    grid = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), -1).reshape(-1, 3)
    solid = set(map(tuple, occupied.tolist()))
    free = np.array([v for v in grid if tuple(v.tolist()) not in solid])
    return occupied.astype(np.int32), free.astype(np.int32)


def submap(points: Floats, frame: Floats) -> _core.Submap:
    """The submap of these voxels."""
    occupied, free = voxels_of(points, frame)
    solid, empty = (np.asarray(v + 0.5, dtype=np.float64) * EDGE_M for v in (occupied, free))
    return _core.Submap(solid, empty, EDGE_M)


def sonar_submap(
    occupied: NDArray[np.int32],
    free: NDArray[np.int32] | None = None,
    *,
    anchor: Floats | None = None,
    at_ns: int = 0,
    weights: Floats | None = None,
) -> SonarSubmap:
    """A submap of nine pings, all at one time; without weights, all voxels count alike."""
    return SonarSubmap(
        begin_ns=at_ns,
        anchor_ns=at_ns,
        end_ns=at_ns,
        anchor=np.zeros(3) if anchor is None else anchor,
        segment=0,
        pings=9,
        occupied=occupied,
        free=occupied[:0] if free is None else free,
        weights=np.ones(len(occupied)) if weights is None else weights,
        resolution_m=EDGE_M,
    )


def relative(a: Floats, b: Floats) -> Floats:
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = (b - a)[:2]
    return np.array([c * dx + s * dy, -s * dx + c * dy, b[2] - a[2]])


@pytest.mark.parametrize(
    "start",
    [(0.0, 0.0, 0.0), (0.5, -0.4, 0.05), (-0.6, 0.3, -0.08)],
)
def test_a_known_displacement_is_found(start: tuple[float, float, float]) -> None:
    a, b = np.array([0.3, -0.2, 0.1]), np.array([1.1, 0.6, -0.25])
    true = relative(a, b)
    found = _core.register_submaps(submap(scene(), a), submap(scene(), b), true + np.array(start))
    assert found.converged
    assert np.hypot(*(found.pose - true)[:2]) < 0.05
    assert abs(found.pose[2] - true[2]) < math.radians(0.5)
    assert found.matched > 0.8


@pytest.mark.parametrize(("strong", "off_m"), [(0, 0.0), (1, EDGE_M), (2, 2 * EDGE_M)])
def test_what_is_surely_occupied_counts_most(strong: int, off_m: float) -> None:
    room = voxels_of(scene(), np.zeros(3))[0]
    layers = [room + np.array([k, k, 0], dtype=np.int32) for k in range(3)]
    blurred, layer = np.unique(np.vstack(layers[::-1]), axis=0, return_index=True)
    weight = np.where(layer // len(room) == 2 - strong, 10.0, 0.1)
    source = sonar_submap(blurred, weights=weight).build()
    found = _core.register_submaps(sonar_submap(room).build(), source, np.zeros(3))
    assert found.pose[:2] == pytest.approx((-off_m, -off_m), abs=0.05)


def test_the_search_finds_the_place_in_its_window() -> None:
    a, b = np.zeros(3), np.array([2.0, -1.5, 0.2])
    candidates = _core.search_poses(
        submap(scene(), a),
        submap(scene(), b),
        np.zeros(3),
        half_x_m=3.0,
        half_y_m=3.0,
        half_yaw_rad=0.4,
        step_m=0.4,
        step_yaw_rad=0.05,
        count=3,
    )
    best = candidates[0][0]
    assert np.hypot(*(best - relative(a, b))[:2]) < 0.6
    scores = [score for _, score, _, _ in candidates]
    assert scores == sorted(scores, reverse=True)


def test_free_space_contradicts_and_unknown_space_does_not() -> None:
    whole = submap(scene(), np.zeros(3))
    edge = (np.array([[40.0, 40.0, -1.0], [40.2, 40.0, -1.0]])) + 0.1
    elsewhere = _core.Submap(edge, np.zeros((0, 3)), EDGE_M)
    _, _, _, away = _core.compare_submaps(whole, elsewhere, np.zeros(3), scale_m=0.2, points=100)
    assert away == 0.0
    inside = _core.Submap(edge - np.array([40.0, 40.0, 0.0]), np.zeros((0, 3)), EDGE_M)
    _, _, _, within = _core.compare_submaps(whole, inside, np.zeros(3), scale_m=0.2, points=100)
    assert within > 0.0


def test_a_wall_leaves_its_own_direction_open() -> None:
    a, b = np.zeros(3), np.array([0.5, 0.3, 0.0])
    wall = scene("wall")
    seen = [submap(wall[np.abs(wall[:, 0] - frame[0]) < 5], frame) for frame in (a, b)]
    found = _core.register_submaps(seen[0], seen[1], relative(a, b))
    information = usable_information(seen[0], seen[1], found)
    across, along = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    assert along @ information @ along < 0.1 * (across @ information @ across)
    assert across @ information @ across > 50


def test_less_overlap_gives_less_information() -> None:
    points, frame = scene(), np.zeros(3)
    whole = submap(points, frame)
    part = submap(points[points[:, 0] > 0.5], frame)
    full, less = (
        usable_information(whole, other, _core.register_submaps(whole, other, frame))
        for other in (whole, part)
    )
    assert np.all(np.diag(less) < 0.7 * np.diag(full))


def test_bad_submaps_are_refused() -> None:
    one = np.zeros((1, 3))
    for occupied, free, edge_m in (
        (np.zeros((0, 3)), one, 0.2),
        (one, one, 0.0),
        (np.full((1, 3), np.nan), one, 0.2),
        (np.array([[0.0, 0.0, 0.0], [1e6, 1e6, 1e6]]), one, 0.2),
        (np.full((1, 3), 1e300), one, 0.2),
    ):
        with pytest.raises(ValueError, match=r"submap|centre|resolution"):
            _core.Submap(occupied, free, edge_m)
    for weights in ([], [1.0, 1.0], [0.0], [-1.0], [np.nan], [np.inf]):
        with pytest.raises(ValueError, match="weight"):
            _core.Submap(one, one, 0.2, np.array(weights))


def test_windows_without_end_are_refused() -> None:
    whole = submap(scene(), np.zeros(3))
    for half_m, step_m in ((math.inf, 0.4), (1.0, 0.0), (1e4, 0.1), (math.nan, 0.4)):
        with pytest.raises(ValueError, match="window"):
            _core.search_poses(
                whole,
                whole,
                np.zeros(3),
                half_x_m=half_m,
                half_y_m=half_m,
                half_yaw_rad=0.1,
                step_m=step_m,
                step_yaw_rad=0.05,
                count=1,
            )


@pytest.mark.parametrize(("off_m", "reason"), [(0.0, None), (0.5, "far_from_prediction")])
def test_what_a_sure_prediction_excludes_is_refused(off_m: float, reason: str | None) -> None:
    frames = np.zeros(3), np.array([0.4, 0.2, 0.1])
    submaps = [
        sonar_submap(*voxels_of(scene(), frame), anchor=frame, at_ns=k)
        for k, frame in enumerate(frames)
    ]
    predicted = relative(*frames) + np.array([off_m, 0.0, 0.0])
    trial = Trial(Pair(0, 1, neighbours=False), predicted, np.diag([1e-4, 1e-4, 1e-4]))
    finder = LoopFinder(submaps, [0, 1])
    found = finder.register([trial])
    assert finder.rejected == ({} if reason is None else {reason: 1})
    assert len(found) == (reason is None)


def pillars_at(*places: tuple[float, float]) -> Floats:
    """Round pillars."""
    angle = np.random.default_rng(6).uniform(0, 2 * math.pi, 2000)
    z = np.random.default_rng(7).uniform(-2, 0, 2000)
    return np.vstack(
        [np.column_stack([x + np.cos(angle), y + np.sin(angle), z]) for x, y in places]
    )


CLUSTER = ((0.0, 0.0), (4.0, 0.5), (1.5, 4.0))


@pytest.mark.parametrize(
    ("site", "refused"),
    [
        (pillars_at(*CLUSTER), None),
        (pillars_at(*CLUSTER, *((x - 7.5, y) for x, y in CLUSTER)), "two places"),
        (scene("wall"), "no other"),
    ],
)
def test_a_dive_is_registered_where_it_fits_at_one_place(site: Floats, refused: str | None) -> None:
    frame = np.array([1.0, -0.8, 0.3])
    found, score = register_dives(submap(site, np.zeros(3)), submap(pillars_at(*CLUSTER), frame))
    assert (score > 0.0) == (refused is None)
    if refused is None:
        assert found == pytest.approx(frame, abs=0.1)
    else:
        assert refused in found


def test_the_submaps_of_a_large_site_are_joined_coarsely(monkeypatch: pytest.MonkeyPatch) -> None:
    pieces = [sonar_submap(voxels_of(scene(), np.zeros(3))[0])]
    poses = np.zeros((1, 3))
    fine = joined_submap(pieces, poses)
    monkeypatch.setattr(registration, "MAX_VOXELS", 50_000)
    coarse = joined_submap(pieces, poses)
    assert fine is not None
    assert coarse is not None
    assert coarse.occupied < fine.occupied / 2
    assert joined_submap([sonar_submap(np.zeros((0, 3), np.int32))], poses) is None


def test_a_submap_that_extends_too_far_is_an_error_that_says_what_to_do() -> None:
    far = sonar_submap(np.array([[0, 0, 0], [10**6, 10**6, 10**6]], np.int32))
    with pytest.raises(ReplayError, match=r"octree\.voxel_resolution"):
        far.build()
