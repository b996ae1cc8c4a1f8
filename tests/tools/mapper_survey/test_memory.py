"""A worker's bound holds, however much of the map a ping changes."""

import numpy as np
import pytest
from mapper_survey.memory import COPIES, edge_within, grid_bytes, ping_bytes, voxel_bytes_of
from mapper_survey.spool import ROW, Rows

from mapperd.config.tree import Config, MappingConfig
from mapperd.geometry.frames import pose_from_rpy
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import BLOCK_VOXELS, SonarMap
from tests.tools.mapper_survey.maps import CONFIG

POSE = pose_from_rpy((1.3, -2.1, -4.0), (10, 30, 50)).map_T_base


def rows_of(*extents: tuple[int, int, int]) -> Rows:
    """Pings that change boxes so large, in blocks, anywhere."""
    rows = np.zeros(len(extents), dtype=ROW)
    rows["first"] = (-7, 3, 1000)
    rows["last"] = rows["first"] + np.reshape(extents, (-1, 3)) - 1
    return rows


def bright_ping(range_m: float) -> PingImage:
    """Everything is a return but the first third."""
    intensity = np.full((100, 64), 200, dtype=np.float32)
    intensity[:30] = 0
    return PingImage(intensity, np.linspace(-1, 1, 64), range_m / 100)


@pytest.mark.parametrize("integrator", ["evidence_grid", "rays"])
def test_no_ping_takes_more_than_is_reckoned(integrator: str) -> None:
    config = Config(octree=CONFIG.octree, mapping=MappingConfig(integrator=integrator, threads=1))  # type: ignore[arg-type]
    sonar_map = SonarMap(config)
    empty = sonar_map.memory_bytes
    echo = bright_ping(12.0)
    box = sonar_map.blocks_of(echo, POSE)
    assert box is not None
    extents = np.array(box[1], dtype=np.int64) - np.array(box[0]) + 1
    sonar_map.integrate(echo, POSE)
    took = sonar_map.memory_bytes - empty
    assert took > 500_000
    assert 2 * took < ping_bytes(extents[None], 32, config)
    # Of all blocks in its box: as much, and no more, can be dense.
    blocks = sonar_map.core.block_count
    row = np.array([[blocks, 1, 1]])
    assert took <= ping_bytes(row, blocks, config) - grid_bytes(row, config)


def test_tiles_are_so_small_that_one_ping_has_room() -> None:
    most = voxel_bytes_of(1 << 30, 0.1)
    one = np.array([[1, 1, 1]])
    block = ping_bytes(one, 1, CONFIG) - grid_bytes(one, CONFIG)
    fits = (COPIES - 1) * most // block
    assert 16**3 < 20 * 20 * 15 < fits < 32**3
    few = rows_of((1, 1, 1), (20, 20, 15), (0, 0, 0))
    assert edge_within(32, [few, rows_of()], CONFIG, most) == 32
    # 32 x 32 x 32 blocks in a tile of 8 bricks, and 16 x 16 x 16 in one of 4.
    wide = rows_of((200, 64, 100))
    assert edge_within(32, [few, wide], CONFIG, most) == 4
    assert edge_within(32, [rows_of((10**6,) * 3)], CONFIG, 0) == 1


def test_the_grid_of_a_ping_takes_a_few_megabytes() -> None:
    """A fan of 130 degrees and 30 m that looks along an axis, in voxels of 5 cm."""
    extents = np.array([[38, 68, 14]])
    config = Config()
    assert 5 << 20 < grid_bytes(extents, config) < 60 << 20
    fine = Config(mapping=MappingConfig(detail=2.0))
    assert grid_bytes(extents, fine) == pytest.approx(4 * grid_bytes(extents, config))
    mean = Config(mapping=MappingConfig(aggregation="mean"))
    assert grid_bytes(extents, mean) == pytest.approx(2 * grid_bytes(extents, config))
    assert grid_bytes(extents, Config(mapping=MappingConfig(integrator="rays"))) == 0


def test_default_tiles_need_not_be_smaller_for_a_sonar_of_12_m() -> None:
    """A fan of 130 degrees, anyhow turned, at 10 cm and 5 cm."""
    for resolution_m, edge in ((0.1, 8), (0.05, 4)):
        side = int(24 / resolution_m / BLOCK_VOXELS) + 2
        pings = rows_of((side, side, side))
        assert edge_within(edge, [pings], CONFIG, voxel_bytes_of(1 << 30, resolution_m)) == edge
