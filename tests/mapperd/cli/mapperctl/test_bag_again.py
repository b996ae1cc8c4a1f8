"""`mapperctl bag` of maps, and of sessions of the daemon as they were mapped."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from mapperd.cli.mapperctl.bag import _map_of_odometry
from mapperd.config.loader import config_from_text
from mapperd.daemon.session import Live
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.ingest import SONAR
from mapperd.pipeline.pose_lookup import FixedPose
from tests.mapperd.cli.mapperctl.test_bag import CLOUD, IMAGE, ODOMETRY, points_of, read
from tests.mapperd.conftest import SECOND, START_NS, make_ping
from tests.support.mapperctl import Call
from tests.support.maps import FREE, OCCUPIED, map_of

SETTINGS = """
octree: {{voxel_resolution: 0.2}}
mounting: {{orientation: {{pitch: 0}}}}
device: {{address: 127.0.0.1}}
odometry: {{sources: [{{name: vehicle, link: "udp://127.0.0.1:52200"}}]}}
recording: {{folder: "{folder}", free_floor: 0}}
frames: {{map: harbour}}
"""


def test_map_becomes_a_cloud_and_a_grid(tmp_path: Path, call: Call) -> None:
    map_of(OCCUPIED, FREE).save(tmp_path / "a.map")
    code, lines, _ = call("bag", tmp_path / "a.map", tmp_path / "bag", "--storage", "sqlite3")
    assert code == 0
    assert lines[1:] == ["/map: 1 messages", "/sonar_3d_map: 1 messages"]
    reported = read(tmp_path / "bag")
    ((stamp_ns, cloud),), ((_, grid),) = reported[CLOUD], reported["/map"]
    assert stamp_ns == (tmp_path / "a.map").stat().st_mtime_ns
    points = points_of(cloud)
    assert sorted(zip(*(points[axis].tolist() for axis in "xyz"), strict=True)) == sorted(OCCUPIED)
    origin = grid.info.origin.position
    assert (origin.x, origin.y, grid.info.resolution) == (-3.25, 19.75, 0.25)
    assert grid.data.reshape(grid.info.height, grid.info.width).tolist() == [
        [-1, -1, 100, -1],
        [-1, 0, -1, -1],
        [100, -1, -1, -1],
        [-1, -1, -1, 0],
    ]


def test_map_of_other_thresholds(tmp_path: Path, call: Call) -> None:
    map_of(OCCUPIED, FREE).save(tmp_path / "a.map")
    call("bag", tmp_path / "a.map", tmp_path / "bag", "--min-probability", "0.97")
    ((_, cloud),) = read(tmp_path / "bag")[CLOUD]
    assert cloud.width == 0


@pytest.mark.parametrize("turned_deg", [0.0, 100.0, 180.0])
def test_odometry_frame_in_the_map_takes_the_vehicle_to_its_place(turned_deg: float) -> None:
    in_map = pose_from_rpy((3.0, -2.0, 1.0), (4.0, -7.0, turned_deg))
    in_odometry = pose_from_rpy((10.0, 20.0, -5.0), (1.0, 2.0, -30.0))
    shift: Pose = _map_of_odometry(in_map, in_odometry)
    found = shift.map_T_base @ in_odometry.map_T_base
    assert np.abs(found - in_map.map_T_base).max() < 1e-12


def test_session_is_reported_as_it_was_mapped(tmp_path: Path, call: Call) -> None:
    folder = tmp_path / "recordings"
    sonar_map = SonarMap(config_from_text(SETTINGS.format(folder=folder)))
    live = Live(
        sonar_map,
        FixedPose(pose_from_rpy((1.0, 2.0, 3.0), (0, 0, 30))),
        session="one",
        clock=lambda: START_NS,
    )

    async def work() -> None:
        async with live.recorder:
            live.ingest.order(live._beginning())
            live.mapping.start()
            for k in range(1, 4):
                live.ingest.receive(SONAR, make_ping(k), START_NS + k * SECOND // 10, gap=False)
            live.queue.close()
            await asyncio.to_thread(live.mapping.join)

    asyncio.run(work())
    code, lines, _ = call("bag", folder, tmp_path / "bag", "--as-recorded")
    assert code == 0, lines
    reported = read(tmp_path / "bag")
    assert len(reported[IMAGE]) == len(reported[ODOMETRY]) == 3
    ((_, cloud),) = reported[CLOUD]
    assert cloud.header.frame_id == "harbour"
    points = points_of(cloud)
    found = np.stack([points["x"], points["y"], points["z"]], axis=1)
    expected = sonar_map.voxels("occupied").centres_m.astype(np.float32)
    assert len(found) > 10
    assert (found[np.lexsort(found.T)] == expected[np.lexsort(expected.T)]).all()
    position = reported[ODOMETRY][0][1].pose.pose.position
    assert (position.x, position.y, position.z) == (1.0, 2.0, 3.0)
