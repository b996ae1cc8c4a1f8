"""Maps that are saved and loaded."""

import json
import stat
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd import _core
from mapperd.config.tree import Config, IwloConfig, MountingConfig, OctreeConfig, OrientationConfig
from mapperd.errors import ExportError, MapError
from mapperd.imaging.ping_image import ping_image_of
from mapperd.mapping.sonar_map import SonarMap
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]
CONFIG = Config(
    octree=OctreeConfig(voxel_resolution=0.2),
    mounting=MountingConfig(orientation=OrientationConfig(pitch=0.0)),
)


def pose_at(x: float, y: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return pose


def map_bytes() -> bytes:
    core = _core.VoxelMap(0.1, _core.IwloParams())
    core.set_log_odds(np.array([[0.0, 0.0, 0.0], [1.0, 2.0, -3.0]]), np.array([1.5, -2.5]))
    return core.encode_map()


@pytest.fixture
def saved(ping: MakePing, tmp_path: Path) -> tuple[SonarMap, Path]:
    sonar_map = SonarMap(CONFIG)
    for i in range(8):
        sonar_map.integrate(ping_image_of(ping(), CONFIG.sonar), pose_at(0.3 * i))
    path = tmp_path / "dive.map"
    sonar_map.save(path)
    return sonar_map, path


def test_loaded_map_is_the_saved_one_and_goes_on_like_it(
    saved: tuple[SonarMap, Path], ping: MakePing, tmp_path: Path
) -> None:
    sonar_map, path = saved
    loaded = SonarMap(CONFIG)
    loaded.load(str(path))
    assert loaded.sha256() == sonar_map.sha256()
    assert loaded.counts() == sonar_map.counts()
    for i in range(8):
        for each in (sonar_map, loaded):
            each.integrate(ping_image_of(ping(), CONFIG.sonar), pose_at(0.1 * i, -0.2 * i))
        assert loaded.sha256() == sonar_map.sha256()
    sonar_map.save(tmp_path / "a.map")
    loaded.save(tmp_path / "b.map")
    assert (tmp_path / "a.map").read_bytes() == (tmp_path / "b.map").read_bytes()


def test_other_settings_are_refused_and_the_map_stays(
    saved: tuple[SonarMap, Path], ping: MakePing
) -> None:
    _, path = saved
    for changes, because in (
        ({"octree": OctreeConfig(voxel_resolution=0.1)}, "voxels are 0.2"),
        ({"iwlo": IwloConfig(L_max=8.0)}, "L_max"),
        ({"iwlo": IwloConfig(decay_rate=0.2)}, "decay_rate"),
    ):
        config = msgspec.structs.replace(CONFIG, **changes)
        other = SonarMap(config)
        other.integrate(ping_image_of(ping(), config.sonar), pose_at(0.0))
        before = other.sha256()
        with pytest.raises(MapError, match=because) as caught:
            other.load(path)
        assert caught.value.reason == "bad_map_file"
        assert str(path) in str(caught.value)
        assert other.sha256() == before


def test_files_that_are_not_there_or_of_another_kind_are_refused(
    saved: tuple[SonarMap, Path], tmp_path: Path
) -> None:
    sonar_map, _ = saved
    before = sonar_map.sha256()
    with pytest.raises(MapError, match="cannot be read") as caught:
        sonar_map.load(tmp_path / "nowhere.map")
    assert caught.value.reason == "unreadable"
    with pytest.raises(MapError, match="cannot be read"):
        sonar_map.load(tmp_path)
    for content in (b"", b"map", json.dumps({"map": 1}).encode(), sonar_map.octomap_ot()):
        (tmp_path / "other").write_bytes(content)
        with pytest.raises(MapError, match="no map of mapperd") as caught:
            sonar_map.load(tmp_path / "other")
        assert caught.value.reason == "bad_map_file"
    with pytest.raises(MapError, match="no map of mapperd"):
        sonar_map.load("/dev/zero")  # has no end
    assert sonar_map.sha256() == before


def test_a_file_is_replaced_whole_or_not_at_all(
    saved: tuple[SonarMap, Path], tmp_path: Path
) -> None:
    sonar_map, path = saved
    before = path.read_bytes()
    assert stat.S_ISREG(path.stat().st_mode)
    sonar_map.core.clear()
    sonar_map.save(path)
    assert len(path.read_bytes()) < len(before)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["dive.map"]
    with pytest.raises(ExportError, match="cannot be written"):
        sonar_map.save(tmp_path / "nowhere" / "dive.map")


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_a_damaged_file_is_refused_whatever_was_done_to_it(data: st.DataObject) -> None:
    whole = map_bytes()
    at = data.draw(st.integers(0, len(whole) - 1))
    damaged = data.draw(
        st.sampled_from(
            [
                whole[:at],
                whole[:at] + bytes([whole[at] ^ data.draw(st.integers(1, 255))]) + whole[at + 1 :],
                whole[:at] + whole[at + 1 :],
                whole[:at] + data.draw(st.binary(min_size=1, max_size=9)) + whole[at:],
            ]
        )
    )
    fresh = _core.VoxelMap(0.1, _core.IwloParams())
    fresh.set_log_odds(np.ones((1, 3)), np.ones(1))
    before = fresh.encode_map()
    with pytest.raises(ValueError, match="map file: "):
        fresh.load_map(damaged)
    assert fresh.encode_map() == before
