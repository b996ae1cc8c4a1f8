"""Neighbouring rays: the kernels against the plain definition."""

import numpy as np
import pytest
from sonar_sim import _core

RNG = np.random.default_rng(5)
COLUMN = np.repeat(np.arange(3, dtype=np.int32), [4, 5, 3])
UP = np.concatenate([[-0.2, -0.1, 0.1, 0.2], [-0.3, -0.2, -0.1, 0.15, 0.2], [-0.2, 0.1, 0.2]])
RANGE_M = RNG.uniform(1.0, 9.0, len(COLUMN)).astype(np.float32)
FACE = RNG.integers(-1, 4, len(COLUMN)).astype(np.int32)
SURFACE = np.array([0, 0, 1, 1], dtype=np.int32)
SIZE_M = np.array([0.1, 0.2, 0.3, 9.9], dtype=np.float32)


def beside(ray: int) -> int | None:
    """The next column's ray as high as this one, or the first above it."""
    found = np.flatnonzero((COLUMN[ray] + 1 == COLUMN) & (UP[ray] - 1e-6 <= UP))
    return int(found[0]) if len(found) else None


def test_spans_take_in_neighbours_on_the_same_surface() -> None:
    pairs = [(i, i + 1) for i in range(len(COLUMN) - 1) if COLUMN[i] == COLUMN[i + 1]]
    pairs += [(i, b) for i in range(len(COLUMN)) if (b := beside(i)) is not None]
    got = _core.spans(RANGE_M, FACE, COLUMN, UP.astype(np.float32), SURFACE, SIZE_M)
    for ray in np.flatnonzero(FACE >= 0):
        others = [b if a == ray else a for a, b in pairs if ray in (a, b)]
        met = [RANGE_M[ray]]
        met += [
            RANGE_M[i] for i in others if FACE[i] >= 0 and SURFACE[FACE[i]] == SURFACE[FACE[ray]]
        ]
        size = SIZE_M[FACE[ray]]
        assert got[ray, 0] == max(min(*met, RANGE_M[ray] - size), 0.0)
        assert got[ray, 1] == max(*met, RANGE_M[ray] + size)


NORMALS = np.array([[0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 0.2, 0.98]], dtype=np.float32)
FLAT = np.full(4, -1, dtype=np.int32)
ROUND = np.zeros(4, dtype=np.int32)


def edges_of(
    face: list[int],
    group: list[int] | None = None,
    column: list[int] | None = None,
    smooth: np.ndarray = FLAT,
    standing: int = 0,
) -> list[int]:
    """Edges among rays that end on the plane z = -1, side by side."""
    count = len(face)
    across = np.linspace(1.0, 2.0, count)
    point = np.stack([across, np.zeros(count), -np.ones(count)], axis=1)
    range_m = np.linalg.norm(point, axis=1)
    found = _core.edges(
        (point / range_m[:, None]).astype(np.float32),
        range_m.astype(np.float32),
        np.array(face, dtype=np.int32),
        np.array(group or [0] * count, dtype=np.int32),
        standing,
        np.array(column or [0] * count, dtype=np.int32),
        NORMALS,
        smooth,
        0.15,
        0.02,
        0.995,
    )
    return [int(ray) for ray in found]


def test_faces_of_one_plane_have_no_edge_and_nothing_beside_something_has() -> None:
    assert edges_of([0, 1, 0, 1]) == []
    assert edges_of([0, -1, -1, 1]) == [0, 2]


def test_neighbours_of_another_column_or_owner_are_distinguished() -> None:
    assert edges_of([0, -1, 0, 0], column=[0, 1, 1, 1]) == [1]
    assert edges_of([0, 0, 2, 2], group=[0, 1, 1, 0]) == [0, 2]


def test_normals_of_a_moving_object_are_not_compared() -> None:
    assert edges_of([0, 3, 3], smooth=ROUND) == [0]
    assert edges_of([0, 3, 3], smooth=ROUND, standing=-1) == []


def test_a_round_surface_has_an_edge_where_its_normal_turns() -> None:
    assert edges_of([0, 3, 3]) == []
    assert edges_of([0, 3, 3], smooth=ROUND) == [0]


def test_a_step_off_the_plane_is_an_edge() -> None:
    # Both rays fall straight down: the second one lands below the first one's plane.
    direction = np.array([[0, 0, -1], [0, 0, -1]], dtype=np.float32)
    nothing = np.zeros(2, dtype=np.int32)
    for gap_m, edge in ((0.02, []), (0.5, [0])):
        got = _core.edges(
            direction,
            np.array([1.0, 1.0 + gap_m], dtype=np.float32),
            np.array([0, 1], dtype=np.int32),
            nothing,
            0,
            nothing,
            NORMALS,
            FLAT,
            0.15,
            0.02,
            0.995,
        )
        assert got.tolist() == edge


def test_faces_out_of_the_table_are_refused() -> None:
    with pytest.raises(ValueError, match="face out of the table"):
        _core.spans(RANGE_M, FACE, COLUMN, UP.astype(np.float32), SURFACE[:2], SIZE_M[:2])
