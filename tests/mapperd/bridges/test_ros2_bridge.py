"""The bridge to ROS 2, heard by a process that has nothing but cyclonedds."""

import asyncio
import contextlib
import gc
import json
import os
import signal
import socket
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from cyclonedds.core import DDSException
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from mapperd.bridges.dds import MARINE, SERVICES, DdsNode, RosTypes, full_name
from mapperd.bridges.ros2 import TOPICS, Ros2Bridge, domain_of, serve
from mapperd.bridges.ros2_messages import LiveMessages
from mapperd.bridges.ros2_services import Ros2Requests
from mapperd.client.changes import MapChanged
from mapperd.client.validation import AskError
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config, Ros2Config, TopicsConfig
from mapperd.errors import ConfigError, LiveError
from mapperd.export.rosbag import Messages
from mapperd.geometry.frames import Pose
from mapperd.odometry.fusion import FusedPose
from mapperd.odometry.native import decode_native
from mapperd.odometry.records import Odometry
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet
from mapperd.wire.messages import (
    EventMessage,
    Interest,
    LocalizationMessage,
    RobotsMessage,
    SettingsMessage,
)
from tests.mapperd.bridges import ros_peer
from tests.mapperd.bridges.bridge_fakes import (
    INFO,
    T0,
    BridgeStream,
    S,
    a_ping,
    a_pose,
    a_status,
    beat,
    began,
    linked,
    sure,
)
from tests.mapperd.foxglove.foxglove_fakes import FAN, IMAGE, PIXELS
from tests.support.process import resident_bytes
from tests.support.stream_server import Served, Server, a_block
from tests.support.waiting import until

pytestmark = pytest.mark.net

DOMAIN = 20 + os.getpid() % 200
LOOPBACK = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast>"
    '<Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>20</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
AT_REST = FusedPose(Pose(np.zeros(3), np.eye(4)[0]), None, None, np.eye(6), 0, 0.0)
PEER = Path(__file__).with_name("ros_peer.py")

Act = Callable[[BridgeStream, "Heard"], Awaitable[None]]


@pytest.fixture(autouse=True)
def _loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


