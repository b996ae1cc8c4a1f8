"""What browsers are sent of the map: what changed, what can be seen, near things first."""

from typing import Any

import numpy as np
import pytest

from mapperd.viewer.chunks import Chunks, Filter, drawn_of, points_m
from mapperd.viewer.colours import Scale
from mapperd.viewer.map_layer import POINT_BYTES, MapLayer, MapStyle
from mapperd.viewer.shapes import STAY
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet
from tests.mapperd.viewer.view_fakes import blocks_of, mirror_of

HEIGHTS = Scale("height", -1.0, 1.0)
POINTS = MapStyle(Filter(), HEIGHTS, "points")
NOWHERE = (0.0, 0.0, 0.0)


class FakeScene:
    """Nodes of the scene by name, and what was sent.

    Attributes:
        nodes: properties.
        sent: names of chunks that were drawn, in order.
        removed: nodes, in order.
        made: nodes, in order.
        changed: properties that were set, in order.
    """

    def __init__(self) -> None:
        self.nodes: dict[str, dict[str, Any]] = {}
        self.sent: list[str] = []
        self.removed: list[str] = []
        self.made: list[str] = []
        self.changed: list[str] = []

    def add_point_cloud(self, name: str, **properties: Any) -> "FakeNode":
        return self._add(name, {"kind": "points", **properties})

    def add_batched_meshes_simple(self, name: str, **properties: Any) -> "FakeNode":
        return self._add(name, {"kind": "cubes", **properties})

    def _add(self, name: str, properties: dict[str, Any]) -> "FakeNode":
        assert name not in self.nodes, "it would not be seen until it is drawn"
        self.nodes[name] = properties
        self.sent.append(chunk_of(name))
        self.made.append(name)
        return FakeNode(self, name)

    def kinds(self) -> set[str]:
        return {node["kind"] for node in self.nodes.values()}

    def points(self, chunk: str) -> np.ndarray[Any, Any]:
        (node,) = (node for name, node in self.nodes.items() if chunk_of(name) == chunk)
        return np.asarray(node.get("points", node.get("batched_positions")), float)

    def centres(self) -> np.ndarray[Any, Any]:
        """Of all cells that a browser shows, sorted."""
        sent = [
            np.asarray(node[key], np.float16).astype(float) * node["scale"] + node["position"]
            for node in self.nodes.values()
            for key in ("points", "batched_positions")
            if key in node
        ]
        return np.asarray(np.unique(np.round(np.concatenate(sent), 6), axis=0))


class FakeNode:
    """One of them, as viser gives it."""

    _scene: FakeScene
    _name: str

    def __init__(self, scene: FakeScene, name: str) -> None:
        object.__setattr__(self, "_scene", scene)
        object.__setattr__(self, "_name", name)

    def __setattr__(self, key: str, value: Any) -> None:
        scene = self._scene
        node = scene.nodes[self._name]  # of one that is removed viser refuses it
        assert key in node, "nobody would draw it"
        if not scene.sent or scene.sent[-1] != chunk_of(self._name):
            scene.sent.append(chunk_of(self._name))
        if not np.array_equal(node[key], value):  # unchanged values are not sent
            node[key] = value
            scene.changed.append(key)

    def remove(self) -> None:
        del self._scene.nodes[self._name]
        self._scene.removed.append(self._name)


def chunk_of(name: str) -> str:
    return name.rsplit("/", 1)[1]


def draw_all(view: MapLayer, mirror: Any, near: tuple[float, float, float] = NOWHERE) -> None:
    while view.stale:
        view.draw(mirror, near, 0, 10**9, 1000)
    for _ in range(STAY + 1):
        view.tidy()


def cube_of(low: int, high: int) -> np.ndarray[Any, Any]:
    return np.asarray(np.indices((high - low,) * 3).reshape(3, -1).T + low)


