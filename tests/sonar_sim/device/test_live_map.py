"""The whole way: a simulated sonar and vehicle on the network, mapped live by the daemon."""

import asyncio
import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sonar_sim.device.server import ServedScenario, ServeSettings
from sonar_sim.navigation.odometry_output import output_named
from sonar_sim.scene.scenario import Scenario

from mapperd.config.loader import config_from_text
from mapperd.daemon.session import Live
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import OdometryPoses
from tests.sonar_sim.device.conftest import FLOOR_M
from tests.support.process import free_port

pytestmark = pytest.mark.net

VOXEL_M = 0.1
MakeScenario = Callable[..., Scenario]


def config_text(sonar_port: int, odometry_port: int) -> str:
    return (
        f"octree: {{voxel_resolution: {VOXEL_M}}}\n"
        f"device: {{address: 127.0.0.1, port: {sonar_port}, range: 3.0, beams: 256}}\n"
        f"odometry: {{sources: [{{link: 'udp://127.0.0.1:{odometry_port}'}}]}}\n"
    )


@pytest.mark.slow
def test_the_live_map_is_the_scene(floor_scenario: MakeScenario) -> None:
    async def work() -> SonarMap:
        port = free_port()
        outputs = [output_named(f"native@udp:127.0.0.1:{port}")]
        async with ServedScenario(floor_scenario(), ServeSettings(outputs=outputs)) as served:
            sonar_map = SonarMap(config_from_text(config_text(served.sonar.port, port)))
            poses = OdometryPoses(sonar_map.config)
            live = Live(sonar_map, poses)
            counters = live.counters

            async def seen_enough() -> None:
                async with asyncio.timeout(60.0):  # long on a busy computer
                    while counters.pings_mapped < 25 or served.route_s() < 5.0:  # noqa: ASYNC110
                        await asyncio.sleep(0.05)

            await live.run(seen_enough())
            assert counters.pings_total == counters.pings_mapped + counters.pings_dropped.total()
            assert poses.odometry.accepted >= 0.9 * poses.odometry.received > 100
            placed = live.mapping.snapshot.clocks["placed"]
            assert placed["device"] > placed["arrival"]
            return sonar_map

    occupied = asyncio.run(work()).voxels("occupied").centres_m
    errors_m = np.abs(occupied[:, 2] - FLOOR_M)
    assert np.median(errors_m) <= VOXEL_M
    assert np.quantile(errors_m, 0.95) <= 3 * VOXEL_M
    # Where the fan met the floor nearly at a right angle, all of it is there.
    under = occupied[np.abs(occupied[:, 1]) < 1.0]
    columns = {tuple(cell) for cell in np.floor(under[:, :2] / VOXEL_M).astype(int)}
    assert len(columns) > 0.8 * (2.0 / VOXEL_M) * (0.7 / VOXEL_M)


def test_the_command_is_stopped_by_a_signal_and_leaves_its_map(
    floor_scenario: MakeScenario, tmp_path: Path
) -> None:
    async def work() -> int:
        port = free_port()
        outputs = [output_named(f"native@udp:127.0.0.1:{port}")]
        async with ServedScenario(floor_scenario(), ServeSettings(outputs=outputs)) as served:
            config = tmp_path / "live.yaml"
            config.write_text(config_text(served.sonar.port, port), encoding="utf-8")
            words = ["-m", "mapperd", "--config", str(config), "--out", str(tmp_path / "out")]
            daemon = await asyncio.create_subprocess_exec(sys.executable, *words)
            async with asyncio.timeout(60.0):
                while served.sonar.device.fires < 3:  # noqa: ASYNC110 counters notify nobody
                    await asyncio.sleep(0.05)
                daemon.send_signal(signal.SIGTERM)
                code = await daemon.wait()
            demand = served.sonar.device.request
            assert demand is not None
            assert demand.standby
            return code

    assert asyncio.run(work()) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["pings_mapped"] > 3
    assert summary["live"]["pings_placed_by"]["device"] > 0
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"map.bt", "map.ply"}