class Heard:
    """What the peer has heard, and the lines of the bridge."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.messages: dict[str, list[dict[str, Any]]] = {}
        self.cdr: list[tuple[str, bytes]] = []
        self._process: asyncio.subprocess.Process | None = None

    def __getitem__(self, topic: str) -> list[dict[str, Any]]:
        return self.messages.get(topic, [])

    def ask(self, do: str, **fields: Any) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": do, **fields}).encode() + b"\n")

    @asynccontextmanager
    async def listening(self, domain: int) -> AsyncIterator[None]:
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            str(PEER),
            str(domain),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            limit=1 << 26,
        )
        reading = asyncio.create_task(self._read(self._process))
        try:
            yield
        finally:
            assert self._process.stdin is not None
            self._process.stdin.close()
            await self._process.wait()
            await reading

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            heard = json.loads(line)
            self.messages.setdefault(heard["topic"], []).append(heard["fields"])
            self.cdr.append((heard["topic"], bytes.fromhex(heard["cdr"])))


def beside_ros(
    act: Act,
    config: Config | None = None,
    *,
    peer_domain: int = DOMAIN,
    stream: BridgeStream | None = None,
) -> Heard:
    """Run a bridge and a peer, and `act` beside them."""
    heard, client = Heard(), stream or BridgeStream()
    config = config or of_rov()

    async def run() -> None:
        serving = asyncio.create_task(serve(client, config, heard.lines.append))
        async with asyncio.timeout(60), heard.listening(peer_domain):
            try:
                await act(client, heard)
            finally:
                serving.cancel()
                await asyncio.wait((serving,))

    asyncio.run(run())
    return heard


def of_rov(**ros2: Any) -> Config:
    fields: dict[str, Any] = {"domain": DOMAIN, "namespace": "rov", "cloud_period": 0.1} | ros2
    return Config(
        ros2=Ros2Config(**fields),
        topics=TopicsConfig(pointcloud="my_cloud", odometry="/slam/odometry"),
    )


SETTINGS = SettingsMessage(
    facts={
        "frames.sonar": {"value": "oculus", "dynamic": False},
        "filtering.min_range": {"value": 1.5, "dynamic": True, "unit": "m"},
        "processing.frame_skip": {"value": 2, "dynamic": True},
        "mqtt.host": {"value": "", "dynamic": False},
    }
)
ROBOTS = RobotsMessage(seen=[(T0, 1.0, 2.0, 3.0)])
APPEARED = EventMessage(
    event={
        "number": 3,
        "t_s": T0 / S,
        "severity": "warning",
        "code": "appeared",
        "text": "something new",
        "facts": {},
    }
)
CHANGE = {"kind": "appeared", "id": "a1", "low_m": [1.0, 1.0, -3.0], "high_m": [2.0, 3.0, -2.0]}
CORRECTION = {
    "position_m": [3.0, -2.0, 0.0],
    "orientation_wxyz": [0.8, 0.0, 0.0, 0.6],
    "t_s": (T0 + 2 * S) / S,
}


def feed_map(stream: BridgeStream) -> None:
    cells = np.full((1, CELLS), UNKNOWN, np.int8)
    cells[0, 0], cells[0, 9], cells[0, 130] = 40, -20, 90
    assert stream.mirror is not None
    key = np.array([[1, -1, 0]], np.int32)
    stream.mirror.put(BlockSet(key, np.zeros(1, np.uint32), cells), T0)
    stream.feed(MapChanged(key, T0 + 3 * S, 0))


def feed_everything(stream: BridgeStream) -> None:
    stream.feed(linked("connected"))
    stream.feed(began())
    stream.feed(SETTINGS)
    stream.feed(msgspec.structs.replace(FAN))
    feed_map(stream)


async def everything(stream: BridgeStream, heard: Heard) -> None:
    """Feed the state of a daemon again and again until all topics have been heard."""
    feed_everything(stream)

    def feed() -> bool:
        stream.feed(sure(map_odom=CORRECTION))
        stream.feed(a_pose(0.5, (1.0, 2.0, -5.0), 0.3, sonar_position_m=(1.0, 2.0, -5.5)))
        stream.feed(IMAGE)
        stream.feed(a_ping())
        stream.feed(ROBOTS)
        sonar = {"state": "x", "speed_of_sound_mps": 1480.0}
        stream.feed(a_status("no_sonar", sonar=sonar, changes=[CHANGE]))
        stream.feed(APPEARED)
        return {*heard.messages} == {*KINDS}

    for _ in range(300):
        if feed():
            return
        await asyncio.sleep(0.1)
    pytest.fail(f"heard only {sorted(heard.messages)}")


@pytest.fixture(scope="module")
def heard() -> Heard:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", LOOPBACK)
        return beside_ros(everything)


def stamp(message: dict[str, Any]) -> int:
    found = message["header"]["stamp"]
    return int(found["sec"] * S + found["nanosec"])


def pose_of(pose: dict[str, Any]) -> tuple[list[float], Rotation]:
    place = pose.get("position") or pose["translation"]
    turn = pose.get("orientation") or pose["rotation"]
    return [place[k] for k in "xyz"], Rotation.from_quat([turn[k] for k in "xyzw"])


def rows_of(cloud: dict[str, Any]) -> np.ndarray:
    kinds = {2: "u1", 4: "<u2", 7: "<f4"}
    kind = np.dtype(
        {
            "names": [one["name"] for one in cloud["fields"]],
            "formats": [kinds[one["datatype"]] for one in cloud["fields"]],
            "offsets": [one["offset"] for one in cloud["fields"]],
            "itemsize": cloud["point_step"],
        }
    )
    return np.frombuffer(bytes(cloud["data"]), kind)


def test_transforms_are_the_tree_of_rep_105(heard: Heard) -> None:
    transforms = {
        (one["header"]["frame_id"], one["child_frame_id"]): one
        for message in heard["/tf"][-2:]
        for one in message["transforms"]
    }
    assert set(transforms) == {("map", "odom"), ("odom", "base_link")}
    map_odom, odom_base = transforms[("map", "odom")], transforms[("odom", "base_link")]
    assert stamp(map_odom) == T0 + 2 * S  # ahead, as the daemon stamps it
    assert stamp(odom_base) == T0 + S // 2
    shift, turn = pose_of(map_odom["transform"])
    assert shift == pytest.approx(CORRECTION["position_m"])
    place, own = pose_of(odom_base["transform"])
    assert turn.apply(place) + shift == pytest.approx([1.0, 2.0, -5.0])
    assert (turn * own).as_euler("ZYX") == pytest.approx([0.3, 0.0, 0.0], abs=1e-9)


def test_the_mounting_is_latched_once(heard: Heard) -> None:
    (message,) = heard["/tf_static"]
    (one,) = message["transforms"]
    assert (one["header"]["frame_id"], one["child_frame_id"]) == ("base_link", "oculus")
    assert pose_of(one["transform"])[0] == pytest.approx([0.0, 0.0, -0.5])


def test_odometry_has_pose_twist_and_covariance(heard: Heard) -> None:
    message = heard["/rov/mapperd/odometry"][-1]
    assert (message["header"]["frame_id"], message["child_frame_id"]) == ("odom", "base_link")
    assert stamp(message) == T0 + S // 2
    linear = message["twist"]["twist"]["linear"]
    assert [linear[k] for k in "xyz"] == pytest.approx([1.0, 0.0, 0.0])
    covariance = np.reshape(message["pose"]["covariance"], (6, 6))
    # The map's axes are turned by 73.7 degrees to the odometry's: cos 0.28, sin 0.96.
    turn = np.array([[0.28, 0.96], [-0.96, 0.28]])
    assert covariance[:2, :2] == pytest.approx(turn @ np.diag([0.04, 0.09]) @ turn.T)


def test_the_estimate_of_localization_is_that_of_amcl(heard: Heard) -> None:
    message = heard["/rov/amcl_pose"][-1]
    assert (message["header"]["frame_id"], stamp(message)) == ("map", T0)
    place, turn = pose_of(message["pose"]["pose"])
    assert place == pytest.approx([1.0, 2.0, -5.0])
    assert turn.as_euler("ZYX") == pytest.approx([0.0, 0.0, 0.0])
    covariance = np.reshape(message["pose"]["covariance"], (6, 6))
    assert np.diag(covariance) == pytest.approx([0.04, 0.09, 0, 0, 0, 0.003])


@pytest.mark.parametrize("frame", ["", "m", "map", "odom", "odometry"])
@pytest.mark.parametrize("count", [0, 1, 3])
def test_rows_are_encoded_as_objects_are(frame: str, count: int) -> None:
    types = RosTypes()
    messages, make = LiveMessages(types.classes), types.classes
    drawn = np.random.default_rng(2).normal(size=(count, 4)).astype("<f4")
    state = LocalizationMessage(report={}, particles=drawn.tobytes())
    (array, poses), (cloud, particles) = messages.particles(state, T0, frame, -2.0)
    encoded = types.encoded(array, poses), types.encoded(cloud, particles)
    for x, y, z, qx, qy, qz, qw, weight in particles.tolist():
        point = make["geometry_msgs/msg/Point"](x, y, z)
        turn = make["geometry_msgs/msg/Quaternion"](qx, qy, qz, qw)
        array.poses.append(make["geometry_msgs/msg/Pose"](point, turn))
        cloud.particles.append(make["nav2_msgs/msg/Particle"](array.poses[-1], weight))
    assert encoded == (types.encoded(array), types.encoded(cloud))


def test_an_estimate_waits_for_the_pose_that_gives_its_height() -> None:
    topics = {"amcl_pose", "particlecloud", "particle_cloud"}
    assert not topics & {*published(sure())}
    sent = published(a_pose(0.0, (1.0, 2.0, -5.0)), sure())
    assert topics <= {*sent}
    assert sent["amcl_pose"][-1].pose.pose.position.z == -5.0


def test_directions_of_the_beams_follow_the_bearings() -> None:
    turned = np.frombuffer(IMAGE.bearings_rad, "<f4")[::-1].astype("<f4").tobytes()
    pings = published(IMAGE, msgspec.structs.replace(IMAGE, bearings_rad=turned), IMAGE)
    ahead = [[one.y for one in ping.beam_directions] for ping in pings["mapperd/ping"]]
    assert ahead[1] == ahead[0][::-1] != ahead[0]
    assert ahead[2] == ahead[0]


def test_particles_come_in_both_forms(heard: Heard) -> None:
    cloud = heard["/rov/particle_cloud"][-1]
    assert [one["weight"] for one in cloud["particles"]] == pytest.approx([0.7, 0.3])
    poses = heard["/rov/particlecloud"][-1]["poses"]
    assert [pose_of(one["pose"])[0] for one in cloud["particles"]] == [
        pose_of(one)[0] for one in poses
    ]
    place, turn = pose_of(poses[1])
    assert place == pytest.approx([3.0, 4.0, -5.0])
    assert turn.as_euler("ZYX")[0] == pytest.approx(1.5)


def test_the_image_is_that_of_the_daemon(heard: Heard) -> None:
    image = heard["/sensor/sonar/oculus/m750d/image"][-1]
    assert (image["header"]["frame_id"], stamp(image)) == ("oculus", IMAGE.stamp_ns)
    assert (image["encoding"], image["width"], image["height"]) == ("mono8", 3, 4)
    assert np.reshape(image["data"], (4, 3)).tolist() == PIXELS.tolist()


def test_the_ping_has_its_geometry(heard: Heard) -> None:
    ping = heard["/rov/mapperd/ping"][-1]
    assert (ping["header"]["frame_id"], stamp(ping)) == ("oculus", IMAGE.stamp_ns)
    assert ping["ranges"] == pytest.approx([0.25, 0.75, 1.25, 1.75])
    bearings = [-0.5, 0.0, 0.5]
    directions = [[one[k] for k in "xyz"] for one in ping["beam_directions"]]
    for direction, bearing in zip(directions, bearings, strict=True):
        assert direction == pytest.approx([np.cos(bearing), -np.sin(bearing), 0.0])
    assert (ping["image"]["dtype"], ping["image"]["beam_count"]) == (0, 3)
    assert ping["image"]["data"] == PIXELS.ravel().tolist()  # range by range
    assert ping["ping_info"]["sound_speed"] == 1480.0
    assert ping["ping_info"]["tx_beamwidths"] == pytest.approx([0.35] * 3)


def test_the_fan_image_is_seen_from_above(heard: Heard) -> None:
    fan = heard["/rov/mapperd/fan_image"][-1]
    assert (fan["encoding"], fan["height"], fan["step"]) == ("mono8", 4, fan["width"])
    pixels = np.reshape(fan["data"], (4, fan["width"]))
    assert pixels[0, fan["width"] // 2] == PIXELS[3, 1]  # far ahead: at the top


def test_returns_are_in_the_frame_of_the_sonar(heard: Heard) -> None:
    cloud = heard["/rov/mapperd/returns"][-1]
    assert (cloud["header"]["frame_id"], stamp(cloud)) == ("oculus", T0)
    (row,) = rows_of(cloud).tolist()
    assert row == pytest.approx((3.0, -1.0, 0.0, 0))


def test_the_cloud_has_the_occupied_cells(heard: Heard) -> None:
    cloud = heard["/rov/my_cloud"][-1]
    assert (cloud["header"]["frame_id"], stamp(cloud)) == ("map", T0 + 3 * S)
    rows = rows_of(cloud)
    found = {(row["x"], row["y"], row["z"]): row["intensity"] for row in rows}
    assert set(found) == {(4.25, -3.75, 0.25), (5.25, -3.75, 1.25)}
    assert found[(4.25, -3.75, 0.25)] == pytest.approx(1 / (1 + np.exp(-10.0)))


def test_the_grid_is_the_map_from_above(heard: Heard) -> None:
    grid = heard["/map"][-1]
    info = grid["info"]
    assert (grid["header"]["frame_id"], stamp(grid)) == ("map", T0 + 3 * S)
    assert info["resolution"] == 0.5
    corner, _ = pose_of(info["origin"])
    assert corner == pytest.approx([4.0, -4.0, 0.0])
    cells = np.reshape(grid["data"], (info["height"], info["width"]))
    assert cells[0, 0] == 100
    assert cells[1, 1] == 0
    assert cells[0, 2] == 100
    assert (cells == -1).sum() == cells.size - 3


def test_markers_show_robots_and_changes(heard: Heard) -> None:
    markers = heard["/sonar_3d_map_markers"][-1]["markers"]
    assert [(one["ns"], one["action"]) for one in markers] == [
        ("", 3),
        ("robots", 0),
        ("appeared", 0),
    ]
    _, robot, change = markers
    assert pose_of(robot["pose"])[0] == [1.0, 2.0, 3.0]
    assert pose_of(change["pose"])[0] == [1.5, 2.0, -2.5]
    assert [change["scale"][k] for k in "xyz"] == [1.0, 2.0, 1.0]


def test_diagnostics_name_the_problem_and_localization(heard: Heard) -> None:
    message = heard["/diagnostics"][-1]
    assert stamp(message) == T0
    daemon, localization = message["status"]
    assert (daemon["name"], daemon["level"], daemon["hardware_id"]) == (
        "mapperd: daemon",
        2,
        "diver",
    )
    assert daemon["message"].startswith("no_sonar")
    assert (localization["name"], localization["level"]) == ("mapperd: localization", 0)


def test_events_are_in_the_log(heard: Heard) -> None:
    message = heard["/rosout"][-1]
    assert (message["level"], message["name"], message["msg"]) == (
        30,
        "mapperd",
        "appeared: something new",
    )
    assert message["stamp"] == {"sec": T0 // S, "nanosec": 0}


def test_each_change_of_a_link_is_one_line(heard: Heard) -> None:
    assert sum("connected" in line for line in heard.lines) == 1
    assert sum("have subscribers" in line for line in heard.lines) == 1
    assert len(heard.lines) <= 3


NAMED = {
    "sonar": of_rov().topics.sonar,
    "cloud": of_rov().topics.pointcloud,
    "markers": of_rov().topics.marker,
}
KINDS = {full_name("rov", NAMED.get(key, name)): kind for key, (name, kind, *_) in TOPICS.items()}


def test_a_bag_recorded_from_it_opens_with_rosbags(heard: Heard, tmp_path: Path) -> None:
    """The peer records bytes that it has encoded itself."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in MARINE.items():
        store.register(get_types_from_msg(text, name))
    path = tmp_path / "bag"
    with Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as bag:
        connections = {
            topic: bag.add_connection(topic, kind, typestore=store) for topic, kind in KINDS.items()
        }
        for number, (topic, data) in enumerate(heard.cdr):
            if topic in connections:
                bag.write(connections[topic], T0 + number, data)
    seen = set()
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            message: Any = store.deserialize_cdr(data, connection.msgtype)
            seen.add(connection.topic)
            if connection.topic == "/map":
                assert message.data[:3].tolist() == [100, -1, 100]
            if connection.topic == "/rov/mapperd/odometry":
                assert message.header.stamp.nanosec == S // 2
    assert seen == set(KINDS)


