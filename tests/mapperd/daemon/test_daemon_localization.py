"""A daemon that localizes, with a sonar and a vehicle on loopback: requests, poses, restarts."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.api import OperationError, PoseRequest
from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.config.loader import config_of
from mapperd.daemon.daemon import Daemon
from mapperd.daemon.session import Live, host_clock
from mapperd.events import EventLog
from mapperd.localization.map_io import write_nav2_map
from mapperd.localization.maps import FREE, OCCUPIED, GridMap
from mapperd.localization.session import begun
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import OdometryPoses
from oculus_driver import PlaybackSonar
from tests.mapperd.daemon.test_daemon import drive
from tests.support.process import free_port
from tests.support.waiting import run, until

pytestmark = pytest.mark.net

MakeBytes = Callable[..., bytes]
POSE = PoseRequest(0.0, 0.0, 0.0, std_xy_m=0.1, std_yaw_rad=0.05)


@pytest.fixture
def pings(ping_bytes: MakeBytes) -> list[bytes]:
    return [ping_bytes(k, start_time=100 + 0.02 * k) for k in range(1, 60)]


@pytest.fixture
def maps(tmp_path: Path) -> Path:
    """A wall ahead of the vehicle, and a map without a free cell."""
    folder = tmp_path / "maps"
    folder.mkdir()
    cells = np.full((200, 200), FREE, np.int8)
    cells[:, 130:133] = OCCUPIED
    write_nav2_map(GridMap(cells, 0.1, -10.0, -10.0), folder / "wall.yaml")
    write_nav2_map(GridMap(np.full((9, 9), OCCUPIED, np.int8), 1.0), folder / "rock.yaml")
    return folder


@asynccontextmanager
async def localizing(
    folder: Path, pings: list[bytes], make: MakeBytes, mode: str = "track"
) -> AsyncIterator[Daemon]:
    async with PlaybackSonar(pings, standby=True, loops=None) as sonar:
        port = free_port()
        config = config_of(
            {
                "mounting": {"orientation": {"pitch": 0}},
                "device": {"address": sonar.host, "port": sonar.port, "ping_rate": "highest"},
                "odometry": {"sources": [{"link": f"udp://127.0.0.1:{port}"}]},
                "recording": {"folder": str(folder / "recordings"), "free_floor": 0},
                "localization": {"mode": mode, "geometry": "2d"},
                "amcl": {"update_min_d": 0.05, "max_particles": 500},
            },
            "",
        )
        sonar_map, events, clock = SonarMap(config), EventLog(host_clock()), host_clock()
        poses, begin = OdometryPoses(config), begun(config)
        live = Live(sonar_map, poses, events=events, clock=clock, localization=begin)
        settings = ConfigStore(Layered(config))
        read, maps = (lambda: Layered(config)), folder / "maps"
        daemon = Daemon(settings, sonar_map, live, events, read=read, folder=maps)
        end = asyncio.Event()
        running = asyncio.create_task(daemon.run(end.wait()))
        driving = asyncio.create_task(drive(port, make))
        try:
            while daemon.phase == "starting":  # noqa: ASYNC110 it will be at once
                await asyncio.sleep(0)
            yield daemon
        finally:
            end.set()
            driving.cancel()
            await asyncio.gather(driving, return_exceptions=True)
            await running


def state(daemon: Daemon) -> object:
    return daemon.localization()["state"]


def codes(daemon: Daemon) -> list[str]:
    return [event.code for event in daemon.events.since(0)[0]]


async def refused(work: Any) -> str:
    with pytest.raises(OperationError) as caught:
        await work
    return caught.value.reason


@pytest.mark.usefixtures("maps")
def test_map_and_pose_are_given_and_it_is_localized(
    tmp_path: Path, pings: list[bytes], odometry_bytes: MakeBytes
) -> None:
    async def work() -> None:
        async with localizing(tmp_path, pings, odometry_bytes) as daemon:
            assert state(daemon) == "waiting for a map"
            assert await daemon.set_map("wall.yaml", None, "test") == {
                "path": str(tmp_path / "maps" / "wall.yaml")
            }
            await until(lambda: state(daemon) == "waiting for a pose")
            assert await daemon.initial_pose(POSE, "test") == {}
            await until(lambda: daemon.localization()["updates"] > 2)
            stated = daemon.localization(20)
            json.dumps(stated)
            assert stated["map"] == "wall.yaml"
            assert stated["pose"]["frame"] == "map"
            assert 0 < len(stated["sample"]) <= 20
            assert stated["map_odom"]["position_m"][2] == 0.0
            assert stated["clusters"]
            status = daemon.status()["localization"]
            assert status["mode"] == "track"
            assert status["x_m"] == pytest.approx(stated["pose"]["x_m"], abs=2.0)
            assert await daemon.request_nomotion_update("test") == {}
            await daemon.set_map("wall.yaml", POSE, "test")
            await daemon.global_localization("test")
        reported = codes(daemon)
        for code in ("map_set", "map_loaded", "pose_set", "global_localization"):
            assert code in reported
        assert set(reported) & {"localized", "ambiguous", "lost"}

    run(work())


@pytest.mark.usefixtures("maps")
def test_refusals_have_reasons_and_change_nothing(
    tmp_path: Path, pings: list[bytes], odometry_bytes: MakeBytes
) -> None:
    async def work() -> None:
        async with localizing(tmp_path, pings, odometry_bytes) as daemon:
            assert await refused(daemon.global_localization("test")) == "no_map"
            assert await refused(daemon.request_nomotion_update("test")) == "no_filter"
            assert await refused(daemon.set_map("wall.yaml", POSE, "test")) == "no_filter"
            assert await refused(daemon.set_map("none.yaml", POSE, "test")) == "no_such_map"
            assert await refused(daemon.set_map("../wall.yaml", POSE, "test")) == "bad_name"
            (tmp_path / "maps" / "broken.map").write_bytes(b"no map")
            assert await refused(daemon.set_map("broken.map", None, "test")) == "bad_map"
            assert await refused(daemon.global_localization("test")) == "no_map"
            other = PoseRequest(0.0, 0.0, 0.0, frame="odom")
            assert await refused(daemon.initial_pose(other, "test")) == "wrong_frame"
            await daemon.set_map("rock.yaml", None, "test")
            assert await refused(daemon.global_localization("test")) == "no_free_cells"
            before = daemon.live.counters.pings_mapped
            await until(lambda: daemon.live.counters.pings_mapped > before)  # it goes on mapping
        assert codes(daemon).count("localization_refused") == 7
        assert await refused(daemon.global_localization("test")) == "busy"

    run(work())
