from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.errors import MapError
from mapperd.mapping.probability import points_of
from mapperd.mapping.sonar_map import BRICK_VOXELS, SonarMap
from mapperd.store import stored_map
from mapperd.store.maintenance import packed, write_whole
from mapperd.store.stored_map import StoredMap
from mapperd.store.tiles import LAYERS, layer_of

CONFIG = config_from_text("octree: {voxel_resolution: 0.1}")
BRICK_M = 6.4


def uniform_brick(log_odds: float) -> bytes:
    """Return a brick whose voxels all have these log-odds, and were observed once."""
    one = SonarMap(CONFIG)
    places = np.stack(np.meshgrid(*3 * [np.arange(16)], indexing="ij"), axis=-1).reshape(-1, 3)
    one.core.set_log_odds(points_of((places + 0.5) * 0.1), np.full(len(places), log_odds))
    [(_, _, brick)] = one.core.bricks_since(0)[1]
    return bytes([64]) + b"".join(bytes([place]) + brick[2:] for place in range(64))


def mixed_map() -> SonarMap:
    """Return a map with lone voxels in many bricks."""
    sonar_map = SonarMap(CONFIG)
    random = np.random.default_rng(5)
    points = random.uniform(-1.2, 1.2, (2000, 3)) * BRICK_M
    sonar_map.core.add_log_odds(points, random.uniform(-3, 3, len(points)), low=-5, high=5)
    return sonar_map


def pruned_map() -> SonarMap:
    """Return a map with whole bricks, of which OctoMap prunes eight to one leaf."""
    sonar_map = SonarMap(CONFIG)
    sonar_map.core.set_log_odds(np.array([[1.0, 1.0, 1.0]]), np.array([3.0]))
    free, occupied = uniform_brick(-2.0), uniform_brick(3.0)
    cube = [(x, y, z) for x in (4, 5) for y in (-2, -1) for z in (0, 1)]
    sonar_map.core.put_bricks([(key, free) for key in cube])
    sonar_map.core.put_bricks([((6, -2, 0), occupied), ((6, -1, 0), free)])
    return sonar_map


def write_store(path: Path, sonar_map: SonarMap) -> None:
    revision, bricks = sonar_map.core.bricks_since(0)
    write_whole(path, sonar_map.config, revision, packed(bricks))


@pytest.fixture(scope="module")
def sonar_map() -> SonarMap:
    return mixed_map()


@pytest.fixture(scope="module")
def pruned() -> SonarMap:
    return pruned_map()