async def answer_of(heard: Heard, topic: str, *, seq: int, **fields: Any) -> dict[str, Any]:
    """Call a service until it answers."""
    for _ in range(100):
        heard.ask("call", name=topic, seq=seq, **fields)
        await asyncio.sleep(0.1)
        found = [one for one in heard[topic] if one["seq"] == seq]
        if found:
            return found[0]
    pytest.fail(f"no answer of {topic}")


def test_commands_and_poses_reach_the_daemon_where_they_are_allowed() -> None:
    async def act(stream: BridgeStream, heard: Heard) -> None:
        stream.feed(SETTINGS)

        asked = partial(answer_of, heard)
        empty = {"structure_needs_at_least_one_member": 0}
        answer = await asked("/rov/global_localization", seq=1, **empty)
        assert answer["guid"] == 77
        names = ["filtering.min_range", "processing.frame_skip", "mqtt.host", "none"]
        answer = await asked("/rov/mapperd/get_parameters", seq=2, names=names)
        kinds = [(one["type"], one["double_value"]) for one in answer["values"]]
        assert kinds == [(3, 1.5), (2, 0.0), (4, 0.0), (0, 0.0)]
        change = {"name": "filtering.min_range", "value": {"type": 2, "integer_value": 3}}
        answer = await asked("/rov/mapperd/set_parameters", seq=3, parameters=[change])
        assert answer["results"] == [{"successful": True, "reason": ""}]
        stream.refusal = AskError("refused", "the store is busy")
        answer = await asked("/rov/mapperd/reset", seq=4, **empty)
        assert (answer["success"], answer["message"]) == (False, "the store is busy")
        stream.refusal = None
        heard.ask("pose", x_m=4.0, y_m=5.0, z=0.6, w=0.8, frame="map")
        await until(lambda: any(one["do"] == "initial_pose" for one in stream.requests))

    stream = BridgeStream()
    heard = beside_ros(act, of_rov(commands=True), stream=stream)
    by_do = {one["do"]: one for one in stream.requests}
    assert set(by_do) == {"global_localization", "set", "reset", "initial_pose"}
    value = by_do["set"]["changes"]["filtering.min_range"]
    assert (value, type(value)) == (3.0, float)
    pose = by_do["initial_pose"]["pose"]
    assert (pose["x_m"], pose["y_m"], pose["frame"]) == (4.0, 5.0, "map")
    assert pose["yaw_rad"] == pytest.approx(2 * np.arctan2(0.6, 0.8))
    assert pose["covariance"] == [[0.25, 0, 0], [0, 0.25, 0], [0, 0, 0.06]]
    assert "initial pose from ROS: set" in heard.lines


