"""A daemon that maps and localizes, `mapperctl ros2`, and a peer that hears what clients get."""

import asyncio
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mapperd.client import Interest, LocalizationMessage, MapClient, PoseMessage, Want
from mapperd.daemon.daemon import Daemon
from mapperd.localization.map_io import write_nav2_map
from mapperd.localization.maps import FREE, OCCUPIED, GridMap
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.listeners import open_unix_listener
from mapperd.server.map_source import MapSource
from mapperd.server.state_feed import StateFeed
from mapperd.server.stream_server import StreamServer
from tests.mapperd.bridges.bridge_fakes import S
from tests.mapperd.bridges.test_ros2_bridge import (
    DOMAIN,
    LOOPBACK,
    Heard,
    pose_of,
    rows_of,
    stamp,
)
from tests.mapperd.daemon.test_daemon_localization import POSE, localizing, state
from tests.support.waiting import run, until

pytestmark = [pytest.mark.net, pytest.mark.slow]

MakeBytes = Callable[..., bytes]
CODE = "import sys; from mapperd.cli.mapperctl.command import main; sys.exit(main())"
WANTS: tuple[Want, ...] = ("map", "pose", "localization")
PART = Interest(level=2)
"""Fewer cells: the peer writes clouds as JSON."""

SETTINGS = "topics: {pointcloud: my_cloud}\nros2: {cloud_period: 0.1}\n"


@asynccontextmanager
async def served(daemon: Daemon, path: Path) -> AsyncIterator[None]:
    live = daemon.live
    daemon.settings.follow(["stream.rate"], lambda _: None)
    sonar_map = live.persistence.whole()
    assert isinstance(sonar_map, SonarMap)
    with MapSource(sonar_map, live.persistence, log_odds_step=0.25) as source:
        feed = StateFeed(daemon, lambda: live.mapping.snapshot, 1000)
        live.mapping.pipeline.executor.on_ping = feed.put
        listeners = [open_unix_listener(path, 0o600)]
        async with StreamServer(daemon, listeners, feed, source, now_ns=live.now_ns):
            yield


@asynccontextmanager
async def ros2(folder: Path, socket: Path) -> AsyncIterator[None]:
    (folder / "ros.yaml").write_text(SETTINGS)
    given = ["--domain", str(DOMAIN), "--namespace", "rov", "--socket", str(socket)]
    given += ["--level", str(PART.level)]
    program = await asyncio.create_subprocess_exec(
        sys.executable, "-c", CODE, "ros2", *given, "--config", str(folder / "ros.yaml")
    )
    try:
        yield
    finally:
        program.terminate()
        await program.wait()


class Followed:
    """What a client got, by the stamps of the messages that it becomes."""

    def __init__(self) -> None:
        self.poses: dict[int, PoseMessage] = {}
        self.estimates: dict[int, dict[str, Any]] = {}
        self.corrections: dict[int, dict[str, Any]] = {}

    async def follow(self, client: MapClient) -> None:
        async for change in client.changes():
            if isinstance(change, PoseMessage):
                self.poses[change.stamp_ns] = change
            elif isinstance(change, LocalizationMessage):
                self._localized(change.report)

    def _localized(self, report: dict[str, Any]) -> None:
        if report.get("pose"):
            self.estimates[round(report["t_s"] * S)] = report["pose"]
        if report.get("map_odom"):
            self.corrections[round(report["map_odom"]["t_s"] * S)] = report["map_odom"]


def transforms(heard: Heard, child: str) -> dict[int, tuple[list[float], Rotation]]:
    """Transforms to a frame, by their stamps."""
    return {
        stamp(one): pose_of(one["transform"])
        for message in heard["/tf"]
        for one in message["transforms"]
        if one["child_frame_id"] == child
    }


def estimates(heard: Heard) -> dict[int, dict[str, Any]]:
    return {stamp(one): one["pose"] for one in heard["/rov/amcl_pose"]}


def same(place: list[float], turn: Rotation, right: Any, xyzw: Any) -> None:
    assert place == pytest.approx(list(right))
    assert float((turn.inv() * Rotation.from_quat(xyzw)).magnitude()) < 1e-6


