"""Threads that read a map while another writes to it."""

import threading
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from mapperd.config.tree import Config, MountingConfig, OctreeConfig, OrientationConfig
from mapperd.imaging.ping_image import ping_image_of
from mapperd.mapping.queries import MapQueries, memory_stats
from mapperd.mapping.sonar_map import SonarMap
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]
CONFIG = Config(
    octree=OctreeConfig(voxel_resolution=0.2),
    mounting=MountingConfig(orientation=OrientationConfig(pitch=0.0)),
)
PINGS = 30


def poses() -> list[np.ndarray]:
    steps = []
    for i in range(PINGS):
        pose = np.eye(4)
        pose[:3, 3] = 0.3 * i, -0.1 * i, 0.05 * i
        steps.append(pose)
    return steps


def every_read(sonar_map: SonarMap) -> list[Callable[[], object]]:
    core = sonar_map.core
    queries = MapQueries(core, occupied_threshold=0.7, free_threshold=0.3)
    points = np.zeros((5, 3))
    return [
        lambda: queries.classify(points),
        lambda: queries.classify_box([-1, -1, -1], [1, 1, 1]),
        lambda: queries.ray_cast_depth([[0, 0, 0]], [[1, 0, 0]], max_range=5.0),
        lambda: queries.distance_field([0, 0, 0], [1, 1, 1], max_distance=0.5),
        lambda: queries.distance_slice([0, 0], [1, 1], z=0.0, max_distance=0.5),
        lambda: queries.occupied_in([-9, -9, -9], [9, 9, 9]),
        lambda: memory_stats(core),
        lambda: core.revision,
        lambda: core.query(points),
        lambda: core.blocks(0, 3),
        lambda: sonar_map.voxels("free"),
        sonar_map.octomap_bt,
        sonar_map.octomap_ot,
    ]


@pytest.mark.parametrize("integrator", ["evidence_grid", "rays"])
def test_what_is_read_is_the_map_after_a_whole_number_of_pings(
    ping: MakePing, integrator: str
) -> None:
    config = msgspec.structs.replace(
        CONFIG, mapping=msgspec.structs.replace(CONFIG.mapping, integrator=integrator)
    )
    echo = ping_image_of(ping(), config.sonar)
    alone, shared = SonarMap(config), SonarMap(config)
    states = {alone.sha256(): alone.counts()}
    for pose in poses():
        alone.integrate(echo, pose)
        states[alone.sha256()] = alone.counts()

    done = threading.Event()
    seen: list[object] = []
    failures: list[BaseException] = []

    def read() -> None:
        reads = every_read(shared)
        try:
            while not done.is_set():
                seen.append(shared.sha256())
                seen.append(shared.counts())
                for each in reads:
                    each()
        except BaseException as error:  # noqa: BLE001 shown by the test
            failures.append(error)

    readers = [threading.Thread(target=read) for _ in range(3)]
    for reader in readers:
        reader.start()
    for pose in poses():
        shared.integrate(echo, pose)
    done.set()
    for reader in readers:
        reader.join(timeout=60)
        assert not reader.is_alive()

    assert failures == []
    assert seen
    assert set(seen) <= set(states) | set(states.values())
    assert shared.sha256() == alone.sha256()


def test_a_visitor_holds_writers_off_but_not_the_interpreter(ping: MakePing) -> None:
    """A writer that waits for the map must have let go of the GIL, which the visitor needs."""
    sonar_map = SonarMap(CONFIG)
    echo = ping_image_of(ping(), CONFIG.sonar)
    sonar_map.integrate(echo, np.eye(4))
    before = sonar_map.core.block_count
    writers: list[threading.Thread] = []
    visited = 0

    def visit(keys: np.ndarray, units: np.ndarray, counts: np.ndarray) -> None:
        nonlocal visited
        visited += len(keys)
        assert units.shape == counts.shape == (len(keys), 16**3)
        if not writers:
            changes = (sonar_map.core.clear, lambda: sonar_map.integrate(echo, np.eye(4)))
            writers.extend(threading.Thread(target=change) for change in changes)
            for writer in writers:
                writer.start()
        assert all(writer.is_alive() for writer in writers)

    sonar_map.core.visit_blocks(visit, 2)
    for writer in writers:
        writer.join(timeout=60)
        assert not writer.is_alive()
    assert visited == before > 2


def test_a_visitor_that_fails_leaves_the_map_usable(ping: MakePing) -> None:
    sonar_map = SonarMap(CONFIG)
    sonar_map.integrate(ping_image_of(ping(), CONFIG.sonar), np.eye(4))

    def refuse(*_: np.ndarray) -> None:
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        sonar_map.core.visit_blocks(refuse, 100)
    sonar_map.core.clear()
    assert sonar_map.core.block_count == 0
    with pytest.raises(ValueError, match="at_once"):
        sonar_map.core.visit_blocks(refuse, 0)
