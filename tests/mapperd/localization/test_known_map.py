"""Maps to be localized on, from every kind of file, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.localization import known_map
from mapperd.localization.known_map import MAX_SIDE, load_known_map
from mapperd.localization.map_io import write_nav2_map
from mapperd.localization.maps import FREE, OCCUPIED, GridMap, VolumeMap
from mapperd.localization.session import begun
from mapperd.mapping.sonar_map import SonarMap
from tests.mapperd.localization.room import room, write_room

VOXEL_M = 0.5
HEIGHTS_M = (-3.75, -3.25, -2.75, -2.25)


def config_of(**ours: object) -> Config:
    reported = ", ".join(f"{name}: {value}" for name, value in ours.items())
    return config_from_text(
        f"octree: {{voxel_resolution: {VOXEL_M}}}\nlocalization: {{mode: track, {reported}}}\n"
    )


def basin(config: Config) -> SonarMap:
    """Walls 5 m x 4 m about water that is known best at one height, and a floor."""
    sonar_map = SonarMap(config)
    occupied, free = [], []
    for x in np.arange(-2.25, 2.5, VOXEL_M):
        for y in np.arange(-1.75, 2.0, VOXEL_M):
            occupied.append((x, y, HEIGHTS_M[0]))
            for z in HEIGHTS_M[1:]:
                if abs(x) > 2 or abs(y) > 1.5:
                    occupied.append((x, y, z))
                elif z == HEIGHTS_M[2] or x < 0:
                    free.append((x, y, z))
    for centres, log_odds in ((occupied, 3.0), (free, -3.0)):
        sonar_map.core.set_log_odds(np.array(centres), np.full(len(centres), log_odds))
    return sonar_map


@pytest.mark.parametrize("name", ["basin.map", "basin.bt", "basin.ot", "basin.BT"])
def test_3d_map_has_all_heights_and_free_cells_where_the_vehicle_drives(
    tmp_path: Path, name: str
) -> None:
    config = config_of()
    path, sonar_map = tmp_path / name, basin(config)
    if path.suffix == ".map":
        sonar_map.save(path)
    else:
        full = path.suffix == ".ot"
        path.write_bytes(sonar_map.octomap_ot() if full else sonar_map.octomap_bt())
    known = load_known_map(path, config)
    assert known.path == str(path)
    assert len(known.sha256) == 64
    assert isinstance(known.map, VolumeMap)
    assert known.map.distances_m.shape == (10, 8, 4)
    assert known.map.first_centre_m == pytest.approx([-2.25, -1.75, -3.75])
    assert known.grid.occupancy.shape == (8, 10)
    assert (known.grid.occupancy == FREE).sum() == 8 * 6
    assert (known.grid.occupancy == OCCUPIED).sum() == 80 - 48


def test_band_of_the_settings_reports_where_the_vehicle_drives(tmp_path: Path) -> None:
    basin(config_of()).save(tmp_path / "basin.map")
    known = load_known_map(tmp_path / "basin.map", config_of(band_low=-2.5, band_high=-2.0))
    assert (known.grid.occupancy == FREE).sum() == 4 * 6  # the narrow layer


def test_2d_is_the_slice_alone(tmp_path: Path) -> None:
    basin(config_of()).save(tmp_path / "basin.map")
    known = load_known_map(tmp_path / "basin.map", config_of(geometry="2d"))
    assert isinstance(known.map, GridMap)
    assert (known.map.occupancy == FREE).sum() == 48


def test_equal_maps_have_equal_fingerprints(tmp_path: Path) -> None:
    path = write_room(tmp_path)
    first = load_known_map(path, config_of())
    assert np.array_equal(first.grid.occupancy, room().occupancy)
    assert load_known_map(path, config_of(geometry="2d")).sha256 == first.sha256
    path.write_text(path.read_text().replace("-6.0", "-6.5"), encoding="utf-8")
    assert load_known_map(path, config_of()).sha256 != first.sha256


def test_what_is_too_large_is_refused_before_it_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(known_map, "MAX_VOXELS", 300)
    basin(config_of()).save(tmp_path / "basin.map")
    with pytest.raises(MapError, match=r"5 x 4 x 2 m are 3\.2e\+02 voxels of 0\.5 m") as caught:
        load_known_map(tmp_path / "basin.map", config_of())
    assert caught.value.reason == "too_large"
    load_known_map(tmp_path / "basin.map", config_of(geometry="2d"))


@pytest.mark.parametrize(
    ("name", "content", "stated"),
    [
        ("none.map", None, "there is no such file"),
        ("bad.map", b"nothing", "bad.map"),
        ("bad.bt", b"nothing", "bad.bt"),
        ("bad.yaml", b"image: [", "bad.yaml"),
        ("bad.db", b"SQLite format 3\0" + bytes(200), "bad.db"),
        ("a\0b.map", None, "there is no such file"),
    ],
)
def test_what_is_no_map_is_one_clear_message(
    tmp_path: Path, name: str, content: bytes | None, stated: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(MapError, match=stated) as caught:
        load_known_map(tmp_path / name, config_of())
    assert "\n" not in str(caught.value)


def test_map_without_anything_occupied_is_refused(tmp_path: Path) -> None:
    SonarMap(config_of()).save(tmp_path / "empty.map")
    with pytest.raises(MapError, match="nothing in it is occupied"):
        load_known_map(tmp_path / "empty.map", config_of())


def test_folder_and_large_file_are_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(MapError, match="no such file"):
        load_known_map(tmp_path, config_of())
    basin(config_of()).save(tmp_path / "basin.map")
    monkeypatch.setattr(known_map, "MAX_FILE_BYTES", 100)
    with pytest.raises(MapError, match="larger than 100 bytes"):
        load_known_map(tmp_path / "basin.map", config_of())


def test_grid_of_more_cells_a_side_than_the_filter_takes(tmp_path: Path) -> None:
    config = config_of()
    for cells, name in ((MAX_SIDE, "long"), (MAX_SIDE + 1, "longer")):
        write_nav2_map(GridMap(np.full((cells, 1), FREE, np.int8), 0.1), tmp_path / f"{name}.yaml")
    begun(config_of(map_path=tmp_path / "long.yaml"))  # the filter takes it
    with pytest.raises(MapError, match="32000 cells along a side") as caught:
        load_known_map(tmp_path / "longer.yaml", config)
    assert caught.value.reason == "too_large"
