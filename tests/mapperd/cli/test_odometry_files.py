"""`mapperd --replay --odometry`: the map is that of the same odometry inside the recording."""

import json
import math
import os
import re
import struct
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink import mavutil
from pymavlink.dialects.v20 import common
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mapperd.cli.mapperd import main
from mapperd.export.clouds import VERTEX
from oculus_driver.command_line import ExitCode
from oculus_driver.recording import RecordingWriter
from tests.mapperd.conftest import START_NS, make_odometry, make_ping
from tests.oculus_driver.recording.foreign_files import HOST, SONAR, Wire, ethernet, ipv4, pcap, udp

PINGS = 12
RECORDS = 60
RECORD_NS, PING_NS = 50_000_000, 200_000_000
Floats = NDArray[np.float64]
Capture = pytest.CaptureFixture[str]


def track(seconds: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Position east, north, up and roll, pitch, heading in degrees of a slow turn."""
    heading = 80.0 + 6.0 * seconds
    return (
        (0.4 * seconds, 2.0 - 0.1 * seconds, -3.0 - 0.05 * seconds),
        (2.0 * math.sin(seconds), 1.5 * math.cos(seconds), heading),
    )


def quaternion(roll: float, pitch: float, heading: float) -> tuple[float, float, float, float]:
    """Orientation (w, x, y, z) in east, north, up of angles about ahead, starboard and down."""
    half = [math.radians(angle) / 2 for angle in (roll, -pitch, 90.0 - heading)]
    (cr, sr), (cp, sp), (cy, sy) = [(math.cos(a), math.sin(a)) for a in half]
    return (
        cy * cp * cr + sy * sp * sr,
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
    )


def stamps() -> Iterable[tuple[int, float]]:
    """Times of the records, Unix and seconds from the start."""
    return [(START_NS + k * RECORD_NS, k * RECORD_NS / 1e9) for k in range(RECORDS)]


def poses() -> list[tuple[int, tuple[float, ...], tuple[float, ...]]]:
    return [(t_ns, track(s)[0], quaternion(*track(s)[1])) for t_ns, s in stamps()]


def native(t_ns: int, place: Sequence[float], wxyz: Sequence[float]) -> bytes:
    return make_odometry(clk="unix", t=t_ns, p=tuple(place), q=tuple(wxyz))


def pings() -> list[tuple[int, bytes]]:
    return [
        (START_NS + 90_000_000 + k * PING_NS, make_ping(k + 1, start_time=0.2 * k))
        for k in range(PINGS)
    ]


def write_dive(path: Path, odometry: Sequence[tuple[int, bytes]] = ()) -> Path:
    events = [(t_ns, "sonar", data) for t_ns, data in pings()]
    events += [(t_ns, "vehicle", data) for t_ns, data in odometry]
    with RecordingWriter(path, overwrite=True) as writer:
        links = {
            "sonar": writer.add_link("sonar", "oculus"),
            "vehicle": writer.add_link("vehicle", "odometry-native"),
        }
        for t_ns, link, data in sorted(events):
            writer.write(links[link], data, t_ns)
    return path


class Bench:
    """Runs the command on one dive whose recorded odometry is wrong."""

    def __init__(self, folder: Path, capsys: Capture) -> None:
        self.folder, self._capsys = folder, capsys
        self.config = folder / "a.yaml"
        self.config.write_text(
            "octree: {voxel_resolution: 0.1}\nmounting: {orientation: {pitch: 20}}\n"
            "odometry: {origin: {latitude: 47.0, longitude: 8.0}}\n"
        )
        self.whole = write_dive(folder / "whole.mcap", [(p[0], native(*p)) for p in poses()])
        wrong = [(t_ns, native(t_ns, (50.0, 0, 0), wxyz)) for t_ns, _, wxyz in poses()]
        self.dive = write_dive(folder / "dive.mcap", wrong)

    def run(self, *words: object, out: str = "out") -> tuple[int, str]:
        self._capsys.readouterr()
        args = ["--config", self.config, "--out", self.folder / out, *words]
        code = main([str(word) for word in args])
        return code, self._capsys.readouterr().err

    def map(self, *words: object, out: str = "out") -> dict[str, Any]:
        code, text = self.run(*words, out=out)
        assert code == ExitCode.OK, text
        summary: dict[str, Any] = json.loads((self.folder / out / "summary.json").read_text())
        assert summary["pings_mapped"] == PINGS, summary["pings_dropped"]
        return summary

    def reference(self) -> dict[str, Any]:
        return self.map("--replay", self.whole, out="reference")

    def cells(self, out: str) -> set[tuple[int, ...]]:
        """The occupied cells of 0.1 m."""
        _, _, body = (self.folder / out / "map.ply").read_bytes().partition(b"end_header\n")
        points = np.frombuffer(body, dtype=VERTEX)
        places = np.stack([points[name] for name in "xyz"], axis=1)
        return set(map(tuple, np.floor(places / 0.1).astype(int).tolist()))

    def alike(self, out: str = "out") -> float:
        """The part of the cells that both maps have."""
        ours, theirs = self.cells(out), self.cells("reference")
        return len(ours & theirs) / len(ours | theirs)

    def fails(self, *words: object, code: int = ExitCode.BAD_DATA) -> str:
        """Return the one line of an error."""
        found, text = self.run("--replay", self.dive, "--odometry", *words)
        assert found == code, text
        assert text.count("\n") == 1, text
        return text


@pytest.fixture
def bench(tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setattr("mapperd.daemon.map_folder.write_picture", lambda *_: None)
    monkeypatch.setenv("XDG_CONFIG_HOME", "/none")
    return Bench(tmp_path, capsys)


def seconds(t_ns: int) -> str:
    return f"{t_ns // 10**9}.{t_ns % 10**9:09}"


def write_tum(path: Path, *, mark: str = " ", late_s: int = 0) -> Path:
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for t_ns, place, (w, x, y, z) in poses():
        lines.append(mark.join([seconds(t_ns + late_s * 10**9), *map(repr, (*place, x, y, z, w))]))
    path.write_text("\n".join(lines) + "\n")
    return path


def write_csv(path: Path, header: str, row: Callable[..., Iterable[object]]) -> Path:
    lines = [header, *(",".join(map(str, row(t_ns, s))) for t_ns, s in stamps())]
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


# Trajectories as text


def test_tum_gives_the_same_map(bench: Bench) -> None:
    summary = bench.map("--replay", bench.dive, "--odometry", write_tum(bench.folder / "a.tum"))
    reference = bench.reference()
    assert summary["map_sha256"] == reference["map_sha256"]
    assert summary["recording"]["odometry"] == {
        "files": [str(bench.folder / "a.tum")],
        "formats": ["TUM"],
        "offset_s": 0.0,
        "first_s": START_NS / 1e9,
        "last_s": pytest.approx(START_NS / 1e9 + 2.95),
    }
    assert "odometry" not in reference["recording"]


@pytest.mark.slow
@pytest.mark.parametrize("fuse", ["continue", "follow"])
def test_settings_for_live_sources_do_not_hold_for_a_trajectory(bench: Bench, fuse: str) -> None:
    text = bench.config.read_text().replace("odometry: {", f"odometry: {{at_jump: {fuse}, ")
    text += "slam_quality: {fail_mode: closed, grace_period_sec: 0}\nworld_init: {enabled: true}\n"
    source = "sources: [{name: dvl}], owners: {position: dvl, depth: dvl}, "
    bench.config.write_text(text.replace("odometry: {", f"odometry: {{{source}"))
    summary = bench.map("--replay", bench.dive, "--odometry", write_tum(bench.folder / "a"))
    assert summary["config"]["slam_quality"]["fail_mode"] == "closed"
    bench.config.write_text(re.sub("(slam|world).*\n", "", bench.config.read_text()))
    assert (
        summary["map_sha256"]
        == bench.map("--replay", bench.dive, "--odometry", bench.folder / "a")["map_sha256"]
    )


CSV = {
    "quaternion": (
        "time_s,x_m,y_m,z_m,qx,qy,qz,qw,frame",
        lambda t_ns, s: (
            seconds(t_ns), *track(s)[0], *np.roll(quaternion(*track(s)[1]), -1).tolist(), "map"
        ),
    ),
    "compass": (
        "heading_deg,note,timestamp_ns,north_m,east_m,down_m,roll_deg,pitch_deg",
        lambda t_ns, s: (
            track(s)[1][2], "a b", t_ns, track(s)[0][1], track(s)[0][0], -track(s)[0][2],
            *track(s)[1][:2],
        ),
    ),
    "angles": (
        "Timestamp, X, Y, Z, roll_deg, pitch_deg, yaw_deg",
        lambda t_ns, s: (
            seconds(t_ns), *track(s)[0], track(s)[1][0], -track(s)[1][1], 90 - track(s)[1][2]
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", CSV)
def test_csv_gives_the_same_map(bench: Bench, kind: str) -> None:
    path = write_csv(bench.folder / "a.csv", *CSV[kind])
    bench.map("--replay", bench.dive, "--odometry", path)
    bench.reference()
    assert bench.alike() > 0.999


def test_results_round_trip(bench: Bench) -> None:
    bench.reference()
    for name in ("trajectory.csv", "trajectory.tum"):
        bench.map("--replay", bench.dive, "--odometry", bench.folder / "reference" / name)
        assert bench.alike() > 0.99


@pytest.mark.slow
def test_files_follow_each_other(bench: Bench) -> None:
    path = write_tum(bench.folder / "a")
    lines = path.read_text().splitlines(keepends=True)
    (bench.folder / "b").write_text("".join(lines[:30]))
    (bench.folder / "c").write_text("".join(lines[30:]))
    later_first = [bench.folder / "c", bench.folder / "b"]
    summary = bench.map("--replay", bench.dive, "--odometry", *later_first)
    assert summary["map_sha256"] == bench.reference()["map_sha256"]


@pytest.mark.parametrize("sign", [1, -1])
def test_offset_moves_the_times(bench: Bench, sign: int) -> None:
    late_s = 86_400 * sign
    path = write_tum(bench.folder / "a", late_s=late_s)
    summary = bench.map("--replay", bench.dive, "--odometry", path, "--odometry-offset", -late_s)
    assert summary["map_sha256"] == bench.reference()["map_sha256"]
    assert summary["recording"]["odometry"]["offset_s"] == -late_s


@pytest.mark.parametrize(
    ("late_s", "words"), [(-100, "ends 97.1 s before"), (100, "begins 97.7 s after")]
)
def test_no_overlap_names_the_gap_and_an_offset(bench: Bench, late_s: int, words: str) -> None:
    path = write_tum(bench.folder / "a.tum", late_s=late_s)
    text = bench.fails(path, code=ExitCode.USAGE)
    assert words in text
    assert "--odometry-offset" in text
    (offset,) = re.findall(r"\((\S+) lets both begin together\)", text)
    bench.run("--replay", bench.dive, "--odometry", path, "--odometry-offset", offset)
    assert json.loads((bench.folder / "out" / "summary.json").read_text())["pings_mapped"] > 10


def test_recorded_odometry_is_named_as_ignored(bench: Bench) -> None:
    path = write_tum(bench.folder / "a.tum")
    _, text = bench.run("--replay", bench.dive, "--odometry", path)
    assert f"odometry of {path}; odometry in the recordings is ignored" in text


@pytest.mark.slow
def test_window_and_store(bench: Bench) -> None:
    path = write_tum(bench.folder / "a.tum")
    part = bench.run("--replay", bench.dive, "--odometry", path, "--start", 1, "--duration", 0.9)
    assert part[0] == 0, part
    summary = json.loads((bench.folder / "out" / "summary.json").read_text())
    assert summary["pings_mapped"] == summary["pings_total"] == 5
    store = bench.folder / "map.db"
    stored = bench.map("--replay", bench.dive, "--odometry", path, "--store", store)
    assert stored["map_sha256"] == bench.reference()["map_sha256"]
    code, text = bench.run("--replay", bench.dive, "--store", store)
    assert (code, "0 of 0 pings" in text) == (0, False)


# Bad text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2: 7 columns; 8 are needed: timestamp tx"),
        ("1 0 0 0 0 0 0 1\n2 0 0 x 0 0 0 1\n", "line 2: tz 'x' is not a number"),
        ("1 0 0 0 0 0 0 1\n2 0 0 nan 0 0 0 1\n", "line 2: position holds NaN"),
        ("1 0 0 0 0 0 0 1\n2 0 0 1e9 0 0 0 1\n", "line 2: position holds 1e+09; at most 1e+07"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 0\n", "line 2: q is zero"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 2\n", "line 2: q has the norm 2, not 1"),
        ("5 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "line 2: time goes back by 3 s; sort"),
        ("1 0 0 0 0 0 0 1\ninf 0 0 0 0 0 0 1\n", "line 2: timestamp 'inf' is not a time"),
        ("1 0 0 0 0 0 0 1\n1e19 0 0 0 0 0 0 1\n", "line 2: timestamp '1e19' is not a time"),
        ("t,x,y,z,qx,qy,qz\n", "line 1: the header names no orientation; allowed columns: qx,qy"),
        ("x,y,z,qx,qy,qz,qw\n", "line 1: the header names no time"),
        ("# of a DVL\n\nx,y,z,qx,qy,qz,qw\n", "line 3: the header names no time"),
        ("t,x,y,qx,qy,qz,qw\n", "line 1: the header names no position; allowed columns: x_m,"),
        ("t,x,y,z,qx,qy,qz,qw\n", "has no poses"),
        ("t,x,y,z,qx,qy,qz,qw\n1,2,3\n", "line 2: 3 columns; the header has 8"),
        ("t,x,y,z,qx,qy,qz,qw\n\n1,,3,4,0,0,0,1\n", "line 3: x '' is not a number"),
        ("t,x,y,z,roll_deg,pitch_deg,yaw_deg\n1,2,3,4,5,6,inf\n", "line 2: yaw_deg is inf"),
        ("time_ns,x,y,z,qx,qy,qz,qw\n1.5,2,3,4,0,0,0,1\n", "line 2: time_ns '1.5' is not a time"),
        ("dear diary\n", "not a file of odometry; known are TUM, CSV"),
        ("", "not a file of odometry"),
    ],
)
def test_bad_text_is_one_line(bench: Bench, content: str, words: str) -> None:
    path = bench.folder / "bad.csv"
    path.write_text(content)
    text = bench.fails(path)
    assert f"{path}: {words}" in text


def test_bad_files_are_one_line(bench: Bench) -> None:
    (bench.folder / "bytes").write_bytes(os.urandom(3000))
    assert "not a file of odometry" in bench.fails(bench.folder / "bytes")
    text = b"t,x,y,z,qx,qy,qz,qw\n" + b"1,2,3,4,0,0,0,1\n" * 2000
    (bench.folder / "latin").write_bytes(text + b"\xff\n")
    assert "latin: not UTF-8 text (byte " in bench.fails(bench.folder / "latin")
    assert f"{bench.folder}: no ROS bag in this folder" in bench.fails(bench.folder)
    missing = bench.folder / "missing.csv"
    assert f"{missing}: there is no such file" in bench.fails(missing, code=ExitCode.NO_INPUT)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--odometry", "a"], "--odometry needs --replay"),
        (["--replay", "r", "--odometry", "a", "--pose=0,0,0,0,0,0"], "combined with --pose"),
        (["--replay", "r", "--odometry", "a", "--as-recorded"], "combined with --odometry"),
        (["--replay", "r", "--odometry-offset", "-3"], "--odometry-offset needs --odometry"),
        (["--replay", "r", "--odometry-topic", "/a"], "--odometry-topic needs --odometry"),
        (["--replay", "r", "--odometry", "a", "--odometry-offset", "nan"], "number of seconds"),
    ],
)
def test_options_that_contradict(words: list[str], problem: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == ExitCode.USAGE
    assert problem in capsys.readouterr().err


def test_recording_without_stamps(bench: Bench) -> None:
    raw = bench.folder / "raw.oculus"
    raw.write_bytes(b"".join(data for _, data in pings()))
    code, text = bench.run("--replay", raw, "--odometry", write_tum(bench.folder / "a"))
    assert code == ExitCode.USAGE
    assert "no time stamps: odometry of other files cannot be used" in text


# ROS bags


STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES: dict[str, Any] = dict(STORE.types)


def header(t_ns: int, frame: str, types: dict[str, Any] = TYPES, **more: object) -> Any:
    stamp = types["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **more)


def of(kind: str, *values: float) -> Any:
    names = "xyzw"[: len(values)]
    return TYPES[f"geometry_msgs/msg/{kind}"](**dict(zip(names, map(float, values), strict=True)))


def pose(place: Sequence[float], wxyz: Sequence[float]) -> Any:
    w, x, y, z = wxyz
    kind = TYPES["geometry_msgs/msg/Pose"]
    return kind(position=of("Point", *place), orientation=of("Quaternion", x, y, z, w))


def ros_pose(kind: str, t_ns: int, place: Sequence[float], wxyz: Sequence[float]) -> Any:
    make = TYPES[kind]
    if kind == "geometry_msgs/msg/PoseStamped":
        return make(header=header(t_ns, "map"), pose=pose(place, wxyz))
    covariant = TYPES["geometry_msgs/msg/PoseWithCovariance"](
        pose=pose(place, wxyz), covariance=np.diag(np.full(6, 0.01)).ravel()
    )
    if kind == "geometry_msgs/msg/PoseWithCovarianceStamped":
        return make(header=header(t_ns, "map"), pose=covariant)
    still = TYPES["geometry_msgs/msg/Twist"](
        linear=of("Vector3", 0, 0, 0), angular=of("Vector3", 0, 0, 0)
    )
    twist = TYPES["geometry_msgs/msg/TwistWithCovariance"](twist=still, covariance=np.zeros(36))
    return make(
        header=header(t_ns, "odom"), child_frame_id="base_link", pose=covariant, twist=twist
    )


def transform(
    t_ns: int, frame: str, child: str, place: Sequence[float], wxyz: Sequence[float]
) -> Any:
    w, x, y, z = wxyz
    turned = TYPES["geometry_msgs/msg/Transform"](
        translation=of("Vector3", *place), rotation=of("Quaternion", x, y, z, w)
    )
    one = TYPES["geometry_msgs/msg/TransformStamped"](
        header=header(t_ns, frame), child_frame_id=child, transform=turned
    )
    return TYPES["tf2_msgs/msg/TFMessage"](transforms=[one])


def write_bag(
    path: Path, messages: Iterable[tuple[str, int, Any]], storage: str = "mcap", store: Any = STORE
) -> Path:
    """Write (topic, bag time, message) into a bag."""
    with Writer(path, version=8, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        links: dict[str, Any] = {}
        for topic, t_ns, message in sorted(messages, key=lambda one: one[1]):
            kind = message.__msgtype__
            if topic not in links:
                links[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(links[topic], t_ns, store.serialize_cdr(message, kind))
    return path


def pose_messages(kind: str, topic: str = "/pose") -> list[tuple[str, int, Any]]:
    # A bag is written later than the poses were estimated.
    return [(topic, t_ns + 30_000_000, ros_pose(kind, t_ns, p, q)) for t_ns, p, q in poses()]


POSE = "geometry_msgs/msg/PoseStamped"


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize(
    "kind", [POSE, "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry"]
)
def test_ros_bag_gives_the_same_map(bench: Bench, kind: str, storage: str) -> None:
    bag = write_bag(bench.folder / "bag", pose_messages(kind), storage)
    reference = bench.reference()
    (file,) = (one for one in bag.iterdir() if one.suffix in (".mcap", ".db3"))
    for path in (bag, file):
        summary = bench.map("--replay", bench.dive, "--odometry", path)
        assert summary["map_sha256"] == reference["map_sha256"]
        assert summary["recording"]["odometry"]["formats"] == ["ROS bag"]


def tf_messages(body: str = "base_link") -> list[tuple[str, int, Any]]:
    still = transform(START_NS, body, "sonar_link", (1, 0, 0), (1, 0, 0, 0))
    found = [("/tf_static", START_NS - 1, still)]
    found += [("/tf", t_ns, transform(t_ns, "odom", body, p, q)) for t_ns, p, q in poses()]
    return found


@pytest.mark.slow
def test_transforms_of_the_odometry(bench: Bench) -> None:
    bag = write_bag(bench.folder / "bag", tf_messages())
    summary = bench.map("--replay", bench.dive, "--odometry", bag)
    assert summary["map_sha256"] == bench.reference()["map_sha256"]


@pytest.mark.slow
def test_transforms_between_chosen_frames(bench: Bench) -> None:
    """The chain of three moves by its middle; the outer ones stand still."""
    half = math.sqrt(0.5)
    corrected = transform(START_NS, "map", "odom", (7, 8, 9), (half, 0, 0, half))
    lever = transform(START_NS, "base", "imu", (0, 0, 0.5), (1, 0, 0, 0))
    messages = [*tf_messages("base"), ("/tf_static", START_NS - 1, lever)]
    messages += [("/tf", t_ns - 9, corrected) for t_ns, _ in stamps()]
    bag = write_bag(bench.folder / "bag", messages)
    words = ["--odometry", bag, "--odometry-frames", "map", "imu"]
    bench.map("--replay", bench.dive, *words)
    lines = (bench.folder / "out" / "trajectory.tum").read_text().splitlines()[1:]
    found = np.array([[float(word) for word in line.split()] for line in lines])
    bench.map("--replay", bench.whole, out="reference")
    lines = (bench.folder / "reference" / "trajectory.tum").read_text().splitlines()[1:]
    plain = np.array([[float(word) for word in line.split()] for line in lines])
    for ours, theirs in zip(found, plain, strict=True):
        x, y, z, w = theirs[4:]
        up = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        east, north, height = theirs[1:4] + 0.5 * up
        assert ours[1:4] == pytest.approx([7 - north, 8 + east, 9 + height], abs=2e-3)


@pytest.mark.parametrize(
    ("messages", "words", "expected"),
    [
        (
            [*pose_messages(POSE, "/a"), *pose_messages(POSE, "/b")],
            [],
            "has several topics with poses; choose one with --odometry-topic: /a, /b",
        ),
        (pose_messages(POSE), ["--odometry-topic", "/x"], "has no poses in /x, but in /pose"),
        (tf_messages("robot"), [], "has no transforms from odom or map to base_link; choose two"),
        (tf_messages(), ["--odometry-frames", "a", "b"], "has no poses or transforms from a to b"),
        (
            [("/h", START_NS, header(START_NS, "map"))],
            [],
            "has no odometry: no nav_msgs/Odometry",
        ),
    ],
    ids=["two topics", "unknown topic", "other frame", "unknown frames", "none"],
)
def test_ros_bag_without_such_poses(
    bench: Bench, messages: list[tuple[str, int, Any]], words: list[str], expected: str
) -> None:
    bag = write_bag(bench.folder / "bag", messages)
    assert f"{bag}: {expected}" in bench.fails(bag, *words)


@pytest.mark.slow
def test_topic_is_chosen(bench: Bench) -> None:
    astray = [("/b", t_ns, ros_pose(POSE, t_ns, (99, 0, 0), q)) for t_ns, _, q in poses()]
    bag = write_bag(bench.folder / "bag", [*pose_messages(POSE, "/a"), *astray])
    summary = bench.map("--replay", bench.dive, "--odometry", bag, "--odometry-topic", "/a")
    assert summary["map_sha256"] == bench.reference()["map_sha256"]


@pytest.mark.slow
def test_poses_that_are_none_are_rejected(bench: Bench) -> None:
    messages = pose_messages(POSE)
    nan = [
        ("/pose", t_ns - 9, ros_pose(POSE, t_ns - 9, (math.nan, 0, 0), q)) for t_ns, _, q in poses()
    ]
    bag = write_bag(bench.folder / "bag", [*messages, *nan])
    summary = bench.map("--replay", bench.dive, "--odometry", bag)
    assert summary["map_sha256"] == bench.reference()["map_sha256"]
    assert summary["poses"]["odometry_rejected"]["not_finite"] > 40


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_damaged_bag_is_one_line(bench: Bench, storage: str) -> None:
    bag = write_bag(bench.folder / "bag", pose_messages(POSE), storage)
    (file,) = (one for one in bag.iterdir() if one.suffix in (".mcap", ".db3"))
    data = file.read_bytes()
    for size in (200, len(data) // 2, len(data) - 40):
        file.write_bytes(data[:size])
        code, text = bench.run("--replay", bench.dive, "--odometry", bag)
        assert code in (ExitCode.OK, ExitCode.BAD_DATA), text
        assert "Traceback" not in text
        if code:
            assert text.count("\n") == 1, text
            assert f"{bag}: cannot be read as a ROS bag: " in text


@pytest.mark.slow
def test_frames_with_other_axes(bench: Bench) -> None:
    """MAVROS reports in `odom_ned` too."""
    messages = []
    for t_ns, s in stamps():
        (east, north, up), (roll, pitch, heading) = track(s)
        a, b, c = (math.radians(angle) / 2 for angle in (roll, pitch, heading))
        turn = (
            math.cos(c) * math.cos(b) * math.cos(a) + math.sin(c) * math.sin(b) * math.sin(a),
            math.cos(c) * math.cos(b) * math.sin(a) - math.sin(c) * math.sin(b) * math.cos(a),
            math.cos(c) * math.sin(b) * math.cos(a) + math.sin(c) * math.cos(b) * math.sin(a),
            math.sin(c) * math.cos(b) * math.cos(a) - math.cos(c) * math.sin(b) * math.sin(a),
        )
        one = transform(t_ns, "odom_ned", "base_link_frd", (north, east, -up), turn)
        messages.append(("/tf", t_ns, one))
    bag = write_bag(bench.folder / "bag", messages)
    bench.map(
        "--replay", bench.dive, "--odometry", bag, "--odometry-frames", "odom_ned", "base_link_frd"
    )
    bench.reference()
    assert bench.alike() > 0.999


@pytest.mark.slow
def test_bag_of_ros_1(bench: Bench) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    types: dict[str, Any] = dict(store.types)
    with Writer1(bench.folder / "old.bag") as writer:
        link = writer.add_connection("/pose", POSE, typestore=store)
        for t_ns, place, wxyz in poses():
            message = types[POSE](header=header(t_ns, "map", types, seq=0), pose=pose(place, wxyz))
            writer.write(link, t_ns, store.serialize_ros1(message, POSE))
    summary = bench.map("--replay", bench.dive, "--odometry", bench.folder / "old.bag")
    assert summary["map_sha256"] == bench.reference()["map_sha256"]


# Logs of the vehicle


def ned(s: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position north, east, down and angles in radians."""
    (east, north, up), angles = track(s)
    return (north, east, -up), tuple(math.radians(angle) for angle in angles)


def write_tlog(path: Path, *, system: int = 1) -> Path:
    """Write a log as ground stations do: each frame after the time of its arrival."""
    codec = common.MAVLink(None, srcSystem=system, srcComponent=1)
    with path.open("wb") as file:
        for t_ns, s in stamps():
            place, angles = ned(s)
            boot_ms = 70_000 + round(s * 1000)
            for message in (
                common.MAVLink_heartbeat_message(12, 3, 0, 0, 4, 3),
                common.MAVLink_attitude_message(boot_ms, *angles, 0.0, 0.0, 0.0),
                common.MAVLink_local_position_ned_message(boot_ms, *place, 0.0, 0.0, 0.0),
            ):
                file.write(struct.pack(">Q", t_ns // 1000 + 2000) + message.pack(codec))
    return path


@pytest.mark.slow
def test_tlog_gives_the_map(bench: Bench) -> None:
    path = write_tlog(bench.folder / "a.tlog")
    log = mavutil.mavlink_connection(str(path), notimestamps=False)  # a judge of our file
    assert log.recv_match(type="ATTITUDE")._timestamp == pytest.approx(START_NS / 1e9 + 0.002)
    log.close()
    text = bench.config.read_text().replace(
        "odometry: {", "odometry: {sources: [{name: ap, format: mavlink, latency_sec: 0.002}], "
    )
    bench.config.write_text(text)
    summary = bench.map("--replay", bench.dive, "--odometry", path)
    bench.reference()
    assert bench.alike() > 0.97
    assert summary["poses"]["odometry"]["links"]["ap"]["messages"].keys() == {
        "ATTITUDE",
        "LOCAL_POSITION_NED",
    }


def test_empty_tlog_is_one_line(bench: Bench) -> None:
    path = bench.folder / "empty.tlog"
    path.touch()
    assert f"{path}: cannot be read" in bench.fails(path)


def test_damaged_tlog_goes_on(bench: Bench) -> None:
    path = write_tlog(bench.folder / "a.tlog")
    data = path.read_bytes()
    path.write_bytes(data[:700] + b"noise" * 9 + data[705:-3])
    bench.map("--replay", bench.dive, "--odometry", path)


def test_tlog_of_another_system(bench: Bench) -> None:
    text = bench.fails(write_tlog(bench.folder / "a.tlog", system=7))
    assert "no navigation messages of MAVLink system 1, component 1" in text
    assert "mavlink_system_id" in text


FMT = 0x80
FORMATS = {
    FMT: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
    10: ("GPS", "QBIHBcLLe", "TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt"),
    11: ("XKF1", "QBccCfffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD"),
    12: ("NKF1", "QccCfffffff", "TimeUS,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD"),
    13: ("ATT", "QccccCC", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    14: ("POS", "QLLff", "TimeUS,Lat,Lng,Alt,RelHomeAlt"),
}
"""Messages of a DataFlash log by their types: names, formats and columns."""

STRUCT = {"B": "B", "Q": "Q", "I": "I", "H": "H", "c": "h", "C": "H", "L": "i", "e": "i", "f": "f",
          "n": "4s", "N": "16s", "Z": "64s"}  # fmt: skip


def dataflash(kind: int, *values: object) -> bytes:
    layout = "<" + "".join(STRUCT[letter] for letter in FORMATS[kind][1])
    return bytes((0xA3, 0x95, kind)) + struct.pack(layout, *values)


def begin_bin() -> bytes:
    parts = []
    for kind, (name, layout, columns) in FORMATS.items():
        size = 3 + struct.calcsize("<" + "".join(STRUCT[letter] for letter in layout))
        words = (name.encode(), layout.encode(), columns.encode())
        parts.append(dataflash(FMT, kind, size, *words))
    return b"".join(parts)


BOOT_US = 12_000_000
LEAP_S = 18


def gps(*, week: int | None = None) -> bytes:
    """A fix at the first record's time."""
    of_gps_s = START_NS // 10**9 - 315_964_800 + LEAP_S
    milliseconds = of_gps_s % 604_800 * 1000
    weeks = of_gps_s // 604_800 if week is None else week
    return dataflash(10, BOOT_US, 4, milliseconds, weeks, 10, 90, 470000000, 80000000, 0)


def centidegrees(s: float) -> tuple[int, int, int]:
    roll, pitch, heading = track(s)[1]
    return round(roll * 100), round(pitch * 100), round(heading * 100)


def bin_records(kind: str) -> Iterable[bytes]:
    for _, s in stamps():
        place, _ = ned(s)
        t_us = BOOT_US + round(s * 1e6)
        roll, pitch, heading = centidegrees(s)
        still = (0.0, 0.0, 0.0, 0.0)
        if kind == "XKF1":
            for core, shift in ((0, 0.0), (1, 5.0)):
                moved = (place[0] + shift, *place[1:])
                yield dataflash(11, t_us, core, roll, pitch, heading, *still, *moved)
        elif kind == "NKF1":
            yield dataflash(12, t_us, roll, pitch, heading, *still, *place)
        else:
            yield dataflash(13, t_us, 0, roll, 0, pitch, 0, heading)
            north_deg = place[0] / 111_174.0  # of one degree at 47 degrees north
            east_deg = place[1] / (
                6_378_137.0
                / math.sqrt(1 - 0.00669438 * math.sin(math.radians(47)) ** 2)
                * math.cos(math.radians(47))
                * math.pi
                / 180
            )
            lat, lng = round((47 + north_deg) * 1e7), round((8 + east_deg) * 1e7)
            yield dataflash(14, t_us, lat, lng, -place[2], 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["XKF1", "NKF1", "POS"])
def test_ardupilot_log_gives_the_map(bench: Bench, kind: str) -> None:
    path = bench.folder / "00000001.BIN"
    path.write_bytes(begin_bin() + gps() + b"".join(bin_records(kind)))
    bench.map("--replay", bench.dive, "--odometry", path)
    bench.reference()
    assert bench.alike() > (0.9 if kind == "POS" else 0.99)


def test_ardupilot_log_without_gps_time(bench: Bench) -> None:
    path = bench.folder / "1.BIN"
    path.write_bytes(begin_bin() + b"".join(bin_records("XKF1")))
    assert "has no GPS time" in bench.fails(path)
    offset = START_NS / 1e9 - BOOT_US / 1e6
    bench.map("--replay", bench.dive, "--odometry", path, "--odometry-offset", offset)
    bench.reference()
    assert bench.alike() > 0.99


def test_ardupilot_log_without_poses(bench: Bench) -> None:
    path = bench.folder / "1.BIN"
    path.write_bytes(begin_bin() + gps())
    assert "has no poses (messages XKF1, NKF1, or POS with ATT)" in bench.fails(path)
    path.write_bytes(begin_bin()[:60])
    assert bench.fails(path)


# Captures and recordings


def write_capture(path: Path, *, port: int = 52200) -> Path:
    """Write a capture of the sonar's stream and of the vehicle's datagrams."""
    wire = Wire(now_ns=START_NS)
    wire.open()
    for t_ns, data in pings():
        wire.now_ns = t_ns - 1_000_000
        wire.send(data)
    frames = list(wire.frames)
    for t_ns, place, wxyz in poses():
        datagram = udp(native(t_ns, place, wxyz), ports=(4000, port))
        frames.append((t_ns, ethernet(ipv4(17, datagram, HOST, SONAR))))
    path.write_bytes(pcap(sorted(frames), nano=True))
    return path


def test_datagrams_in_the_same_capture(bench: Bench) -> None:
    path = write_capture(bench.folder / "dive.pcap")
    summary = bench.map("--replay", path)
    assert summary["poses"]["odometry_received"] == RECORDS
    bench.reference()
    assert bench.alike() > 0.99
    other = bench.map("--replay", bench.dive, "--odometry", path)
    assert other["map_sha256"] == bench.map("--replay", bench.whole)["map_sha256"]


@pytest.mark.slow
def test_datagrams_to_other_ports(bench: Bench) -> None:
    path = write_capture(bench.folder / "dive.pcap", port=14550)
    text = bench.fails(path)
    assert f"{path}: has no datagrams to the UDP ports of odometry.sources (52200)" in text
    code, text = bench.run("--replay", path)
    assert code == ExitCode.USAGE
    assert "no odometry in it" in text
    source = "odometry: {sources: [{link: 'udp://0.0.0.0:14550'}], "
    bench.config.write_text(bench.config.read_text().replace("odometry: {", source))
    bench.map("--replay", path)


def test_odometry_of_another_recording(bench: Bench) -> None:
    summary = bench.map("--replay", bench.dive, "--odometry", bench.whole)
    assert summary["map_sha256"] == bench.reference()["map_sha256"]