EMPTY = {"structure_needs_at_least_one_member": 0}
NAMES = ["filtering.min_range", "processing.frame_skip", "mqtt.host", "none"]
TO_3 = [{"name": NAMES[0], "value": {"type": 2, "integer_value": 3}}]
SET_3 = {"do": "set", "changes": {NAMES[0]: 3.0}}
SET = {"successful": True, "reason": ""}
DONE = {"success": True, "message": ""}
SAVE = {"map_topic": "", "image_format": "", "map_mode": "", "free_thresh": 0, "occupied_thresh": 0}
CALLS: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any] | None]] = {
    "/rov/global_localization": (EMPTY, EMPTY, {"do": "global_localization"}),
    "/rov/reinitialize_global_localization": (EMPTY, EMPTY, {"do": "global_localization"}),
    "/rov/request_nomotion_update": (EMPTY, EMPTY, {"do": "request_nomotion_update"}),
    "/rov/mapperd/reset": (EMPTY, DONE, {"do": "reset"}),
    "/rov/mapperd/snapshot": (EMPTY, DONE, {"do": "snapshot"}),
    "/rov/mapperd/reload": (EMPTY, DONE, {"do": "reload"}),
    "/rov/mapperd/load_map": (
        {"map_url": "file:///maps/harbour.yaml"},
        {"result": 0, "map.info.width": 1, "map.info.height": 1, "map.data": [-1]},
        {"do": "set_map", "name": "harbour.yaml"},
    ),
    "/rov/mapperd/save_map": (
        {"map_url": "/maps/harbour", **SAVE},
        {"result": True},
        {"do": "save", "name": "harbour.pgm"},
    ),
    "/rov/mapperd/get_parameters": (
        {"names": NAMES},
        {"values.0.double_value": 1.5, "values.1.integer_value": 2, "values.3.type": 0},
        None,
    ),
    "/rov/mapperd/get_parameter_types": ({"names": NAMES}, {"types": [3, 2, 4, 0]}, None),
    "/rov/mapperd/describe_parameters": (
        {"names": NAMES},
        {
            "descriptors.0.name": NAMES[0],
            "descriptors.0.type": 3,
            "descriptors.0.read_only": False,
            "descriptors.2.read_only": True,
        },
        None,
    ),
    "/rov/mapperd/list_parameters": (
        {"prefixes": ["filtering", "mqtt"], "depth": 0},
        {"result": {"names": [NAMES[0], NAMES[2]], "prefixes": ["filtering", "mqtt"]}},
        None,
    ),
    "/rov/mapperd/set_parameters": ({"parameters": TO_3}, {"results": [SET]}, SET_3),
    "/rov/mapperd/set_parameters_atomically": ({"parameters": TO_3}, {"result": SET}, SET_3),
}
"""Fields of a request, fields of its response by their paths, and what the daemon is asked."""


@pytest.fixture(scope="module")
def called() -> dict[str, tuple[dict[str, Any], list[dict[str, Any]]]]:
    """The response to a call of each service, and the requests of the daemon."""
    found: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {}

    async def act(stream: BridgeStream, heard: Heard) -> None:
        stream.feed(SETTINGS)
        for seq, (name, (fields, _, _)) in enumerate(CALLS.items(), 1):
            del stream.requests[:]
            found[name] = await answer_of(heard, name, seq=seq, **fields), [*stream.requests]

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", LOOPBACK)
        beside_ros(act, of_rov(commands=True))
    return found


@pytest.mark.parametrize("name", CALLS)
def test_a_call_reaches_the_daemon_and_is_answered(
    name: str, called: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]]
) -> None:
    answer, asked = called[name]
    for path, value in CALLS[name][1].items():
        found: Any = answer
        for part in path.split("."):
            found = found[int(part)] if part.isdigit() else found[part]
        assert found == value, path
    request = CALLS[name][2]
    assert all(one == request for one in asked)  # a call may be repeated until it is answered
    assert bool(asked) == (request is not None)


def test_every_service_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    offered: dict[str, str] = {}

    def offer(node: DdsNode, name: str, kind: str) -> None:  # noqa: ARG001 as the method
        offered[full_name("rov", name)] = kind

    monkeypatch.setattr(DdsNode, "service", offer)
    node = DdsNode(DOMAIN, "rov")
    Ros2Requests(BridgeStream(), node, LiveMessages({}), of_rov(commands=True), print)
    node.close()
    assert {*CALLS} == {*offered} == {*ros_peer.SERVICES}
    assert {*offered.values()} == {*SERVICES}


def test_a_map_that_cannot_be_loaded_has_the_reason_as_its_result() -> None:
    async def act(stream: BridgeStream, heard: Heard) -> None:
        for seq, (reason, result) in enumerate(
            (("no_such_map", 1), ("bad_map", 2), ("busy", 255)), 1
        ):
            stream.refusal = AskError(reason, "no")
            name = "/rov/mapperd/load_map"
            assert (await answer_of(heard, name, seq=seq, map_url="a"))["result"] == result

    beside_ros(act, of_rov(commands=True))


def test_a_daemon_that_hangs_holds_up_neither_poses_nor_parameters() -> None:
    async def act(stream: BridgeStream, heard: Heard) -> None:
        stream.feed(SETTINGS)
        while not stream.requests:
            heard.ask(
                "call", name="/rov/mapperd/reset", seq=1, structure_needs_at_least_one_member=0
            )
            await asyncio.sleep(0.1)
        names = ["filtering.min_range"]
        await answer_of(heard, "/rov/mapperd/get_parameters", seq=2, names=names)
        while stream.requests[-1]["do"] != "initial_pose":
            heard.ask("pose", x_m=4.0, y_m=5.0, z=0.0, w=1.0, frame="map")
            await asyncio.sleep(0.1)
        stream.hangs.add("initial_pose")
        await asyncio.sleep(1.0)  # longer than two poses are apart
        await answer_of(heard, "/rov/mapperd/get_parameters", seq=3, names=names)

    stream = BridgeStream()
    stream.hangs.add("reset")
    beside_ros(act, of_rov(commands=True), stream=stream)


def test_a_flood_of_initial_poses_is_thinned_and_one_line() -> None:
    async def act(stream: BridgeStream, heard: Heard) -> None:
        heard.ask("pose", x_m=-1.0, y_m=0.0, z=0.0, w=1.0, frame="map")
        while not stream.requests:
            heard.ask("pose", x_m=-1.0, y_m=0.0, z=0.0, w=1.0, frame="map")
            await asyncio.sleep(0.1)
        for _ in range(20):
            heard.ask("flood", number=200)
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.0)

    stream = BridgeStream()
    heard = beside_ros(act, of_rov(commands=True), stream=stream)
    assert 2 <= len(stream.requests) <= 12
    assert sum("initial pose" in line for line in heard.lines) == 1


def test_nothing_is_changed_where_commands_are_off() -> None:
    async def act(stream: BridgeStream, heard: Heard) -> None:
        stream.feed(SETTINGS)
        change = {"name": "filtering.min_range", "value": {"type": 3, "double_value": 3.0}}
        topic = "/rov/mapperd/set_parameters"
        while not heard[topic]:
            heard.ask("call", name=topic, seq=1, parameters=[change])
            heard.ask("pose", x_m=4.0, y_m=5.0, z=0.0, w=1.0, frame="map")
            await asyncio.sleep(0.1)
        assert heard[topic][0]["results"][0]["reason"] == "changes are off: ros2.commands"

    stream = BridgeStream()
    beside_ros(act, stream=stream)
    assert stream.requests == []


