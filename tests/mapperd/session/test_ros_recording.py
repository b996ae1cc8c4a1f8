"""Sonar data in ROS bags: the map is that of the same pings in an ordinary recording."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mapperd.cli.mapperd import main
from mapperd.export.clouds import VERTEX
from mapperd.odometry.ros_bag import open_ros_bag
from mapperd.session.ros_recording import RosRecording
from oculus_driver.command_line import ExitCode
from oculus_driver.encode import encode_fire
from oculus_driver.errors import RecordingError
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.recording import OCULUS, RecordingWriter
from oculus_driver.recording.chunk import messages_of
from tests.mapperd.conftest import BEAMS, ROWS, START_NS, make_odometry, make_ping

Capture = pytest.CaptureFixture[str]
PINGS = 6
RESOLUTION_M, SPEED_MPS = 0.1, 1500.0
FLIGHT_NS = round(2 * ROWS * RESOLUTION_M / SPEED_MPS * 1e9)
STILL = "--pose=0,0,0,0,0,0"

DEFINITIONS = {
    "apl_msgs/msg/RawData": """
std_msgs/Header header
uint8 DATA_IN = 0
uint8 DATA_OUT = 1
uint8 direction
uint8[] data
""",
    "oculus_interfaces/msg/Ping": """
std_msgs/Header header
uint32 ping_id
uint32 ping_firing_date
float64 range
float64 gain_percent
float64 frequency
float64 speed_of_sound_used
float64 range_resolution
float64 temperature
float64 pressure
uint8 master_mode
bool has_gains
uint16 n_ranges
uint16 n_beams
uint32 step
uint8 sample_size
int16[] bearings
uint8[] ping_data
""",
    "marine_acoustic_msgs/msg/PingInfo": """
float32 frequency
float32 sound_speed
float32[] tx_beamwidths
float32[] rx_beamwidths
""",
    "marine_acoustic_msgs/msg/SonarImageData": """
bool is_bigendian
uint32 dtype
uint32 beam_count
uint8[] data
""",
    "marine_acoustic_msgs/msg/ProjectedSonarImage": """
