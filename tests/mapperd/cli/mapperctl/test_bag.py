"""`mapperctl bag`: recordings as ROS 2 bags, read back by rosbags' own reader."""

import math
import re
import sqlite3
import sys
from collections import defaultdict
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.typesys import Stores, get_typestore

from mapperd.cli.mapperd import main as mapperd
from mapperd.config.tree import Config, MountingConfig
from mapperd.mapping.sonar_map import SonarMap, mounting
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.recording import OCULUS, open_recording
from oculus_driver.stream import StreamParser
from tests.mapperd.conftest import BEAMS, ROWS, START_NS, make_odometry, make_ping
from tests.support.mapperctl import Call

IMAGE, ODOMETRY, CLOUD = "/sensor/sonar/oculus/m750d/image", "/fast_lio/odometry", "/sonar_3d_map"
HEADING_DEG = 30.0
VARIANCES = (0.01, 0.02, 0.03, 0.004, 0.005, 0.006)
Messages = dict[str, list[tuple[int, Any]]]


def upper(diagonal: tuple[float, ...]) -> tuple[float, ...]:
    full = np.diag(diagonal)
    return tuple(full[np.triu_indices(6)].tolist())


def dive(pings: int = 5, first: float = 0.05) -> list[tuple[str, bytes, float]]:
    """North-east by the compass at 0.5 m/s, 4 m deep, by records in NED and FRD."""
    north, east = math.cos(math.radians(HEADING_DEG)), math.sin(math.radians(HEADING_DEG))
    half = math.radians(HEADING_DEG) / 2
    events = []
    for k in range(pings + 1):
        record = make_odometry(
            w="ned",
            b="frd",
            p=(0.05 * k * north, 0.05 * k * east, 4.0),
            q=(math.cos(half), 0.0, 0.0, math.sin(half)),
            u=(0.5, 0.0, 0.0),
            pc=upper(VARIANCES),
        )
        events.append(("odometry", record, 0.1 * k))
        if k < pings:
            image = np.random.default_rng(k).integers(0, 30, (ROWS, BEAMS), np.uint8)
            image[30] = 200
            events.append(("ping", make_ping(k + 1, image=image), 0.1 * k + first))
    return events


@pytest.fixture
def recording(tmp_path: Path, write_recording: Callable[..., object]) -> Path:
    write_recording(tmp_path / "dive.mcap", dive())
    return tmp_path / "dive.mcap"