def test_odometry_of_others_is_passed_on_as_native_records() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as daemon:
        daemon.bind(("127.0.0.1", 0))
        daemon.setblocking(False)  # noqa: FBT003 the call's own form
        link = f"udp://127.0.0.1:{daemon.getsockname()[1]}"
        received: list[bytes] = []

        async def act(_: BridgeStream, heard: Heard) -> None:
            for _attempt in range(300):
                heard.ask("odometry", x_m=1.5)
                await asyncio.sleep(0.1)
                with contextlib.suppress(BlockingIOError):
                    received.append(daemon.recv(4096))
                    return

        beside_ros(act, of_rov(odometry_link=link))
    record = decode_native(received[0])
    assert isinstance(record, Odometry)
    assert record.position_m is not None
    assert record.position_m.tolist() == [1.5, 2.0, -3.0]
    assert record.stamp_ns == 10 * S + 500
    assert record.velocity_mps is not None
    assert record.velocity_mps.tolist() == [0.5, 0.0, 0.0]


def test_fast_odometry_of_a_publisher_that_is_not_reliable_is_passed_on_whole() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as daemon:
        daemon.bind(("127.0.0.1", 0))
        daemon.setblocking(False)  # noqa: FBT003 the call's own form
        link = f"udp://127.0.0.1:{daemon.getsockname()[1]}"
        places: list[float] = []

        def receive() -> list[float]:
            with contextlib.suppress(BlockingIOError):
                while True:
                    record = decode_native(daemon.recv(4096))
                    assert isinstance(record, Odometry)
                    assert record.position_m is not None
                    places.append(float(record.position_m[0]))
            return places

        async def act(_: BridgeStream, heard: Heard) -> None:
            while not receive():  # until they match
                heard.ask("fast_odometry", number=1)
                await asyncio.sleep(0.1)
            await asyncio.sleep(0.5)
            receive()
            places.clear()
            heard.ask("fast_odometry", number=150)
            await until(lambda: 149.0 in receive())

        config = of_rov(odometry_link=link)
        topics = msgspec.structs.replace(config.topics, odometry="/fast/odometry")
        beside_ros(act, msgspec.structs.replace(config, topics=topics))
    assert places == [float(number) for number in range(150)]


def test_the_name_of_the_odometry_link_is_looked_up_once_and_beside_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    threads: list[int] = []
    numeric = socket.getaddrinfo

    def look_up(host: str, port: int, *args: Any, **fields: Any) -> Any:
        if host == "daemon.test":
            threads.append(threading.get_ident())
            found = numeric("127.0.0.1", port, *args, **fields)
            return [(socket.AF_INET6, *found[0][1:4], ("::1", port, 0, 0)), *found]
        return numeric(host, port, *args, **fields)

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as daemon:
        daemon.bind(("127.0.0.1", 0))
        daemon.setblocking(False)  # noqa: FBT003 the call's own form
        received: list[bytes] = []

        async def act(_: BridgeStream, heard: Heard) -> None:
            for _attempt in range(300):
                heard.ask("odometry", x_m=1.5)
                await asyncio.sleep(0.1)
                with contextlib.suppress(BlockingIOError):
                    received.append(daemon.recv(4096))
                if len(received) == 3:
                    return

        beside_ros(act, of_rov(odometry_link=f"udp://daemon.test:{daemon.getsockname()[1]}"))
    assert len(received) == 3
    assert len(threads) == 1
    assert threads[0] != threading.get_ident()


