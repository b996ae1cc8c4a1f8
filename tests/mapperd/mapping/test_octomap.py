"""OctoMap files through the public map; OctoMap itself judges their content in cpp/map/test."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from mapperd import _core
from mapperd.config.tree import Config, IwloConfig, MountingConfig, OctreeConfig, OrientationConfig
from mapperd.errors import MapError
from mapperd.imaging.ping_image import ping_image_of
from mapperd.mapping.core_args import rule_params
from mapperd.mapping.sonar_map import SonarMap
from oculus_driver.ping import Ping

COARSE = Config(
    octree=OctreeConfig(voxel_resolution=0.2),
    mounting=MountingConfig(orientation=OrientationConfig(pitch=0.0)),
)
TINY_OT = b"# Octomap OcTree file\nid %s\nsize %s\nres %s\ndata\n%s"


@pytest.fixture
def sonar_map(ping: Callable[..., Ping]) -> SonarMap:
    seen = SonarMap(COARSE)
    for number in (1, 2, 3):
        seen.integrate(ping_image_of(ping(number), COARSE.sonar), np.eye(4))
    return seen


def known_voxels(sonar_map: SonarMap) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    centres, log_odds, count = sonar_map._map.voxels()
    return centres, log_odds, count


def test_full_tree_comes_back_with_log_odds_and_without_counts(sonar_map: SonarMap) -> None:
    again = SonarMap(COARSE)
    again.load_octomap(sonar_map.octomap_ot())
    centres, log_odds, count = known_voxels(again)
    before = known_voxels(sonar_map)
    assert np.array_equal(centres, before[0])
    assert np.array_equal(log_odds, before[1])
    assert (count == 1).all()
    assert before[2].max() > 1


def test_binary_tree_comes_back_with_classes(sonar_map: SonarMap) -> None:
    again = SonarMap(COARSE)
    again.load_octomap(sonar_map.octomap_bt())
    counts, before = again.counts(), sonar_map.counts()
    assert (counts.occupied, counts.free, counts.uncertain) == (before.occupied, before.free, 0)
    assert sorted({round(float(v), 1) for v in known_voxels(again)[1]}) == [-2.0, 3.5]


def test_values_of_a_file_stay_within_the_clamps_of_the_map(sonar_map: SonarMap) -> None:
    narrow = msgspec.structs.replace(COARSE, iwlo=IwloConfig(L_min=-1.0, L_max=1.5))
    for file in (sonar_map.octomap_ot(), sonar_map.octomap_bt()):
        again = SonarMap(narrow)
        again.load_octomap(file)
        _, log_odds, _ = known_voxels(again)
        assert (log_odds.min(), log_odds.max()) == (-1.0, 1.5)


@pytest.mark.parametrize("iwlo", [IwloConfig(decay_rate=0.0), IwloConfig(min_alpha=1.0)])
def test_loaded_voxels_are_known_where_counts_settle_at_once(
    sonar_map: SonarMap, iwlo: IwloConfig
) -> None:
    again = SonarMap(msgspec.structs.replace(COARSE, iwlo=iwlo))
    again.load_octomap(sonar_map.octomap_ot())
    assert len(known_voxels(again)[0]) == len(known_voxels(sonar_map)[0])


def test_what_was_loaded_replaces_the_map_and_can_be_mapped_on(
    sonar_map: SonarMap, ping: Callable[..., Ping]
) -> None:
    file = sonar_map.octomap_ot()
    sonar_map.integrate(ping_image_of(ping(4), COARSE.sonar), np.eye(4))
    assert sonar_map.octomap_ot() != file
    sonar_map.load_octomap(file)
    assert sonar_map.octomap_ot() == file
    assert sonar_map.integrate(ping_image_of(ping(4), COARSE.sonar), np.eye(4)).occupied > 0


@pytest.mark.parametrize(
    ("file", "because"),
    [
        (b"", "no OctoMap tree"),
        (TINY_OT % (b"ColorOcTree", b"1", b"0.2", b"12345678"), "'ColorOcTree'"),
        (TINY_OT % (b"OcTree", b"1", b"0.1", b"1234\0"), "0.1 m, the map's 0.2 m"),
        (TINY_OT % (b"OcTree", b"4000000000", b"0.2", b"1234"), "the file ends inside the tree"),
        (TINY_OT % (b"OcTree", b"1", b"0.2", b"\0\0\0\0\0"), "max_voxels"),
        (TINY_OT % (b"OcTree", b"0", b"0.2", b"\n"), "1 bytes follow"),
    ],
)
def test_a_bad_file_is_refused_and_changes_nothing(
    sonar_map: SonarMap, file: bytes, because: str
) -> None:
    before = sonar_map.sha256()
    with pytest.raises(MapError) as caught:
        sonar_map.load_octomap(file)
    assert caught.value.reason == "bad_octomap_file"
    assert because in str(caught.value)
    assert "OctoMap file, byte " in str(caught.value)
    assert sonar_map.sha256() == before


def test_limit_of_memory_can_be_set(sonar_map: SonarMap) -> None:
    core = _core.VoxelMap(0.2, rule_params(COARSE))
    with pytest.raises(ValueError, match="max_voxels"):
        core.load_octomap(sonar_map.octomap_bt(), max_voxels=1000)
    core.load_octomap(sonar_map.octomap_bt(), max_voxels=1_000_000)
    assert core.octomap_bt(0.0, 0.0) == sonar_map.octomap_bt()


def test_only_bytes_are_a_file(sonar_map: SonarMap) -> None:
    with pytest.raises(TypeError):
        sonar_map.load_octomap("# Octomap OcTree file")  # type: ignore[arg-type]


def test_map_beyond_octomap_is_refused(ping: Callable[..., Ping]) -> None:
    far = np.eye(4)
    far[0, 3] = 10_000.0
    sonar_map = SonarMap(COARSE)
    sonar_map.integrate(ping_image_of(ping(), COARSE.sonar), far)
    with pytest.raises(MapError, match="16-bit keys") as caught:
        sonar_map.octomap_ot()
    assert caught.value.reason == "out_of_reach"