def shell_of(low: int, high: int) -> np.ndarray[Any, Any]:
    cells = cube_of(low, high)
    return np.asarray(cells[((cells == low) | (cells == high - 1)).any(axis=1)])


@pytest.mark.parametrize("max_nodes", [1000, 1], ids=["small chunks", "large chunks"])
def test_only_the_shell_of_a_solid_is_sent_across_all_borders(max_nodes: int) -> None:
    scene = FakeScene()
    mirror = mirror_of(blocks_of(cube_of(-20, 20)))
    view = MapLayer(scene, POINTS, max_nodes)  # type: ignore[arg-type]
    view.touch(mirror.keys())
    draw_all(view, mirror)
    expected = np.round((shell_of(-20, 20) + 0.5) * 0.1, 6)
    np.testing.assert_allclose(scene.centres(), np.unique(expected, axis=0), atol=1e-5)
    assert view.cells == len(expected)
    low, high = view.bounds_m or ((), ())
    np.testing.assert_allclose([*low, *high], [-2.0] * 3 + [1.9] * 3)


def test_too_many_nodes_become_larger_ones() -> None:
    scene = FakeScene()
    scattered = np.random.default_rng(1).integers(-300, 300, (400, 3))
    mirror = mirror_of(blocks_of(scattered))
    view = MapLayer(scene, POINTS, max_nodes=20)  # type: ignore[arg-type]
    view.touch(mirror.keys())
    draw_all(view, mirror)
    assert 1 < len(scene.nodes) <= 64  # of 256 cells' edge: there are no larger ones
    expected = np.unique(np.round((scattered + 0.5) * 0.1, 6), axis=0)
    np.testing.assert_allclose(scene.centres(), expected, atol=1e-5)


def test_only_chunks_that_changed_are_sent_again() -> None:
    scene = FakeScene()
    mirror = mirror_of(blocks_of([[4, 4, 4], [44, 4, 4], [84, 4, 4]]))
    view = MapLayer(scene, POINTS)  # type: ignore[arg-type]
    view.touch(mirror.keys())
    draw_all(view, mirror)
    assert sorted(scene.sent) == ["0_0_0", "1_0_0", "2_0_0"]
    scene.sent.clear()
    changed = blocks_of([[44, 4, 4], [45, 4, 4]])
    mirror.put(changed, 0)
    view.touch(changed.keys)
    draw_all(view, mirror)
    assert scene.sent == ["1_0_0"]


def test_a_neighbour_that_is_laid_bare_is_sent_too() -> None:
    scene = FakeScene()
    line = [[x, 4, 4] for x in range(24, 40)]
    mirror = mirror_of(blocks_of(line))
    view = MapLayer(scene, POINTS)  # type: ignore[arg-type]
    view.touch(mirror.keys())
    draw_all(view, mirror)
    scene.sent.clear()
    view.touch([[4, 0, 0]])  # the block of cells 32 to 39, at the border of its chunk
    draw_all(view, mirror)
    assert sorted(scene.sent) == ["0_0_0", "1_0_0"]


def test_what_is_forgotten_goes_from_the_page() -> None:
    scene = FakeScene()
    mirror = mirror_of(blocks_of([[4, 4, 4], [44, 4, 4]]))
    view = MapLayer(scene, POINTS)  # type: ignore[arg-type]
    view.touch(mirror.keys())
    draw_all(view, mirror)
    gone = np.full((1, CELLS), UNKNOWN, np.int8)
    mirror.put(BlockSet(np.array([[5, 0, 0]], np.int32), np.zeros(1, np.uint32), gone), 0)
    view.touch([[5, 0, 0]])
    draw_all(view, mirror)
    assert [chunk_of(name) for name in scene.nodes] == ["0_0_0"]
    view.forget()
    assert scene.nodes == {}
    assert view.stale == 0


