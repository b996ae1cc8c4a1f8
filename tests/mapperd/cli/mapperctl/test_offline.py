"""`mapperctl convert`: maps in all formats, with the settings in the files."""

import re
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pytest

from mapperd.cli.mapperctl.command import main
from mapperd.config.tree import Config, IwloConfig, OctreeConfig
from mapperd.export.formats import FORMATS
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.position import Position
from mapperd.store.tile_store import TileStore
from tests.support.mapperctl import Call
from tests.support.maps import FREE, OCCUPIED, UNSURE, map_of

OTHER = Config(octree=OctreeConfig(voxel_resolution=0.25), iwlo=IwloConfig(L_min=-8.0, L_max=6.5))


def stored(sonar_map: SonarMap, path: Path, origin_deg: tuple[float, float] | None = None) -> Path:
    """The map as a daemon leaves it."""
    tiled = SonarMap(sonar_map.config)
    position = Position("1", whole=True, sessions=("1",), origin_deg=origin_deg)
    with TileStore(path, tiled, tile_size_m=10.0, cache_tiles=4) as store:
        bricks = [(key, data) for key, _, data in sonar_map.core.bricks_since(0)[1]]
        tiled.core.put_bricks(
            bricks, [(x, y, z) for x in (-1, 0) for y in (0, 1, 2) for z in (-1, 0)]
        )
        store.advance(position.encoded())
        store.save()
    return path


def files_of(sonar_map: SonarMap, folder: Path) -> dict[str, Path]:
    """The map in files of every kind that can be read."""
    files = {".map": folder / "a.map", ".bt": folder / "a.bt", ".ot": folder / "a.ot"}
    sonar_map.save(files[".map"])
    files[".bt"].write_bytes(sonar_map.octomap_bt())
    files[".ot"].write_bytes(sonar_map.octomap_ot())
    return files | {".db": stored(sonar_map, folder / "a.db")}


@pytest.mark.parametrize("kind", [".map", ".bt", ".ot", ".db"])
def test_map_of_any_settings_is_converted(tmp_path: Path, call: Call, kind: str) -> None:
    sonar_map = map_of(OCCUPIED, FREE, UNSURE, config=OTHER)
    source = files_of(sonar_map, tmp_path)[kind]
    code, lines, _ = call("convert", source, tmp_path / "out.ply")
    assert code == 0
    assert lines[0] == f"{source}: 3 occupied, 3 free voxels of 0.25 m"
    assert lines[1:] == [f"{tmp_path / 'out.ply'}: {(tmp_path / 'out.ply').stat().st_size} bytes"]
    call("convert", source, tmp_path / "out.xyz")
    found = np.loadtxt(tmp_path / "out.xyz")
    assert sorted(map(tuple, found.tolist())) == sorted(OCCUPIED)


@pytest.mark.parametrize("kind", [".map", ".db"])
def test_nothing_is_lost_where_the_file_holds_all(tmp_path: Path, call: Call, kind: str) -> None:
    sonar_map = map_of(OCCUPIED, FREE, UNSURE, config=OTHER)
    assert call("convert", files_of(sonar_map, tmp_path)[kind], tmp_path / "out.map")[0] == 0
    again = SonarMap(OTHER)
    again.load(tmp_path / "out.map")
    assert again.sha256() == sonar_map.sha256()


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_is_written(tmp_path: Path, call: Call, suffix: str) -> None:
    source = files_of(map_of(OCCUPIED, FREE), tmp_path)[".map"]
    code, lines, _ = call("convert", source, tmp_path / f"out{suffix}")
    assert code == 0
    assert lines[1].startswith(f"{tmp_path / f'out{suffix}'}: ")


def test_probability_decides_what_is_occupied(tmp_path: Path, call: Call) -> None:
    source = files_of(map_of(OCCUPIED, FREE, UNSURE), tmp_path)[".map"]
    for min_probability, number in (("0.45", 4), ("0.7", 3), ("0.97", 0)):
        assert call("convert", source, tmp_path / "a.ply", "--min-probability", min_probability)[1][
            0
        ].startswith(f"{source}: {number} occupied, 3 free")


