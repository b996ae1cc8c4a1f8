"""A lost brick comes back from a real recording, by the way that every ping goes."""

import sqlite3
from collections.abc import Callable
from pathlib import Path

from mapperd.config.tree import Config, MountingConfig, OctreeConfig, OrientationConfig
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.session.replay import Replay, Window
from mapperd.store.maintenance import rebuild_lost
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore
from oculus_driver.recording import open_recording

CONFIG = Config(
    octree=OctreeConfig(voxel_resolution=0.05),
    mounting=MountingConfig(orientation=OrientationConfig(pitch=0.0)),
)


def replay(recording: Path, sonar_map: SonarMap, after: Callable[[int], None]) -> None:
    work = Replay(sonar_map, FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0))), Window(), lambda: 0.0)
    with open_recording(recording) as source:
        for _ in work.run(source):
            after(work.counters.pings_mapped)
    after(work.counters.pings_mapped)


def test_a_lost_brick_is_mapped_again_from_its_recording(
    tmp_path: Path, ping_bytes: Callable[..., bytes]
) -> None:
    recording, path = tmp_path / "dive.bin", tmp_path / "dive.map"
    recording.write_bytes(b"".join(ping_bytes(number) for number in range(1, 5)))
    whole = SonarMap(CONFIG)
    replay(recording, whole, lambda _: None)

    sonar_map = SonarMap(CONFIG)
    with TileStore(path, sonar_map, tile_size_m=3.2, cache_tiles=2) as store:
        replay(recording, sonar_map, lambda pings: store.advance(bytes([pings])))
        assert store._noted[1] == bytes([4])
    connection = sqlite3.connect(path)
    with connection:
        changed = connection.execute("UPDATE brick SET crc = crc + 1 WHERE x = 0").rowcount
    connection.close()
    assert changed >= 2

    def map_again(scratch: SonarMap) -> bool:
        replay(recording, scratch, lambda _: None)
        return True

    sonar_map = SonarMap(CONFIG)
    with TileStore(path, sonar_map, tile_size_m=3.2, cache_tiles=2) as store:
        assert len(store.check()) == changed
        assert rebuild_lost(store, sonar_map, map_again) == changed
    read = SonarMap(CONFIG)
    with StoreReader(path) as reader:
        loaded = reader.load(read)
    assert loaded.lost == frozenset()
    assert loaded.position == bytes([4])
    assert read.sha256() == whole.sha256()