def test_near_chunks_are_sent_first_and_within_the_budget() -> None:
    scene = FakeScene()
    mirror = mirror_of(blocks_of([[32 * x + 4, 4, 4] for x in range(10)]))
    view = MapLayer(scene, POINTS)  # type: ignore[arg-type]
    view.touch(mirror.keys())
    sent = view.draw(mirror, (32.0, 0.4, 0.4), 0, 2 * POINT_BYTES - 1, 1000)
    assert scene.sent == ["9_0_0", "8_0_0"]
    assert sent == 2 * POINT_BYTES
    assert view.stale == 8
    draw_all(view, mirror)
    assert len(scene.nodes) == 10


def test_threshold_and_heights_choose_cells() -> None:
    blocks = blocks_of([[0, 0, 0], [0, 0, 2], [0, 0, 4]], log_odds=[1.0, 2.0, 3.0])
    mirror = mirror_of(blocks)
    chunks = Chunks(100)
    chunks.touch(blocks.keys)

    def heights(chosen: Filter) -> list[float]:
        return sorted(points_m(drawn_of(mirror, chunks, (0, 0, 0), chosen))[:, 2].round(3).tolist())

    assert heights(Filter()) == [0.05, 0.25, 0.45]
    assert heights(Filter(min_probability=0.85)) == [0.25, 0.45]  # log-odds 1.73
    assert heights(Filter(low_m=0.2)) == [0.25, 0.45]
    assert heights(Filter(high_m=0.3)) == [0.05, 0.25]


def test_a_clip_opens_the_inside() -> None:
    mirror = mirror_of(blocks_of(cube_of(0, 8)))
    chunks = Chunks(100)
    chunks.touch([[0, 0, 0]])
    whole = drawn_of(mirror, chunks, (0, 0, 0), Filter())
    cut = drawn_of(mirror, chunks, (0, 0, 0), Filter(high_m=0.4))
    assert len(whole) == 8**3 - 6**3
    assert len(cut) == 8 * 8 * 4 - 6 * 6 * 2  # the cut's face is seen


def test_many_cells_are_points_and_few_are_cubes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapperd.viewer.map_layer.MAX_CUBES", 100)
    scene = FakeScene()
    mirror = mirror_of(blocks_of([[x, 0, 0] for x in range(90)]))
    view = MapLayer(scene, MapStyle(Filter(), HEIGHTS))  # type: ignore[arg-type]
    view.touch(mirror.keys())
    draw_all(view, mirror)
    assert scene.kinds() == {"cubes"}
    mirror.put(blocks_of([[x, 0, 0] for x in range(90, 120)]), 0)
    view.touch(mirror.keys())
    draw_all(view, mirror)
    assert scene.kinds() == {"points"}
    view.change(MapStyle(Filter(high_m=np.inf, low_m=-1.0), HEIGHTS, "cubes"))
    draw_all(view, mirror)
    assert scene.kinds() == {"cubes"}


def test_of_many_cells_far_ones_are_drawn_in_larger_cubes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mapperd.viewer.map_layer.MAX_FINE", 100)
    scene = FakeScene()
    plate = np.array([[x, y, 4] for x in range(4) for y in range(4)])
    mirror = mirror_of(
        blocks_of(np.concatenate([np.add(plate, (320 * k, 0, 0)) for k in range(8)]))
    )
    view = MapLayer(scene, POINTS)  # type: ignore[arg-type]
    view.touch(mirror.keys())
    draw_all(view, mirror)
    assert {len(node["points"]) for node in scene.nodes.values()} == {16}
    scene.sent.clear()
    view.refine(NOWHERE, mirror.cell_m)
    draw_all(view, mirror)
    sent = {chunk_of(name): len(node["points"]) for name, node in scene.nodes.items()}
    assert sent == {f"{10 * k}_0_0": 16 if k == 0 else 4 if k == 1 else 1 for k in range(8)}
    (far,) = (node for name, node in scene.nodes.items() if chunk_of(name) == "70_0_0")
    centre = np.asarray(far["points"], float) * far["scale"] + far["position"]
    np.testing.assert_allclose(centre, [[224.2, 0.2, 0.6]], atol=1e-4)
    view.refine((224.0, 0.0, 0.0), mirror.cell_m)
    draw_all(view, mirror, (224.0, 0.0, 0.0))
    assert len(scene.points("70_0_0")) == 16
    assert len(scene.points("0_0_0")) == 1