@pytest.fixture(params=[1, 7, 1000])
def stored(
    request: pytest.FixtureRequest,
    sonar_map: SonarMap,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[StoredMap]:
    monkeypatch.setattr(stored_map, "BRICKS_AT_ONCE", request.param)
    write_store(tmp_path / "dive.map", sonar_map)
    with closing(StoredMap(tmp_path / "dive.map", CONFIG)) as stored:
        yield stored


def test_fingerprint_and_counts_are_those_of_the_map_in_memory(
    sonar_map: SonarMap, stored: StoredMap
) -> None:
    assert stored.sha256() == sonar_map.sha256()
    assert stored.counts() == sonar_map.counts()
    assert stored.bricks_lost == 0


def test_voxels_come_in_the_same_order(sonar_map: SonarMap, stored: StoredMap) -> None:
    whole, cloud = sonar_map.occupied(), stored.occupied()
    assert len(cloud) == len(whole)
    np.testing.assert_array_equal(cloud.box_m, whole.box_m)
    for name in ("centres_m", "probability", "count"):
        parts = np.concatenate([getattr(some, name) for some in cloud.batches()])
        np.testing.assert_array_equal(parts, getattr(whole, name))


def test_lists_of_voxels_do_not_grow_with_the_map(tmp_path: Path) -> None:
    whole = SonarMap(CONFIG)
    whole.core.put_bricks([((0, y, 0), uniform_brick(3.0)) for y in range(3)])
    write_store(tmp_path / "dive.map", whole)
    with closing(StoredMap(tmp_path / "dive.map", CONFIG)) as stored:
        sizes = [len(some) for some in stored.occupied().batches()]
    assert sum(sizes) == 3 * BRICK_VOXELS**3
    assert max(sizes) <= BRICK_VOXELS**3


def test_free_voxels_come_in_the_same_order(sonar_map: SonarMap, stored: StoredMap) -> None:
    whole = sonar_map.voxels("free")
    for name in ("centres_m", "probability", "count"):
        parts = np.concatenate([getattr(some, name) for some in stored.free()])
        np.testing.assert_array_equal(parts, getattr(whole, name))


def test_saved_map_has_the_same_bytes(
    sonar_map: SonarMap, stored: StoredMap, tmp_path: Path
) -> None:
    sonar_map.save(tmp_path / "whole.map")
    stored.save(tmp_path / "parts.map")
    assert (tmp_path / "parts.map").read_bytes() == (tmp_path / "whole.map").read_bytes()


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_octomap_tree_has_the_same_bytes(
    sonar_map: SonarMap, stored: StoredMap, tmp_path: Path, suffix: str
) -> None:
    sonar_map.save_octomap(tmp_path / f"whole{suffix}")
    stored.save_octomap(tmp_path / f"parts{suffix}")
    assert (tmp_path / f"parts{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_bricks_of_one_state_become_one_leaf(pruned: SonarMap, tmp_path: Path, suffix: str) -> None:
    write_store(tmp_path / "dive.map", pruned)
    pruned.save_octomap(tmp_path / f"whole{suffix}")
    with closing(StoredMap(tmp_path / "dive.map", CONFIG)) as stored:
        stored.save_octomap(tmp_path / f"parts{suffix}")
    assert (tmp_path / f"parts{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()
    assert (tmp_path / f"parts{suffix}").stat().st_size < 2000


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_empty_map_is_an_empty_tree(tmp_path: Path, suffix: str) -> None:
    empty = SonarMap(CONFIG)
    write_store(tmp_path / "empty.map", empty)
    empty.save_octomap(tmp_path / f"whole{suffix}")
    with closing(StoredMap(tmp_path / "empty.map", CONFIG)) as stored:
        stored.save_octomap(tmp_path / f"parts{suffix}")
        assert stored.sha256() == empty.sha256()
        assert len(stored.occupied()) == 0
        np.testing.assert_array_equal(stored.occupied().box_m, np.zeros((2, 3)))
    assert (tmp_path / f"parts{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_voxel_beyond_the_reach_of_octomap_is_refused(tmp_path: Path, suffix: str) -> None:
    far = SonarMap(CONFIG)
    far.core.set_log_odds(np.array([[0.0, 0.0, 0.0], [3300.0, 0.0, 0.0]]), np.array([3.0, 3.0]))
    write_store(tmp_path / "far.map", far)
    with closing(StoredMap(tmp_path / "far.map", CONFIG)) as stored:
        with pytest.raises(MapError, match="outside the reach of OctoMap's") as refused:
            stored.save_octomap(tmp_path / f"far{suffix}")
        assert refused.value.reason == "out_of_reach"
    assert not (tmp_path / f"far{suffix}").exists()


def test_layers_of_a_brick_are_together_the_brick(sonar_map: SonarMap) -> None:
    whole = SonarMap(CONFIG)
    for key, _, brick in sonar_map.core.bricks_since(0)[1]:
        parts = [layer_of(brick, layer) for layer in range(LAYERS)]
        assert sum(part[0] for part in parts) == brick[0]
        assert sum(map(len, parts)) == len(brick) + LAYERS - 1
        for layer, part in enumerate(parts):
            only = SonarMap(CONFIG)
            only.core.put_bricks([(key, part)])
            only.core.visit_blocks(
                lambda keys, *_, layer=layer: np.testing.assert_array_equal(
                    keys[:, 0] % LAYERS, layer
                ),
                64,
            )
            whole.core.merge(only.core)
    assert whole.sha256() == sonar_map.sha256()


def test_layer_of_foreign_bytes_is_refused() -> None:
    for brick in (bytes([1, 0]) + bytes(8) + b"\x09", bytes([2, 0]) + bytes(8) + b"\x03\0"):
        with pytest.raises(ValueError, match=r"form|early"):
            layer_of(brick, 0)


def test_damaged_brick_is_lost_and_the_rest_is_there(sonar_map: SonarMap, tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    revision, bricks = sonar_map.core.bricks_since(0)
    rows = list(packed(bricks))
    object.__setattr__(rows[3], "crc", rows[3].crc ^ 1)
    write_whole(path, CONFIG, revision, rows)
    left = SonarMap(CONFIG)
    left.core.put_bricks([(key, data) for i, (key, _, data) in enumerate(bricks) if i != 3])
    with closing(StoredMap(path, CONFIG)) as stored:
        assert stored.lost == {rows[3].key}
        assert stored.sha256() == left.sha256()


def test_unsaved_bricks_replace_those_of_the_file(sonar_map: SonarMap, tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    revision, bricks = sonar_map.core.bricks_since(0)
    first, second, *rest = bricks
    write_whole(path, CONFIG, revision, packed([(first[0], 1, rest[0][2]), *rest]))
    unsaved = {key: brick for key, _, brick in (first, second)}
    with closing(StoredMap(path, CONFIG, unsaved=unsaved)) as stored:
        assert stored.sha256() == sonar_map.sha256()
        stored.save_octomap(tmp_path / "parts.ot")
    sonar_map.save_octomap(tmp_path / "whole.ot")
    assert (tmp_path / "parts.ot").read_bytes() == (tmp_path / "whole.ot").read_bytes()