def compare(heard: Heard, got: Followed) -> None:
    """Compare what both have: each gets the newest, not all."""
    bases, odoms, poses = (
        transforms(heard, "base_link"),
        transforms(heard, "odom"),
        estimates(heard),
    )
    for at_ns in bases.keys() & got.poses.keys():
        pose = got.poses[at_ns]
        same(*bases[at_ns], pose.position_m, pose.orientation_xyzw)
    for at_ns in odoms.keys() & got.corrections.keys():
        correction = got.corrections[at_ns]
        same(*odoms[at_ns], correction["position_m"], np.roll(correction["orientation_wxyz"], -1))
    for at_ns in poses.keys() & got.estimates.keys():
        right = got.estimates[at_ns]
        place, turn = pose_of(poses[at_ns]["pose"])
        assert place[:2] == pytest.approx([right["x_m"], right["y_m"]])
        assert turn.as_euler("ZYX")[0] == pytest.approx(right["yaw_rad"])
        covariance = np.reshape(poses[at_ns]["covariance"], (6, 6))
        planar = np.ix_([0, 1, 5], [0, 1, 5])
        np.testing.assert_allclose(covariance[planar], right["covariance"])


def occupied_cells(client: MapClient) -> np.ndarray:
    assert client.mirror is not None
    return np.unique(client.mirror.cells("occupied").centres_m.astype("<f4"), axis=0)


def cloud_is_that_of(client: MapClient, heard: Heard) -> bool:
    if not heard["/rov/my_cloud"]:
        return False
    rows = rows_of(heard["/rov/my_cloud"][-1])
    found = np.unique(np.stack([rows["x"], rows["y"], rows["z"]], axis=1), axis=0)
    return np.array_equal(found, occupied_cells(client))


def grid_is_that_of(client: MapClient, heard: Heard) -> bool:
    """Look at all columns of the map, one by one."""
    assert client.mirror is not None
    if not heard["/map"]:
        return False
    grid = heard["/map"][-1]
    cell_m, columns = client.mirror.cell_m, dict[tuple[int, int], int]()
    for kind, value in (("free", 0), ("occupied", 100)):
        for x, y, _ in client.mirror.cells(kind).centres_m.tolist():  # type: ignore[arg-type]
            columns[int(np.floor(x / cell_m)), int(np.floor(y / cell_m))] = value
    (x_m, y_m, _), _ = pose_of(grid["info"]["origin"])
    data = np.reshape(grid["data"], (grid["info"]["height"], grid["info"]["width"]))
    y, x = np.nonzero(data != -1)
    low = np.rint([x_m / cell_m, y_m / cell_m]).astype(int)
    cells = zip((x + low[0]).tolist(), (y + low[1]).tolist(), data[y, x].tolist(), strict=True)
    return {(i, j): value for i, j, value in cells} == columns


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With a known map: a wall ahead of the vehicle."""
    (tmp_path / "maps").mkdir()
    cells = np.full((200, 200), FREE, np.int8)
    cells[:, 130:133] = OCCUPIED
    write_nav2_map(GridMap(cells, 0.1, -10.0, -10.0), tmp_path / "maps" / "wall.yaml")
    return tmp_path


@pytest.mark.usefixtures("own_folders")
def test_a_peer_hears_what_a_client_of_the_daemon_gets(
    folder: Path,
    short: Path,
    ping_bytes: MakeBytes,
    odometry_bytes: MakeBytes,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    pings = [ping_bytes(k, start_time=100 + 0.02 * k) for k in range(1, 60)]
    heard, got = Heard(), Followed()
    path = short / "map.sock"

    def have(number: int, one: Mapping[int, object], other: Mapping[int, object]) -> bool:
        return len(one.keys() & other.keys()) >= number

    async def work() -> None:
        async with (
            localizing(folder, pings, odometry_bytes) as daemon,
            served(daemon, path),
            heard.listening(DOMAIN),
            ros2(folder, path),
            MapClient(str(path), wants=WANTS, interest=PART) as client,
        ):
            following = asyncio.create_task(got.follow(client))
            await daemon.set_map("wall.yaml", None, "test")
            await until(lambda: state(daemon) == "waiting for a pose")
            await daemon.initial_pose(POSE, "test")
            await until(lambda: have(20, got.poses, transforms(heard, "base_link")))
            await until(lambda: have(5, got.corrections, transforms(heard, "odom")))
            await until(lambda: have(3, got.estimates, estimates(heard)))
            daemon.settings.apply({"processing.frame_skip": 1000}, "test")  # the map stands still
            await until(lambda: cloud_is_that_of(client, heard))
            await until(lambda: grid_is_that_of(client, heard))
            assert len(occupied_cells(client)) > 10
            following.cancel()

    run(work(), within_s=120)
    compare(heard, got)
    # It maps by odometry, and localizes on another map.
    frames = {heard[name][-1]["header"]["frame_id"] for name in ("/rov/my_cloud", "/map")}
    assert frames == {"odom"}
    assert heard["/rov/amcl_pose"][-1]["header"]["frame_id"] == "map"