def test_place_on_earth_is_the_files_unless_another_is_asked_for(
    tmp_path: Path, call: Call
) -> None:
    source = stored(map_of(OCCUPIED), tmp_path / "a.db", (-33.9, 151.2))
    path = tmp_path / "a.laz"
    assert (
        call("convert", source, path)[1][2]
        == "coordinate reference system: WGS 84 / UTM zone 56S, EPSG:32756"
    )
    assert laspy.read(path).header.parse_crs().to_epsg() == 32756
    output = call("convert", source, path, "--origin", "54.3,10.1")[1][2]
    assert output == "coordinate reference system: WGS 84 / UTM zone 32N, EPSG:32632"
    settings = tmp_path / "a.yaml"
    settings.write_text("odometry: {origin: {latitude: 60.0, longitude: 20.0}}", encoding="utf-8")
    bare = files_of(map_of(OCCUPIED), tmp_path)[".map"]
    assert "34N" in call("convert", bare, path, "--config", settings)[1][2]
    assert "geographic position" in call("convert", bare, path)[1][2]


def test_heights_of_the_settings_hold(tmp_path: Path, call: Call) -> None:
    settings = tmp_path / "a.yaml"
    settings.write_text("export: {min_z: -8.0, max_z: -6.5}", encoding="utf-8")
    source = files_of(map_of(OCCUPIED), tmp_path)[".map"]
    call("convert", source, tmp_path / "a.asc", "--config", settings)
    assert b"-7.8750" in (tmp_path / "a.asc").read_bytes()


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:40])


def broken_brick(path: Path) -> None:
    data = bytearray(path.read_bytes())
    at = data.rindex(b"\x28\xb5\x2f\xfd")  # zstd's own mark
    data[at + 12] ^= 0xFF
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("kind", "harm", "words"),
    [
        (".map", cut, "map file"),
        (".bt", cut, "OctoMap|byte"),
        (".db", cut, "not a database|damaged|is no"),
        (".db", broken_brick, "1 bricks of it are damaged"),
        (".map", lambda path: path.write_bytes(b"hello"), "no map: neither"),
        (".map", lambda path: path.write_bytes(b""), "no map: neither"),
        (".map", lambda path: path.write_bytes(path.read_bytes()[:14]), "too early"),
        (".map", Path.unlink, "there is no such file"),
    ],
)
def test_file_that_is_no_map_is_one_line(
    tmp_path: Path, call: Call, kind: str, harm: Callable[[Path], object], words: str
) -> None:
    source = files_of(map_of(OCCUPIED), tmp_path)[kind]
    harm(source)
    code, _, output = call("convert", source, tmp_path / "out.ply")
    assert code == (66 if "no such file" in words else 65)
    assert str(source) in output
    assert any(word in output for word in words.split("|"))
    assert not (tmp_path / "out.ply").exists()


def test_name_without_a_format_is_refused_before_anything_is_read(
    tmp_path: Path, call: Call
) -> None:
    code, lines, output = call("convert", tmp_path / "nowhere.map", tmp_path / "out.obj")
    assert (code, lines) == (73, [])
    assert re.search(r"out\.obj: .*\.bt", output)


@pytest.mark.parametrize(
    "words", [["--origin", "91,0"], ["--origin", "1"], ["--min-probability", "1"]]
)
def test_numbers_that_cannot_be_are_refused(tmp_path: Path, words: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["convert", str(tmp_path / "a.map"), str(tmp_path / "a.ply"), *words])
    assert caught.value.code == 2


def test_settings_of_a_map_that_cannot_be_are_reported(tmp_path: Path, call: Call) -> None:
    source = files_of(map_of(OCCUPIED), tmp_path)[".map"]
    data = bytearray(source.read_bytes())
    at = data.index(np.float64(0.25).tobytes())
    data[at : at + 8] = np.float64(np.nan).tobytes()
    source.write_bytes(data)
    code, _, output = call("convert", source, tmp_path / "out.ply")
    assert code == 65
    assert "settings that cannot be" in output
