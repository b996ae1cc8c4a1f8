"""Clouds of points, read back by other people's readers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData
from pypcd4.pypcd4 import PointCloud

from mapperd.mapping.sonar_map import SonarMap

Saved = Callable[..., Path]


def test_ply_holds_every_occupied_voxel(large_map: SonarMap, saved: Saved) -> None:
    vertices = PlyData.read(str(saved(large_map, "harbour.ply")))["vertex"]
    occupied = large_map.voxels("occupied")
    read = np.stack([vertices[name] for name in "xyz"], axis=1)
    assert np.array_equal(read, occupied.centres_m)
    assert np.array_equal(vertices["probability"], occupied.probability)
    assert np.array_equal(vertices["count"], occupied.count)


def test_pcd_holds_every_occupied_voxel(large_map: SonarMap, saved: Saved) -> None:
    cloud = PointCloud.from_path(saved(large_map, "harbour.pcd"))
    occupied = large_map.voxels("occupied")
    assert cloud.fields == ("x", "y", "z", "intensity", "count")
    assert cloud.points == len(occupied) == 1000
    assert np.array_equal(cloud.numpy(("x", "y", "z")), occupied.centres_m.astype(np.float32))
    assert np.array_equal(cloud.pc_data["intensity"], occupied.probability)
    assert np.array_equal(cloud.pc_data["count"], occupied.count)


def test_xyz_holds_every_occupied_voxel(large_map: SonarMap, saved: Saved) -> None:
    read = np.loadtxt(saved(large_map, "harbour.xyz"))
    assert np.array_equal(read, large_map.voxels("occupied").centres_m)


@pytest.mark.parametrize("name", ["empty.ply", "empty.pcd", "empty.xyz"])
def test_empty_map_is_an_empty_cloud(sonar_map: SonarMap, saved: Saved, name: str) -> None:
    sonar_map.core.clear()
    path = saved(sonar_map, name)
    if name.endswith("ply"):
        assert len(PlyData.read(str(path))["vertex"]) == 0
    elif name.endswith("pcd"):
        assert b"\nPOINTS 0\n" in path.read_bytes()
    else:
        assert path.read_bytes() == b""