std_msgs/Header header
marine_acoustic_msgs/PingInfo ping_info
geometry_msgs/Vector3[] beam_directions
float32[] ranges
marine_acoustic_msgs/SonarImageData image
""",
}
"""As their packages publish them."""


def typestore(kind: Stores = Stores.ROS2_HUMBLE) -> Any:
    store = get_typestore(kind)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


STORE = typestore()
TYPES: dict[str, Any] = dict(STORE.types)
RAW, PING = "apl_msgs/msg/RawData", "oculus_interfaces/msg/Ping"
IMAGE, ODOMETRY = "marine_acoustic_msgs/msg/ProjectedSonarImage", "nav_msgs/msg/Odometry"
VECTOR = TYPES["geometry_msgs/msg/Vector3"]
Events = list[tuple[str, int, Any]]


def header(t_ns: int, frame: str = "sonar") -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def image_of(k: int) -> Any:
    """A wall that is nearer to starboard."""
    image = np.zeros((ROWS, BEAMS), np.uint8)
    for beam in range(BEAMS):
        image[40 - beam // 4 : 42 - beam // 4, beam] = 200 - k
    return image


BEARINGS_CDEG = np.linspace(-6000, 6000, BEAMS).round().astype(np.int16)


def arrival_ns(k: int) -> int:
    return START_NS + 60_000_000 + k * 200_000_000


def ping(k: int, **changes: Any) -> bytes:
    fields = {"start_time": 0.0, "image": image_of(k), "bearings_cdeg": BEARINGS_CDEG}
    return make_ping(k + 1, **fields | changes)


def as_bytes(data: bytes) -> Any:
    return np.frombuffer(data, np.uint8)


def raw_messages(*, stamped: bool = True) -> Events:
    """The bytes as they were read from the socket: heads and bodies apart."""
    found: Events = []
    for k in range(PINGS):
        data, t_ns = ping(k), arrival_ns(k)
        fire = TYPES[RAW](header=header(t_ns - 9), direction=1, data=as_bytes(encode_fire()))
        found.append(("/raw", t_ns, fire))
        for part in (data[:16], data[16:]):
            stamp = header(t_ns if stamped else 0)
            message = TYPES[RAW](header=stamp, direction=0, data=as_bytes(part))
            found.append(("/raw", t_ns, message))
    return found


def ping_message(k: int, gains: Any) -> Any:
    rows = np.hstack([gains.view(np.uint8).reshape(ROWS, 4), image_of(k)])
    return TYPES[PING](
        header=header(arrival_ns(k)),
        ping_id=k + 1,
        ping_firing_date=0,
        range=5.0,
        gain_percent=50.0,
        frequency=750e3,
        speed_of_sound_used=SPEED_MPS,
        range_resolution=RESOLUTION_M,
        temperature=12.0,
        pressure=1.0,
        master_mode=1,
        has_gains=True,
        n_ranges=ROWS,
        n_beams=BEAMS,
        step=rows.shape[1],
        sample_size=1,
        bearings=BEARINGS_CDEG,
        ping_data=np.ascontiguousarray(rows).ravel(),
    )


def image_message(k: int, *, dtype: int = 0, kind: str = "u1", **changes: Any) -> Any:
    """As the driver of the sonar publishes it: rows of beams, azimuths to starboard."""
    angles = np.radians(BEARINGS_CDEG / 100.0)
    data = image_of(k).astype(kind) * (1 if kind == "u1" else 256)
    part = TYPES["marine_acoustic_msgs/msg/SonarImageData"](
        is_bigendian=kind.startswith(">"),
        dtype=dtype,
        beam_count=BEAMS,
        data=as_bytes(data.astype(kind).tobytes()),
    )
    info = TYPES["marine_acoustic_msgs/msg/PingInfo"](
        frequency=750e3,
        sound_speed=SPEED_MPS,
        tx_beamwidths=np.zeros(0, np.float32),
        rx_beamwidths=np.zeros(0, np.float32),
    )
    fields = {
        "header": header(arrival_ns(k) - FLIGHT_NS),
        "ping_info": info,
        "beam_directions": [VECTOR(x=0.0, y=-math.sin(a), z=math.cos(a)) for a in angles],
        "ranges": ((np.arange(ROWS) + 0.5) * RESOLUTION_M).astype(np.float32),
        "image": part,
    }
    return TYPES[IMAGE](**fields | changes)


def image_messages(**changes: Any) -> Events:
    return [("/sonar", arrival_ns(k), image_message(k, **changes)) for k in range(PINGS)]


def track() -> list[tuple[int, float, tuple[float, ...]]]:
    """Time, way to the east, and orientation of a vehicle that turns."""
    found: list[tuple[int, float, tuple[float, ...]]] = []
    for k in range(40):
        half = 0.005 * k
        wxyz = (math.cos(half), 0.0, 0.0, math.sin(half))
        found.append((START_NS + k * 50_000_000, 0.02 * k, wxyz))
    return found


def odometry_messages() -> Events:
    found: Events = []
    still = TYPES["geometry_msgs/msg/TwistWithCovariance"](
        twist=TYPES["geometry_msgs/msg/Twist"](
            linear=VECTOR(x=0.0, y=0.0, z=0.0), angular=VECTOR(x=0.0, y=0.0, z=0.0)
        ),
        covariance=np.zeros(36),
    )
    for t_ns, way_m, (w, x, y, z) in track():
        pose = TYPES["geometry_msgs/msg/Pose"](
            position=TYPES["geometry_msgs/msg/Point"](x=way_m, y=0.0, z=0.0),
            orientation=TYPES["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        )
        covariant = TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose, covariance=np.zeros(36)
        )
        message = TYPES[ODOMETRY](
            header=header(t_ns, "odom"), child_frame_id="base_link", pose=covariant, twist=still
        )
        found.append(("/odom", t_ns, message))
    return found


def write_bag(path: Path, messages: Iterable[tuple[str, int, Any]], storage: str = "mcap") -> Path:
    with Writer(path, version=8, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        links: dict[str, Any] = {}
        for topic, t_ns, message in sorted(messages, key=lambda one: one[1]):
            kind = message.__msgtype__
            if topic not in links:
                links[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(links[topic], t_ns, STORE.serialize_cdr(message, kind))
    return path


class Bench:
    """Runs the command, and maps the same pings of an ordinary recording."""

    def __init__(self, folder: Path, capsys: Capture) -> None:
        self.folder, self._capsys = folder, capsys
        self.config = folder / "a.yaml"
        self.config.write_text(
            "octree: {voxel_resolution: 0.1}\nmounting: {orientation: {pitch: 0}}\n"
        )

    def run(self, *words: object, out: str = "out") -> tuple[int, str]:
        self._capsys.readouterr()
        args = ["--config", self.config, "--out", self.folder / out, *words]
        return main([str(word) for word in args]), self._capsys.readouterr().err

    def map(self, *words: object, out: str = "out") -> dict[str, Any]:
        code, text = self.run(*words, out=out)
        assert code == ExitCode.OK, text
        summary: dict[str, Any] = json.loads((self.folder / out / "summary.json").read_text())
        assert summary["pings_mapped"] == summary["pings_total"] == PINGS, summary
        return summary

    def reference(self, **changes: Any) -> dict[str, Any]:
        events = [(arrival_ns(k), "sonar", ping(k, **changes)) for k in range(PINGS)]
        for t_ns, way_m, wxyz in track():
            record = make_odometry(clk="unix", t=t_ns, p=(way_m, 0.0, 0.0), q=wxyz)
            events.append((t_ns, "vehicle", record))
        with RecordingWriter(self.folder / "reference.mcap", overwrite=True) as writer:
            links = {
                "sonar": writer.add_link("sonar", OCULUS),
                "vehicle": writer.add_link("vehicle", "odometry-native"),
            }
            for t_ns, link, data in sorted(events):
                writer.write(links[link], data, t_ns)
        return self.map("--replay", self.folder / "reference.mcap", out="reference")

    def points(self, out: str = "out") -> Any:
        _, _, body = (self.folder / out / "map.ply").read_bytes().partition(b"end_header\n")
        vertices = np.frombuffer(body, dtype=VERTEX)
        return np.stack([vertices[name] for name in "xyz"], axis=1)

    def alike(self) -> float:
        """The part of the cells that both maps have."""
        ours, theirs = [
            set(map(tuple, np.floor(self.points(out) / 0.1).astype(int).tolist()))
            for out in ("out", "reference")
        ]
        return len(ours & theirs) / len(ours | theirs)


@pytest.fixture
def bench(tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setattr("mapperd.daemon.map_folder.write_picture", lambda *_: None)
    monkeypatch.setenv("XDG_CONFIG_HOME", "/none")
    return Bench(tmp_path, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_raw_bytes_give_the_same_map(bench: Bench, storage: str) -> None:
    bag = write_bag(bench.folder / "bag", [*raw_messages(), *odometry_messages()], storage)
    reference = bench.reference()
    (file,) = (one for one in bag.iterdir() if one.suffix in (".mcap", ".db3"))
    for path in (bag, file):
        summary = bench.map("--replay", path)
        assert summary["map_sha256"] == reference["map_sha256"]
        recording = summary["recording"]
        assert (recording["format"], recording["damage"]) == ("ros-bag", None)
        assert recording["bytes_read"] == recording["size_bytes"] > 0
        assert summary["bytes_rejected"] == 0


@pytest.mark.slow
def test_images_give_the_same_map(bench: Bench) -> None:
    bag = write_bag(bench.folder / "bag", [*image_messages(), *odometry_messages()])
    bench.map("--replay", bag)
    bench.reference()
    assert bench.alike() > 0.999
    assert len(bench.points()) > 500


def test_images_have_the_sonars_sides(bench: Bench) -> None:
    """The wall is nearest to starboard of a vehicle that looks along x."""
    bag = write_bag(bench.folder / "bag", image_messages())
    bench.map("--replay", bag, STILL)
    points = bench.points()
    distance = np.hypot(points[:, 0], points[:, 1])
    bearing = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    assert np.median(distance[bearing < -45]) < 3.0
    assert np.median(distance[bearing > 45]) > 3.5


@pytest.mark.parametrize(("dtype", "kind"), [(2, "<u2"), (2, ">u2"), (4, "<u4")])
def test_images_of_other_samples(bench: Bench, dtype: int, kind: str) -> None:
    bag = write_bag(bench.folder / "bag", image_messages(dtype=dtype, kind=kind))
    with RosRecording(bag) as recording:
        pings = [decode_ping(message) for message in messages_of(recording)]
    assert len(pings) == PINGS
    for k, one in enumerate(pings):
        assert isinstance(one, Ping)
        assert (one.image == image_of(k).astype(np.uint32) * 256).all()
        assert one.arrival_ns == pytest.approx(arrival_ns(k), rel=0, abs=100)
        assert one.ranges_m == pytest.approx((np.arange(ROWS) + 0.5) * RESOLUTION_M)
        assert np.degrees(one.bearings_rad) * 100 == pytest.approx(BEARINGS_CDEG)


def test_beams_from_starboard_to_port_are_reversed(bench: Bench) -> None:
    angles = np.radians(BEARINGS_CDEG / -100.0)
    beams = [VECTOR(x=0.0, y=-math.sin(a), z=math.cos(a)) for a in angles]
    bag = write_bag(bench.folder / "bag", image_messages(beam_directions=beams))
    with RosRecording(bag) as recording:
        (first, *_) = [decode_ping(message) for message in messages_of(recording)]
    assert isinstance(first, Ping)
    assert np.degrees(first.bearings_rad) * 100 == pytest.approx(BEARINGS_CDEG)
    assert (first.image == image_of(0)[:, ::-1]).all()


@pytest.mark.slow
def test_pings_of_the_other_driver(bench: Bench) -> None:
    gains = np.linspace(90, 110, ROWS).astype("<u4")
    messages = [("/ping", arrival_ns(k) + 9, ping_message(k, gains)) for k in range(PINGS)]
    bag = write_bag(bench.folder / "bag", [*messages, *odometry_messages()])
    summary = bench.map("--replay", bag)
    assert summary["map_sha256"] == bench.reference(gains=gains)["map_sha256"]


def test_raw_bytes_are_preferred_to_images(bench: Bench) -> None:
    bag = write_bag(bench.folder / "bag", [*image_messages(), *raw_messages()])
    with RosRecording(bag) as recording:
        assert {chunk.link for chunk in recording} == {"sonar"}
        assert b"".join(chunk.data for chunk in recording) == b"".join(map(ping, range(PINGS)))


def test_messages_without_a_stamp_have_the_time_of_the_bag(bench: Bench) -> None:
    bag = write_bag(bench.folder / "bag", raw_messages(stamped=False))
    with RosRecording(bag) as recording:
        assert [chunk.arrival_ns for chunk in recording][::2] == list(map(arrival_ns, range(PINGS)))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ranges": np.zeros(ROWS, np.float32)}, "its rows are 0 m apart"),
        ({"ranges": np.arange(ROWS, dtype=np.float32) ** 2}, "its ranges are not evenly spaced"),
        ({"ranges": np.full(ROWS, np.nan, np.float32)}, "not two or more finite numbers"),
        ({"ranges": np.linspace(2, 6, ROWS, dtype=np.float32)}, "its ranges begin at 2 m"),
        ({"ranges": np.arange(9, dtype=np.float32)}, "bytes of data, not 9 rows of 65 beams"),
        ({"beam_directions": []}, "its beam_directions are not unit vectors"),
        ({"beam_directions": [VECTOR(x=1.0, y=0.0, z=0.0)] * BEAMS}, "plane of Y and Z"),
        ({"dtype": 8, "kind": "<f4"}, "samples of dtype 8; unsigned 8, 16 and 32 bit can be"),
    ],
)
def test_images_that_define_no_ping(bench: Bench, changes: dict[str, Any], words: str) -> None:
    bag = write_bag(bench.folder / "bag", image_messages(**changes))
    code, text = bench.run("--replay", bag, STILL)
    assert (code, text.count("\n")) == (ExitCode.BAD_DATA, 1), text
    assert f"{bag}: no sonar data in it (topic /sonar: " in text or "nothing can be read" in text
    assert words in text


def test_bag_without_sonar_data(bench: Bench) -> None:
    bag = write_bag(bench.folder / "bag", odometry_messages())
    code, text = bench.run("--replay", bag)
    assert (code, text.count("\n")) == (ExitCode.BAD_DATA, 1)
    assert f"{bag}: a ROS bag without sonar data; raw Oculus messages, oculus_interfaces" in text
    (file,) = bag.glob("*.mcap")
    code, text = bench.run("--replay", file)
    assert (code, text.count("\n")) == (ExitCode.BAD_DATA, 1)
    assert f"{file}: a ROS bag without sonar data; raw Oculus messages" in text
    assert "folder" not in text


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_file_that_cannot_be_read_without_its_folder(
    bench: Bench, storage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_bag(bench.folder / "bag", [*raw_messages(), *odometry_messages()], storage)
    (file,) = (one for one in bag.iterdir() if one.suffix in (".mcap", ".db3"))

    def opened(path: Path) -> Any:
        if path == file:
            raise RecordingError(f"{path}: no message definitions")
        return open_ros_bag(path)

    monkeypatch.setattr("mapperd.session.ros_recording.open_ros_bag", opened)
    code, text = bench.run("--replay", file)
    assert (code, text.count("\n")) == (ExitCode.BAD_DATA, 1)
    assert text.endswith(f"no message definitions; pass the bag's folder: {bag}\n")


def test_bag_without_poses(bench: Bench) -> None:
    bag = write_bag(bench.folder / "bag", raw_messages())
    code, text = bench.run("--replay", bag)
    assert (code, text.count("\n")) == (ExitCode.BAD_DATA, 1)
    assert f"{bag}: has no odometry: no nav_msgs/Odometry" in text
    assert "--pose" in text


@pytest.mark.slow
def test_bag_of_ros_1(bench: Bench) -> None:
    store = typestore(Stores.ROS1_NOETIC)
    types: dict[str, Any] = dict(store.types)
    with Writer1(bench.folder / "old.bag") as writer:
        link = writer.add_connection("/raw", RAW, typestore=store)
        for _, t_ns, message in raw_messages():
            head = types["std_msgs/msg/Header"](seq=0, stamp=message.header.stamp, frame_id="")
            one = types[RAW](header=head, direction=message.direction, data=message.data)
            writer.write(link, t_ns, store.serialize_ros1(one, RAW))
    summary = bench.map("--replay", bench.folder / "old.bag", STILL)
    assert summary["bytes_total"] == bench.reference()["bytes_total"]


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_damaged_bag_never_ends_in_a_traceback(bench: Bench, storage: str) -> None:
    bag = write_bag(bench.folder / "bag", [*raw_messages(), *odometry_messages()], storage)
    (file,) = (one for one in bag.iterdir() if one.suffix in (".mcap", ".db3"))
    data = file.read_bytes()
    rng = np.random.default_rng(3)
    for place in rng.integers(0, len(data), 5):
        changed = bytearray(data)
        changed[int(place)] ^= 0x55
        file.write_bytes(changed)
        code, text = bench.run("--replay", bag)
        assert code in (ExitCode.OK, ExitCode.BAD_DATA), text
    file.write_bytes(data[: len(data) // 2])
    code, text = bench.run("--replay", bag)
    assert code == ExitCode.BAD_DATA
    assert text.count("\n") == 1, text


@pytest.mark.slow
def test_store_resumes(bench: Bench) -> None:
    bag = write_bag(bench.folder / "bag", [*raw_messages(), *odometry_messages()])
    words = ("--replay", bag, "--store", bench.folder / "map.db")
    summary = bench.map(*words)
    assert bench.run(*words)[0] == ExitCode.OK
    again = json.loads((bench.folder / "out" / "summary.json").read_text())
    assert again["map_sha256"] == summary["map_sha256"]
    assert again["pings_total"] == 0