@pytest.mark.parametrize("shape", ["points", "cubes"])
def test_a_map_that_grows_changes_its_nodes_in_place(shape: Any) -> None:
    scene = FakeScene()
    mirror = mirror_of(blocks_of([[x, 4, 4] for x in range(10)]))
    view = MapLayer(scene, MapStyle(Filter(), HEIGHTS, shape))  # type: ignore[arg-type]
    for length in (10, 12, 11, 30):
        mirror.put(blocks_of([[x, 4, 4] for x in range(length)]), 0)
        view.touch(mirror.keys())
        draw_all(view, mirror)
        assert len(scene.centres()) == length
        (node,) = scene.nodes.values()
        assert len(node["colors" if shape == "points" else "batched_colors"]) == length
    assert (len(scene.made), scene.removed) == (1, [])


def test_colours_are_sent_after_positions_even_if_unchanged() -> None:
    """Browsers apply colours on receipt, and need as many positions then."""
    scene = FakeScene()
    view = MapLayer(scene, MapStyle(Filter(), HEIGHTS, "cubes"))  # type: ignore[arg-type]
    for x in (1, 2):
        mirror = mirror_of(blocks_of([[0, 4, 4], [x, 4, 4]]))
        view.touch(mirror.keys())
        draw_all(view, mirror)
    assert "batched_positions" in scene.changed
    assert scene.changed[-1] == "batched_colors"


def test_cubes_stay_until_the_points_in_their_place_are_drawn() -> None:
    scene = FakeScene()
    mirror = mirror_of(blocks_of([[4, 4, 4], [44, 4, 4]]))
    view = MapLayer(scene, MapStyle(Filter(), HEIGHTS, "cubes"))  # type: ignore[arg-type]
    view.touch(mirror.keys())
    draw_all(view, mirror)
    view.change(POINTS)
    view.draw(mirror, NOWHERE, 0, 10**9, 1000)
    for _ in range(STAY - 1):
        view.tidy()
        assert (scene.kinds(), len(scene.nodes)) == ({"cubes", "points"}, 4)
    view.change(
        MapStyle(Filter(), HEIGHTS, "cubes")
    )  # and back: those that are to go are there yet
    made = len(scene.made)
    draw_all(view, mirror)
    assert (scene.kinds(), len(scene.made)) == ({"cubes"}, made)
    view.change(POINTS)
    view.draw(mirror, NOWHERE, 0, 10**9, 1000)
    view.forget()
    assert scene.nodes == {}


def test_small_chunks_stay_until_all_large_ones_are_drawn() -> None:
    scene = FakeScene()
    scattered = np.random.default_rng(1).integers(-300, 300, (100, 3))
    mirror = mirror_of(blocks_of(scattered))
    expected = np.unique(np.round((scattered + 0.5) * 0.1, 6), axis=0)
    view = MapLayer(scene, POINTS, max_nodes=90)  # type: ignore[arg-type]
    view.touch(mirror.keys())
    while len({name.split("/")[2] for name in scene.nodes}) < 2:
        view.draw(mirror, NOWHERE, 0, 10**9, 8)
        view.tidy()
    for _ in range(STAY + 1):
        view.tidy()
    seen = len(scene.centres())
    assert view.stale > 0
    assert scene.removed == []
    while view.stale:
        view.draw(mirror, NOWHERE, 0, 10**9, 8)
        assert len(scene.centres()) >= seen
    draw_all(view, mirror)
    np.testing.assert_allclose(scene.centres(), expected, atol=1e-5)
    assert len({name.split("/")[2] for name in scene.nodes}) == 1