@pytest.mark.parametrize(
    ("link", "text"), [("udp://daemon.invalid:5", "not known"), ("udp://daemon", "lacks a host")]
)
def test_an_odometry_link_that_leads_nowhere_is_one_line(
    link: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def look_up(*_: Any, **__: Any) -> Any:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    with pytest.raises(ConfigError, match=rf"ros2.odometry_link: {link}: .*{text}"):
        asyncio.run(serve(BridgeStream(), of_rov(odometry_link=link), print))


def refused(*_: Any, **__: Any) -> Any:
    raise DDSException(DDSException.DDS_RETCODE_OUT_OF_RESOURCES, "while it did something")


def test_errors_of_dds_are_counted_and_a_few_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    node = DdsNode(DOMAIN, "rov", lines.append)
    odometry = node.publisher("a", "nav_msgs/msg/Odometry")
    poses = node.subscriber("b", "nav_msgs/msg/Odometry")
    service = node.service("c", "std_srvs/Empty")
    messages = Messages(node.types.classes)
    message = messages.odometry(T0, "odom", "base", AT_REST)
    for kind, name in (
        (DataWriter, "write"),
        (DataWriter, "get_matched_subscriptions"),
        (DataReader, "take"),
        (DataReader, "get_matched_publications"),
    ):
        monkeypatch.setattr(kind, name, refused)
    for _ in range(150):
        assert not odometry.publish(message)
    assert odometry.readers == poses.writers == 0
    assert [*poses.take(5), *service.take(5)] == []
    service.answer(SimpleNamespace(guid=1, seq=2), structure_needs_at_least_one_member=0)
    assert {name: count for (name, _), count in node.errors.counts.items()} == {
        "/rov/a": 151,
        "/rov/b": 2,
        "/rov/c": 2,
    }
    why = "Operation failed because of a lack of resources"
    assert lines == [
        f"ROS 2: /rov/a: {why}",
        f"ROS 2: /rov/a: {why}; 10 errors of this kind",
        f"ROS 2: /rov/a: {why}; 100 errors of this kind",
    ]
    node.close()


def test_a_bridge_goes_on_after_errors_of_dds(monkeypatch: pytest.MonkeyPatch) -> None:
    async def act(stream: BridgeStream, heard: Heard) -> None:
        stream.feed(SETTINGS)
        with monkeypatch.context() as broken:
            for kind, name in ((DataWriter, "write"), (DataReader, "take")):
                broken.setattr(kind, name, refused)
            stream.feed(APPEARED)
            await until(lambda: any("100 errors of this kind" in line for line in heard.lines))
        while not heard["/rosout"]:
            stream.feed(APPEARED)
            await asyncio.sleep(0.1)

    heard = beside_ros(act, of_rov(commands=True))
    assert sum("lack of resources" in line for line in heard.lines) in (3, 4)


def test_a_topic_that_dds_refuses_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapperd.bridges.dds.Topic", refused)
    with pytest.raises(LiveError, match=r"ROS 2: /tf cannot be opened: .*lack of resources"):
        asyncio.run(serve(BridgeStream(), of_rov(), print))


def test_a_peer_in_another_domain_hears_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapperd.bridges.ros2.ALONE_S", 0.3)

    async def act(stream: BridgeStream, heard: Heard) -> None:
        feed_everything(stream)
        await until(lambda: any("nobody subscribes" in line for line in heard.lines))
        await asyncio.sleep(1.0)

    heard = beside_ros(act, peer_domain=DOMAIN + 1)
    assert heard.messages == {}
    assert sum("nobody subscribes" in line for line in heard.lines) == 1


async def beside_late_peers(number: int, act: Callable[[list[str]], Awaitable[None]]) -> list[str]:
    """Run a bridge with a map; peers come and go one after the other, beside the bridge's lines."""
    stream, lines = BridgeStream(), list[str]()
    feed_everything(stream)
    serving = asyncio.create_task(serve(stream, of_rov(), lines.append))
    try:
        for _ in range(number):
            await act(lines)
    finally:
        serving.cancel()
        await asyncio.wait((serving,))
    return lines


def test_a_peer_that_comes_late_gets_the_map_and_one_that_goes_is_a_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mapperd.bridges.ros2.ALONE_S", 0.0)

    async def run() -> None:
        async def act(lines: list[str]) -> None:
            def last() -> str:
                return next((line for line in reversed(lines) if "subscribe" in line), "")

            late = Heard()
            async with late.listening(DOMAIN):
                await until(lambda: late["/map"] and late["/rov/my_cloud"])
                await until(lambda: "have subscribers" in last())
            assert len(late["/map"]) == 1
            # The next peer comes once the bridge knows that this one has gone.
            await until(lambda: "nobody subscribes" in last())

        lines = await beside_late_peers(2, act)
        assert sum("have subscribers" in line for line in lines) == 2
        assert sum("nobody subscribes" in line for line in lines) in (2, 3)  # at the beginning too

    asyncio.run(asyncio.wait_for(run(), 60))


COMES_AND_GOES = """
import sys
from cyclonedds.core import Qos, Policy
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
sys.path.insert(0, sys.argv[3])
from ros_peer import LATCHED, OccupancyGrid
for number in range(int(sys.argv[2])):
    participant = DomainParticipant(int(sys.argv[1]))
    reader = DataReader(participant, Topic(participant, "rt/map", OccupancyGrid, qos=LATCHED))
    while not reader.get_matched_publications():
        pass
    del reader, participant
"""


@pytest.mark.parametrize("peers", [30, pytest.param(10_000, marks=pytest.mark.slow)])
@pytest.mark.timeout(3600)
def test_peers_that_come_and_go_leave_nothing_behind(peers: int) -> None:
    async def run() -> None:
        sizes: list[int] = []

        async def act(_: list[str]) -> None:
            words = ["-c", COMES_AND_GOES, str(DOMAIN), str(peers), str(PEER.parent)]
            process = await asyncio.create_subprocess_exec(sys.executable, *words)
            assert await process.wait() == 0
            gc.collect()
            sizes.append(resident_bytes())

        await beside_late_peers(2, act)
        assert sizes[1] - sizes[0] < 16e6

    asyncio.run(run())


def test_the_daemon_that_is_lost_and_found_is_a_line_each(short: Path) -> None:
    """As a program, which waits for the daemon."""

    async def run() -> None:
        code = "import sys; from mapperd.cli.mapperctl.command import main; sys.exit(main())"
        given = ["ros2", "--domain", str(DOMAIN), "--socket", str(short / "m.sock")]
        program = await asyncio.create_subprocess_exec(
            sys.executable,
            "-c",
            code,
            *given,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        served = Served(status_s=0.05)
        served.put((0, 0, 0), a_block(1))
        late = Heard()

        def hellos(number: int) -> bool:
            return len(served.hellos) >= number

        def heard(text: str) -> bool:
            return any(text in one["msg"] for one in late["/rosout"])

        for number, text in enumerate(("first", "second"), 1):
            async with Server(served, short / "m.sock") as server, late.listening(DOMAIN):
                await until(partial(hellos, number))
                await until(lambda: late["/map"])
                event = {"number": 1, "t_s": 1.0, "severity": "info", "code": "c", "text": text}
                server.connections[-1].send(EventMessage(event=event))
                await until(partial(heard, text))
        program.send_signal(signal.SIGTERM)
        out, err = await program.communicate()
        assert (program.returncode, err) == (0, b"")
        lines = out.decode().splitlines()
        assert sum(": connected" in line for line in lines) == 2
        assert sum(": waiting" in line for line in lines) in (2, 3)

    asyncio.run(asyncio.wait_for(run(), 60))


@pytest.mark.parametrize("reconnects", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_reconnects_to_the_daemon_leave_nothing_behind(reconnects: int) -> None:
    lines: list[str] = []
    stream = BridgeStream()
    node = DdsNode(DOMAIN, "rov")
    bridge = Ros2Bridge(stream, of_rov(), node, lines.append)
    bridge.heard = frozenset(TOPICS)

    def reconnect(number: int) -> None:
        changes = (
            linked("waiting", f"reason {number}"),
            stream.connect(f"s-{number}"),
            began(),
            sure(),
            a_pose(number),
            IMAGE,
            a_ping(number),
            APPEARED,
            a_status("no_sonar"),
        )
        for change in changes:
            stream.feed(change)
            bridge.take(change)
        while stream.unread:
            stream.forget()

    for number in range(1100):  # rosout keeps the newest thousand
        reconnect(number)
    del lines[:]
    gc.collect()
    before = resident_bytes()
    for number in range(reconnects):
        reconnect(number)
        if number % 100 == 0:
            del lines[:]
    gc.collect()
    after = resident_bytes()
    node.close()
    assert after - before < 8e6


@pytest.mark.parametrize(
    ("config", "environ", "domain"),
    [
        (Config(), {}, 0),
        (Config(), {"ROS_DOMAIN_ID": "42"}, 42),
        (of_rov(domain=7), {"ROS_DOMAIN_ID": "42"}, 7),
        (of_rov(domain=0), {"ROS_DOMAIN_ID": "42"}, 0),
    ],
)
def test_the_domain_is_that_of_the_settings_or_of_ros(
    config: Config, environ: dict[str, str], domain: int
) -> None:
    assert domain_of(config, environ) == domain


@pytest.mark.parametrize("text", ["233", "-1", "one", "1.0"])
def test_a_wrong_domain_is_one_line(text: str) -> None:
    with pytest.raises(ConfigError, match=r"ROS_DOMAIN_ID: .*allowed: 0 to 232"):
        domain_of(Config(), {"ROS_DOMAIN_ID": text})


def test_names_are_those_of_ros() -> None:
    assert full_name("", "/tf") == full_name("rov", "/tf") == "/tf"
    assert full_name("rov", "map") == full_name("/rov/", "map") == "/rov/map"
    assert full_name("", "mapperd/ping") == "/mapperd/ping"


def test_names_of_topics_and_services_are_settings() -> None:
    text = "ros2: {domain: 5, namespace: rov, remap: '/tf:=tf mapperd/reset:=/reset here:=there'}"
    ros2 = config_from_text(text, "").ros2
    node = DdsNode(DOMAIN, ros2.namespace, print, ros2.remap)
    kind = "nav_msgs/msg/Odometry"
    assert node.publisher("/tf", kind).name == "/rov/tf"
    assert node.publisher("/tf_static", kind).name == "/tf_static"
    assert node.subscriber("/rov/here", kind).name == "/rov/there"
    assert node.service("mapperd/reset", "std_srvs/Trigger").name == "/reset"
    node.close()


@pytest.mark.parametrize("rules", ["/tf", "/tf:=", "a:=b,c:=d", "a:=b c", "a:=1b", "a:=b  c:=d"])
def test_a_wrong_rule_for_names_is_refused(rules: str) -> None:
    with pytest.raises(ConfigError, match="FROM:=TO"):
        config_from_text(f"ros2: {{remap: '{rules}'}}", "")


def test_two_vehicles_in_one_domain_do_not_mix() -> None:
    """The peer hears only the vehicle whose names are those of ROS."""
    rules = " ".join(f"{name}:={name[1:]}" for name in KINDS if not name.startswith("/rov/"))

    async def act(stream: BridgeStream, heard: Heard) -> None:
        other = BridgeStream()
        serving = asyncio.create_task(
            serve(other, of_rov(namespace="other", remap=rules), heard.lines.append)
        )
        for one, yaw_rad in ((other, 1.0), (stream, 0.3)):
            feed_everything(one)
            for _ in range(10):
                one.feed(sure())
                one.feed(a_pose(0.0, yaw_rad=yaw_rad))
        while len(heard["/tf"]) < 5:
            for one, yaw_rad in ((other, 1.0), (stream, 0.3)):
                one.feed(a_pose(0.0, yaw_rad=yaw_rad))
            await asyncio.sleep(0.1)
        serving.cancel()
        await asyncio.wait((serving,))

    heard = beside_ros(act)
    for message in heard["/tf"]:
        for one in message["transforms"]:
            if one["child_frame_id"] == "base_link":
                _, turn = pose_of(one["transform"])
                assert turn.as_euler("ZYX")[0] == pytest.approx(0.3)


def test_type_hashes_are_those_that_ros_computes() -> None:
    """Of REP-2016, as Jazzy prints them."""
    known = "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
    assert RosTypes().hash_of("sensor_msgs/msg/PointCloud2") == known


class Recorded:
    """Stands for a node: keeps what is published, by topic."""

    def __init__(self) -> None:
        self.types = RosTypes()
        self.sent: dict[str, list[Any]] = {}
        self.refused: set[str] = set()

    def publisher(self, name: str, *_: object) -> "Recorded":
        one = Recorded.__new__(Recorded)
        one.name, one.sent, one.refused = name, self.sent, self.refused  # type: ignore[attr-defined]
        return one

    @property
    def readers(self) -> int:
        return 1

    def publish(self, message: Any, _rows: object = None) -> bool:
        if self.name in self.refused:  # type: ignore[attr-defined]
            return False
        self.sent.setdefault(self.name, []).append(message)  # type: ignore[attr-defined]
        return True


def published(*changes: Any) -> dict[str, list[Any]]:
    stream, node = BridgeStream(), Recorded()
    bridge = Ros2Bridge(stream, Config(), node, print)  # type: ignore[arg-type]

    async def run() -> None:
        for change in changes:
            stream.feed(change)
            bridge.take(change)
            await bridge.tick(1.0)

    bridge.heard = frozenset(TOPICS)
    asyncio.run(run())
    return node.sent


LOCALIZES = a_status(localization={"state": "localized"})


def test_where_the_daemon_maps_by_odometry_its_map_is_in_that_frame() -> None:
    stream_of_map = BridgeStream()
    feed_map(stream_of_map)
    key = np.array([[1, -1, 0]], np.int32)
    by_odometry = a_pose(source="odometry")
    sent = published(LOCALIZES, sure(map_odom=CORRECTION), by_odometry, MapChanged(key, T0, 0))
    assert sent["/sonar_3d_map"][-1].header.frame_id == "odom"
    (odometry,) = sent["mapperd/odometry"]
    assert odometry.pose.pose.position.x == 1.0
    corrected = published(LOCALIZES, sure(), a_pose(), MapChanged(key, T0, 0))
    assert corrected["/sonar_3d_map"][-1].header.frame_id == "map"


def test_a_heartbeat_without_a_status_changes_nothing() -> None:
    by_odometry, change = a_pose(source="odometry"), MapChanged(np.zeros((0, 3), int), T0, 0)
    assert "/tf" not in published(beat(), by_odometry)
    sent = published(LOCALIZES, by_odometry, beat(), by_odometry, change)
    assert "/tf" not in sent  # the state of localization has not come yet
    assert sent["/sonar_3d_map"][-1].header.frame_id == "odom"
    sonar = a_status(sonar={"speed_of_sound_mps": 1480.0})
    assert published(sonar, beat(), IMAGE)["mapperd/ping"][-1].ping_info.sound_speed == 1480.0


def test_a_new_connection_begins_with_an_unknown_state() -> None:
    lost = linked("waiting", "gone"), linked("connected")
    by_odometry = a_pose(source="odometry")
    off = a_status(localization=None, sonar={"speed_of_sound_mps": 1480.0})
    assert len(published(off, by_odometry)["/tf"]) == 2
    sent = published(off, *lost, by_odometry, IMAGE)
    assert "/tf" not in sent
    assert sent["mapperd/ping"][-1].ping_info.sound_speed == 0.0


def test_the_map_comes_again_when_its_frame_changes() -> None:
    stream, node = BridgeStream(), Recorded()
    bridge = Ros2Bridge(stream, of_rov(), node, print)  # type: ignore[arg-type]
    feed_map(stream)

    async def run() -> None:
        by_odometry = a_pose(source="odometry")
        changes: list[Any] = [began(), LOCALIZES, by_odometry, by_odometry]
        for number, change in enumerate(changes):
            bridge.take(change)
            await bridge.tick(100.0 * number)

    asyncio.run(run())
    assert [one.header.frame_id for one in node.sent["my_cloud"]] == ["map", "odom"]


def test_a_mounting_that_could_not_be_written_is_published_again() -> None:
    node = Recorded()
    bridge = Ros2Bridge(BridgeStream(), of_rov(), node, print)  # type: ignore[arg-type]
    node.refused.add("/tf_static")
    bridge.take(sure())
    bridge.take(a_pose())
    node.refused.clear()
    bridge.take(a_pose(1.0))
    bridge.take(a_pose(2.0))
    assert len(node.sent["/tf_static"]) == 1


def test_a_map_that_could_not_be_written_is_published_again() -> None:
    stream, node = BridgeStream(), Recorded()
    bridge = Ros2Bridge(stream, of_rov(), node, print)  # type: ignore[arg-type]
    feed_map(stream)
    topics = {"my_cloud", "/map", "/sonar_3d_map_markers"}

    async def run() -> None:
        node.refused.update(topics)
        changes: list[Any] = [began(), MapChanged(np.array([[1, -1, 0]], np.int32), T0, 0)]
        for change in (*changes, a_status(), ROBOTS):
            bridge.take(change)
        await bridge.tick(100.0)
        assert not topics & {*node.sent}
        node.refused.clear()
        await bridge.tick(200.0)
        await bridge.tick(300.0)

    asyncio.run(run())
    assert {name: len(node.sent[name]) for name in topics} == dict.fromkeys(topics, 1)
    assert node.sent["my_cloud"][0].width == 2


def test_a_slice_follows_the_depth_and_waits_for_a_pose() -> None:
    stream, node = BridgeStream(), Recorded()
    bridge = Ros2Bridge(stream, of_rov(slice_height=1.0), node, print)  # type: ignore[arg-type]
    feed_map(stream)  # occupied cells at z 0.25 and 1.25, free ones at 0.25
    now_s = 0.0

    async def occupied(z_m: float | None, *changes: Any) -> list[list[int]]:
        nonlocal now_s
        now_s += 100
        before = len(node.sent.get("/map", ()))
        poses = [] if z_m is None else [a_pose(now_s, (1.0, 2.0, z_m))]
        for change in (*changes, *poses):
            bridge.take(change)
        await bridge.tick(now_s)
        grids = node.sent.get("/map", [])[before:]
        return [np.flatnonzero(one.data == 100).tolist() for one in grids]

    async def run() -> None:
        changed = MapChanged(np.array([[1, -1, 0]], np.int32), T0, 0)
        assert await occupied(None, sure(), changed) == []
        assert len(node.sent["my_cloud"]) == 1
        assert await occupied(0.25) == [[0]]
        assert await occupied(0.7) == []  # less than a cell
        assert await occupied(0.76) == [[2]]
        assert await occupied(9.0) == [[]]
        assert await occupied(None, linked("waiting", "gone"), linked("connected"), changed) == []
        assert await occupied(0.25) == [[0]]

    asyncio.run(run())


def test_a_reader_that_does_not_keep_up_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def late(*_: Any) -> None:
        raise DDSException(DDSException.DDS_RETCODE_TIMEOUT, "while it wrote")

    lines: list[str] = []
    node = DdsNode(DOMAIN, "rov", lines.append)
    odometry = node.publisher("a", "nav_msgs/msg/Odometry")
    message = Messages(node.types.classes).odometry(T0, "odom", "base", AT_REST)
    monkeypatch.setattr(DataWriter, "write", late)
    for _ in range(3):
        assert not odometry.publish(message)
    assert lines == ["ROS 2: a subscriber of /rov/a does not keep up"]
    assert not node.errors.counts
    node.close()


def test_a_reset_replaces_the_grid_that_readers_hold() -> None:
    stream, node = BridgeStream(), Recorded()
    bridge = Ros2Bridge(stream, of_rov(), node, print)  # type: ignore[arg-type]

    async def run() -> None:
        now_s = 0.0

        async def publish(*changes: Any) -> None:
            nonlocal now_s
            for change in changes:
                bridge.take(change)
            now_s += 100.0
            await bridge.tick(now_s)

        await publish(began())
        assert "/map" not in node.sent  # nobody holds one
        feed_map(stream)
        await publish(MapChanged(np.array([[1, -1, 0]], np.int32), T0, 0))
        assert stream.mirror is not None
        stream.mirror.begin(INFO, Interest())
        await publish(a_status(at_s=9.0), began())
        await publish(began())

    asyncio.run(run())
    full, empty = node.sent["/map"]
    assert (full.data == 100).sum() == 2
    assert (empty.info.width, empty.info.height, empty.data.tolist()) == (1, 1, [-1])
    assert empty.info.resolution == 0.5
    assert empty.header.stamp.sec == T0 // S + 9


def test_corrections_move_the_frame_of_the_odometry_and_not_the_vehicle_in_it() -> None:
    """The daemon corrects at every ping; its reports are rarer."""
    changes: list[Any] = [LOCALIZES]
    corrections = [Rotation.from_euler("Z", 0.02 * (number // 3)) for number in range(20)]
    places: list[np.ndarray] = []
    for number, correction in enumerate(corrections):
        at_s, odom = number / 10, np.array([number / 10, 2.0, -5.0])
        places.append(correction.apply(odom) + np.array([0.3 * (number // 3), 0.0, 0.0]))
        if number % 5 == 0:
            changes.append(sure())  # of an earlier correction
        x, y, z = places[-1].tolist()
        place = {"odom_position_m": tuple(odom.tolist()), "odom_orientation_xyzw": (0, 0, 0, 1)}
        yaw_rad = float(correction.as_euler("ZYX")[0])
        changes.append(a_pose(at_s, (x, y, z), yaw_rad, **place))
    sent = published(*changes)
    transforms = [one for message in sent["/tf"] for one in message.transforms]
    by_child: dict[str, list[Any]] = {"odom": [], "base_link": []}
    for one in transforms:
        by_child[one.child_frame_id].append(one)
    steps = np.diff([one.transform.translation.x for one in by_child["base_link"]])
    np.testing.assert_allclose(steps, 0.1)
    for number, (odom, base) in enumerate(zip(*by_child.values(), strict=True)):
        shift, turn = vector(odom.transform.translation), turn_of(odom.transform.rotation)
        assert turn.apply(vector(base.transform.translation)) + shift == pytest.approx(
            places[number]
        )
        assert odom.header.stamp.sec * S + odom.header.stamp.nanosec == T0 + number * S // 10 + S
    steps = np.diff([one.pose.pose.position.x for one in sent["mapperd/odometry"]])
    np.testing.assert_allclose(steps, 0.1)
    assert sent["mapperd/odometry"][-1].twist.twist.linear.x == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("source", "has_odometry"),
    [("localization", True), ("localization", False), ("odometry", False)],
)
def test_a_transform_of_the_map_ends_with_the_reports(source: str, *, has_odometry: bool) -> None:
    stream, node, now_s = BridgeStream(), Recorded(), [10.0]
    bridge = Ros2Bridge(stream, Config(), node, print, lambda: now_s[0])  # type: ignore[arg-type]
    bridge.heard = frozenset(TOPICS)
    odom: dict[str, Any] = {
        "odom_position_m": (5.0, 0.0, 0.0),
        "odom_orientation_xyzw": (0.0, 0.0, 0.0, 1.0),
    }
    place = odom if has_odometry else {}

    def children() -> list[str]:
        node.sent.clear()
        bridge.take(a_pose(source=source, **place))
        return [one.child_frame_id for each in node.sent.get("/tf", ()) for one in each.transforms]

    def level() -> int:
        bridge.take(LOCALIZES)
        return int(node.sent["/diagnostics"][-1].status[1].level)

    stream.feed(LOCALIZES)
    bridge.take(sure())
    now_s[0] += 2.9
    assert (children(), level()) == (["base_link", "odom"], 0)
    now_s[0] += 0.2
    is_known = has_odometry or source == "odometry"
    assert (children(), level()) == (["base_link"] if is_known else [], 3)
    bridge.take(sure())
    assert (children(), level()) == (["base_link", "odom"], 0)


def vector(message: Any) -> np.ndarray:
    return np.array([message.x, message.y, message.z])


def turn_of(message: Any) -> Rotation:
    return Rotation.from_quat([message.x, message.y, message.z, message.w])


def test_no_transform_of_the_map_is_invented_while_the_vehicle_is_not_localized() -> None:
    waiting = sure(state="waiting for a pose", pose=None, map_odom=None)
    sent = published(LOCALIZES, waiting, a_pose(source="odometry"))
    (message,) = sent["/tf"]
    assert [one.child_frame_id for one in message.transforms] == ["base_link"]
    unknown = published(LOCALIZES, a_pose())
    assert "/tf" not in unknown


def test_settings_switch_transforms_off() -> None:
    off = {
        "amcl.tf_broadcast": {"value": False},
        "frames.publish_tf": {"value": False},
        "frames.base": {"value": "rov"},
    }
    sent = published(SettingsMessage(facts=off), sure(), a_pose())
    assert "/tf_static" not in sent
    (message,) = sent["/tf"]
    assert [one.child_frame_id for one in message.transforms] == ["rov"]