@pytest.fixture
def in_folder(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(recording.parent)


def read(bag: Path) -> Messages:
    """Log time and message of each message in a bag, by topic."""
    reported: Messages = defaultdict(list)
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, stamp_ns, data in reader.messages():
            reported[connection.topic].append(
                (stamp_ns, reader.deserialize(data, connection.msgtype))
            )
    return reported


def pings_in(recording: Path) -> list[Ping]:
    parser = StreamParser()
    found: list[Any] = []
    with open_recording(recording) as chunks:
        for chunk in chunks:
            if chunk.encoding == OCULUS:
                found += map(decode_ping, parser.feed(chunk.data, chunk.arrival_ns))
    return [one for one in found if isinstance(one, Ping)]


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def matrix(position: Any, rotation: Any) -> np.ndarray:
    """Of a transform of ROS: x, y, z, w, by Rodrigues' formula."""
    axis = np.array([rotation.x, rotation.y, rotation.z])
    cross = np.cross(np.eye(3), axis)
    found = np.eye(4)
    found[:3, :3] = np.eye(3) + 2 * rotation.w * cross + 2 * cross @ cross
    found[:3, 3] = position.x, position.y, position.z
    return found


def points_of(cloud: Any) -> np.ndarray:
    """Of a PointCloud2, by its fields."""
    kinds = {7: "<f4", 4: "<u2"}
    dtype = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [kinds[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    assert (cloud.height, cloud.row_step) == (1, cloud.point_step * cloud.width)
    return np.frombuffer(cloud.data.tobytes(), dtype)


def mapped(recording: Path, folder: Path, *words: str) -> SonarMap:
    """The map of an ordinary replay."""
    assert mapperd(["--replay", str(recording), "--out", str(folder), *words]) == 0
    sonar_map = SonarMap(Config())
    sonar_map.load_octomap((folder / "map.bt").read_bytes())
    return sonar_map


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_images_are_those_of_the_recording(
    tmp_path: Path, call: Call, recording: Path, storage: str
) -> None:
    bag = tmp_path / "bag"
    code, lines, _ = call("bag", recording, bag, "--storage", storage)
    assert code == 0
    assert (bag / "metadata.yaml").exists()
    assert [path.suffix for path in bag.iterdir() if path.stem == "bag"] == [
        {"mcap": ".mcap", "sqlite3": ".db3"}[storage]
    ]
    assert f"{IMAGE}: 5 messages" in lines
    pings, reported = pings_in(recording), read(bag)[IMAGE]
    assert len(pings) == len(reported) == 5
    for ping, (logged_ns, image) in zip(pings, reported, strict=True):
        assert (image.height, image.width, image.step) == (ROWS, BEAMS, BEAMS)
        assert (image.encoding, image.is_bigendian) == ("mono8", 0)
        assert image.data.tobytes() == ping.image.tobytes()
        assert image.header.frame_id == "sonar_link"
        stamp_ns = ping.echo_time_ns(ping.max_range_m / 2)
        assert logged_ns == stamp_of(image)
        assert stamp_ns is not None
        assert abs(stamp_ns - stamp_of(image)) < 5_000_000  # by the sonar's clock, not its arrival


def test_odometry_is_in_the_axes_of_ros(tmp_path: Path, call: Call, recording: Path) -> None:
    call("bag", recording, tmp_path / "bag")
    reported = read(tmp_path / "bag")
    yaw = math.radians(90 - HEADING_DEG)
    assert [stamp for stamp, _ in reported[ODOMETRY]] == [stamp for stamp, _ in reported[IMAGE]]
    for stamp_ns, message in reported[ODOMETRY]:
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        pose, twist = message.pose.pose, message.twist.twist
        way_m = 0.5 * (stamp_ns - START_NS) / 1e9
        assert pose.position.x == pytest.approx(way_m * math.cos(yaw), abs=1e-9)
        assert pose.position.y == pytest.approx(way_m * math.sin(yaw), abs=1e-9)
        assert pose.position.z == pytest.approx(-4.0)
        found = np.array(
            [pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w]
        )
        assert np.abs(found) == pytest.approx([0, 0, math.sin(yaw / 2), math.cos(yaw / 2)])
        assert found[2] * found[3] > 0
        assert (twist.linear.x, twist.linear.y) == pytest.approx((0.5, 0.0), abs=1e-6)
        assert np.diag(message.twist.covariance.reshape(6, 6)).tolist() == [1e6] * 6
        covariance = message.pose.covariance.reshape(6, 6)
        east, north = VARIANCES[1], VARIANCES[0]
        assert np.diag(covariance)[:3] == pytest.approx([east, north, VARIANCES[2]])
        assert np.diag(covariance)[3:] == pytest.approx([0.005, 0.004, 0.006])
        assert np.abs(covariance - covariance.T).max() < 1e-12


def test_vehicle_that_stands_still(tmp_path: Path, call: Call, recording: Path) -> None:
    call("bag", recording, tmp_path / "still", "--pose", "1,2,3,0,0,90")
    (_, message), *_ = read(tmp_path / "still")[ODOMETRY]
    assert (message.twist.twist.linear.x, message.twist.twist.angular.z) == (0.0, 0.0)
    assert message.pose.pose.position.y == 2.0
    assert message.pose.pose.orientation.w == pytest.approx(math.sqrt(0.5))


def test_transforms_lead_from_the_map_to_the_sonar(
    tmp_path: Path, call: Call, recording: Path
) -> None:
    settings = tmp_path / "a.yaml"
    settings.write_text(
        "mounting: {position: {x: 0.3, y: 0.1, z: -0.2}, orientation: {pitch: 40, yaw: 10}}\n"
        "frames: {map: world, sonar: eye}\n",
        encoding="utf-8",
    )
    call("bag", recording, tmp_path / "bag", "--config", settings)
    reported = read(tmp_path / "bag")
    ((_, static),) = reported["/tf_static"]
    (sits,) = static.transforms
    assert (sits.header.frame_id, sits.child_frame_id) == ("base_link", "eye")
    position = {"x": 0.3, "y": 0.1, "z": -0.2}
    set_so = Config(mounting=MountingConfig(**_mounting(position, {"pitch": 40.0, "yaw": 10.0})))
    assert np.abs(
        matrix(sits.transform.translation, sits.transform.rotation) - mounting(set_so)
    ).max() == pytest.approx(0.0, abs=1e-12)
    for (_, frames), (_, odometry) in zip(reported["/tf"], reported[ODOMETRY], strict=True):
        base, odom = frames.transforms
        assert (base.header.frame_id, base.child_frame_id) == ("odom", "base_link")
        assert (odom.header.frame_id, odom.child_frame_id) == ("world", "odom")
        pose = odometry.pose.pose
        there = matrix(base.transform.translation, base.transform.rotation)
        assert np.abs(there - matrix(pose.position, pose.orientation)).max() < 1e-12
        same = matrix(odom.transform.translation, odom.transform.rotation)
        assert np.abs(same - np.eye(4)).max() < 1e-12
        assert stamp_of(base) == stamp_of(odometry)


def _mounting(position: dict[str, float], angles: dict[str, float]) -> dict[str, Any]:
    sections = MountingConfig()
    return {
        "position": type(sections.position)(**position),
        "orientation": type(sections.orientation)(**angles),
    }


@pytest.mark.usefixtures("no_picture")
def test_map_is_that_of_an_ordinary_replay(tmp_path: Path, call: Call, recording: Path) -> None:
    call("bag", recording, tmp_path / "bag")
    reported = read(tmp_path / "bag")
    sonar_map = mapped(recording, tmp_path / "out")
    ((cloud_ns, cloud),), ((_, grid),) = reported[CLOUD], reported["/map"]
    assert cloud_ns == reported[IMAGE][-1][0]
    points = points_of(cloud)
    found = np.stack([points["x"], points["y"], points["z"]], axis=1)
    expected = sonar_map.voxels("occupied").centres_m.astype(np.float32)
    assert len(found) > 50
    assert (found[np.lexsort(found.T)] == expected[np.lexsort(expected.T)]).all()
    assert (points["intensity"] > 0.7).all()
    assert (points["count"] >= 1).all()
    classes: dict[tuple[int, int], int] = {}
    for kind, value in (("free", 0), ("occupied", 100)):
        centres_m = sonar_map.voxels(kind).centres_m  # type: ignore[arg-type]
        for x, y in np.floor(centres_m[:, :2] / 0.05).astype(int).tolist():
            classes[x, y] = max(value, classes.get((x, y), 0))
    origin, edge_m = grid.info.origin, grid.info.resolution
    assert (edge_m, origin.orientation.w) == (pytest.approx(0.05), 1.0)
    cells = grid.data.reshape(grid.info.height, grid.info.width)
    west, south = round(origin.position.x / 0.05), round(origin.position.y / 0.05)
    seen = {
        (west + int(column), south + int(row)): int(cells[row, column])
        for row, column in np.argwhere(cells >= 0)
    }
    assert seen == classes


def test_cloud_is_sent_again_and_again(tmp_path: Path, call: Call, recording: Path) -> None:
    call("bag", recording, tmp_path / "bag", "--every", "0.15")
    clouds = read(tmp_path / "bag")[CLOUD]
    assert len(clouds) == 3  # of the third ping, the fifth, and the end
    sizes = [cloud.width for _, cloud in clouds]
    assert all(early <= late for early, late in pairwise(sizes))
    assert sizes[0] > 0


def test_maps_and_fixed_frames_are_kept_for_those_who_come_late(
    tmp_path: Path, call: Call, recording: Path
) -> None:
    call("bag", recording, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        kept = {
            connection.topic: connection.ext.offered_qos_profiles[0].durability  # type: ignore[union-attr]
            for connection in reader.connections
        }
    late = {topic for topic, output in kept.items() if output is QosDurability.TRANSIENT_LOCAL}
    assert late == {"/tf_static", CLOUD, "/map"}


def test_ping_without_a_pose_has_its_image_all_the_same(
    tmp_path: Path, call: Call, write_recording: Callable[..., object]
) -> None:
    write_recording(tmp_path / "a.mcap", [*dive(2), ("ping", make_ping(9), 60.0)])
    call("bag", tmp_path / "a.mcap", tmp_path / "bag")
    reported = read(tmp_path / "bag")
    assert (len(reported[IMAGE]), len(reported[ODOMETRY]), len(reported["/tf"])) == (3, 2, 2)


def test_samples_of_two_bytes_are_kept(
    tmp_path: Path, call: Call, write_recording: Callable[..., object]
) -> None:
    image = np.arange(ROWS * BEAMS, dtype=np.uint16).reshape(ROWS, BEAMS)
    write_recording(tmp_path / "a.mcap", [("ping", make_ping(1, image=image), 0.0)])
    call("bag", tmp_path / "a.mcap", tmp_path / "bag", "--pose", "0,0,0,0,0,0")
    ((_, reported),) = read(tmp_path / "bag")[IMAGE]
    assert (reported.encoding, reported.step, reported.is_bigendian) == ("mono16", 2 * BEAMS, 0)
    assert (reported.data.view("<u2").reshape(ROWS, BEAMS) == image).all()


def test_pings_without_a_time_are_reported(tmp_path: Path, call: Call) -> None:
    (tmp_path / "raw.oculus").write_bytes(make_ping(1) + make_ping(2) + make_ping(3))
    lines = call("bag", tmp_path / "raw.oculus", tmp_path / "bag", "--pose", "0,0,0,0,0,0")[1]
    assert re.match(r"3 pings\b", lines[-1])


def test_bag_that_is_there_is_left_alone(tmp_path: Path, call: Call, recording: Path) -> None:
    (tmp_path / "bag").mkdir()
    code, _, output = call("bag", recording, tmp_path / "bag")
    assert (code, list((tmp_path / "bag").iterdir())) == (73, [])
    assert "is there already" in output


@pytest.mark.parametrize(
    "error",
    [OSError(28, "No space left on device"), sqlite3.OperationalError("database or disk is full")],
)
def test_bag_of_what_fails_is_not_there(
    error: Exception,
    tmp_path: Path,
    call: Call,
    recording: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("rosbags.rosbag2.Writer.write", full)
    code, _, output = call("bag", recording, tmp_path / "bag")
    assert code == 73
    assert output.rstrip().endswith(str(error.args[-1]))
    assert [path.name for path in tmp_path.iterdir()] == ["dive.mcap"]


@pytest.mark.parametrize(
    ("words", "code", "reported"),
    [
        (["nowhere.mcap", "bag"], 66, "nowhere.mcap"),
        (["dive.mcap", "bag", "--as-recorded"], 2, "settings"),
        (["dive.mcap", "bag", "--as-recorded", "--pose", "0,0,0,0,0,0"], 2, "--as-recorded"),
        (["dive.mcap", "missing/bag"], 73, "No such file"),
    ],
)
@pytest.mark.usefixtures("in_folder")
def test_what_cannot_be_done_is_one_line(
    recording: Path, call: Call, words: list[str], code: int, reported: str
) -> None:
    assert (done := call("bag", *words))[0] == code
    assert reported in done[2]
    assert [path.name for path in recording.parent.iterdir()] == ["dive.mcap"]


def test_library_that_is_missing_is_reported_by_its_extra(
    tmp_path: Path, call: Call, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    code, _, output = call("bag", recording, tmp_path / "bag")
    assert code == 78
    assert "pip install 'rosbags" in output
