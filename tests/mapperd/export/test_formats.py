"""Formats by suffix; the trees are judged by OctoMap's own programs."""

import re
import subprocess
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from mapperd.errors import ExportError, MapError
from mapperd.export.formats import FORMATS, write_map
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore
from tests.support.maps import COARSE

ROOT = Path(__file__).resolve().parents[3]
Saved = Callable[..., Path]


def octomap(program: str, *words: str | Path) -> None:
    path = ROOT / ".venv" / "bin" / program
    if not path.exists():
        pytest.skip("OctoMap's programs are not installed (pip install '.[octomap]')")
    subprocess.run([path, *words], check=True, capture_output=True, timeout=60)  # noqa: S603


def occupied_leaves(tree: Path) -> set[tuple[float, ...]]:
    """Centres of the occupied leaves of a `.bt`, as OctoMap draws them."""
    octomap("bt2vrml", tree)
    text = tree.with_suffix(".bt.wrl").read_text(encoding="ascii")
    found = re.findall(r"translation (\S+) (\S+) (\S+)", text)
    return {tuple(round(float(word), 4) for word in words) for words in found}


def centres(sonar_map: SonarMap) -> set[tuple[float, ...]]:
    rows = sonar_map.voxels("occupied").centres_m.tolist()
    return {tuple(round(word, 4) for word in row) for row in rows}


def test_bt_holds_every_occupied_voxel(sonar_map: SonarMap, saved: Saved) -> None:
    assert occupied_leaves(saved(sonar_map, "harbour.bt")) == centres(sonar_map)


def test_ot_holds_every_occupied_voxel(sonar_map: SonarMap, saved: Saved) -> None:
    full = saved(sonar_map, "harbour.ot")
    binary = full.with_suffix(".bt")
    octomap("convert_octree", full, binary)
    unsure = {tuple(row) for row in sonar_map.core.voxels(0.0, 0.5)[0].tolist()}
    assert len(unsure) == 1
    assert occupied_leaves(binary) == centres(sonar_map) | unsure  # its threshold is 0.5


def test_map_comes_back_without_loss(large_map: SonarMap, saved: Saved) -> None:
    again = SonarMap(COARSE)
    again.load(saved(large_map, "harbour.map"))
    assert again.sha256() == large_map.sha256()


@pytest.mark.parametrize("name", ["harbour", "harbour.PLY", "harbour.png", ".ply"])
def test_unknown_suffix_is_refused(sonar_map: SonarMap, tmp_path: Path, name: str) -> None:
    with pytest.raises(ExportError, match=r"\.bt \.ot"):
        write_map(sonar_map, tmp_path / name)


@pytest.mark.parametrize("suffix", FORMATS)
def test_map_in_tiles_is_refused_and_read_from_its_file(
    sonar_map: SonarMap, tmp_path: Path, suffix: str
) -> None:
    tiled = SonarMap(COARSE)
    with TileStore(tmp_path / "dive.map", tiled, tile_size_m=10.0, cache_tiles=4) as store:
        tiled.core.put_bricks(
            [(key, data) for key, _, data in sonar_map.core.bricks_since(0)[1]],
            [(x, y, z) for x in (-1, 0) for y in (0, 1, 2) for z in (-1, 0)],
        )
        store.advance(b"1")
        with pytest.raises(MapError, match="in tiles") as caught:
            write_map(tiled, tmp_path / f"harbour{suffix}")
        assert caught.value.reason == "in_tiles"
        store.save()
        with closing(StoredMap(tmp_path / "dive.map", COARSE)) as stored:
            write_map(stored, tmp_path / f"stored{suffix}")
    write_map(sonar_map, tmp_path / f"harbour{suffix}")
    written = (tmp_path / f"stored{suffix}").read_bytes()
    assert written == (tmp_path / f"harbour{suffix}").read_bytes()
