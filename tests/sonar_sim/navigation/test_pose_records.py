"""Poses that others send, on their way into a live path."""

import json
import math
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from sonar_sim.geometry.live_path import LivePath
from sonar_sim.geometry.pose import FramePose
from sonar_sim.navigation.follow import PoseFollower
from sonar_sim.navigation.formats import format_named
from sonar_sim.navigation.odometry_output import OdometrySender
from sonar_sim.navigation.pose_records import (
    MavlinkRecords,
    NativeRecords,
    PoseAssembler,
    PoseDecoder,
    PoseRecord,
)
from sonar_sim.scene.vehicle import SimulatedOdometry, Vehicle
from sonar_sim.scene_file import load_scenario

ORIGIN = Vehicle(latitude_deg=-33.8, longitude_deg=151.2)
NATIVE = {"v": 1, "t": 5_000_000_000, "clk": "unix", "w": "enu", "b": "flu", "p": [1.0, 2.0, -3.0]}


class Autopilot:
    """Packs messages of a system."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self._link = common.MAVLink(None, srcSystem=system, srcComponent=component)

    def __call__(self, message: Any) -> bytes:
        return bytes(message.pack(self._link))


def only(decoder: PoseDecoder, data: bytes, arrival_s: float = 0.0) -> PoseRecord:
    (record,) = decoder.decode(data, arrival_s)
    assert record is not None
    return record


def test_native_records_of_both_axes_are_the_same_pose() -> None:
    turned = {"q": [math.cos(0.4), 0.0, 0.0, math.sin(0.4)], "u": [1.0, 2.0, 3.0]}
    enu = only(NativeRecords(), msgpack.packb(NATIVE | turned | {"r": [0.1, 0.2, 0.3]}))
    # The nose 0.8 rad anticlockwise from east is pi/2 - 0.8 clockwise from north.
    half = (math.pi / 2 - 0.8) / 2
    ned_fields = {
        "w": "ned",
        "b": "frd",
        "p": [2.0, 1.0, 3.0],
        "q": [math.cos(half), 0.0, 0.0, math.sin(half)],
        "u": [1.0, -2.0, -3.0],
        "r": [0.1, -0.2, -0.3],
    }
    ned = only(NativeRecords(), json.dumps(NATIVE | ned_fields).encode())
    for one in (enu, ned):
        assert one.stamp_s == 5.0
        assert one.position_m == pytest.approx([1.0, 2.0, -3.0])
        assert one.rotation is not None
        assert one.rotation[:, 0] == pytest.approx([math.cos(0.8), math.sin(0.8), 0.0])
        assert one.rotation[:, 2] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
        assert one.body_mps == pytest.approx([1.0, 2.0, 3.0])
        assert one.rates_rps == pytest.approx([0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    "change",
    [
        {"v": 2},
        {"w": "esu"},
        {"p": [1.0, math.nan, 0.0]},
        {"p": [1e9, 0.0, 0.0]},
        {"p": "abc"},
        {"q": [0.0, 0.0, 0.0, 0.0]},
        {"q": [1.0, 0.0, 0.0]},
        {"t": "noon"},
        {"t": math.nan},
        {"clk": "gps"},
        {"u": [1e308, 0.0, 0.0]},
        {"r": [1e200, 0.0, 0.0]},
        {"unknown": 1},
    ],
)
def test_what_is_no_native_record_is_malformed(change: dict[str, Any]) -> None:
    assert list(NativeRecords().decode(msgpack.packb(NATIVE | change), 0.0)) == [None]


@pytest.mark.parametrize(
    "data",
    [b"", b"\xc1", b"{", b"[1]", b"\x93\x01", b"{}", b'{"v":' + b"[" * 2000, b" " * 5000],
)
def test_what_is_no_record_at_all_is_malformed(data: bytes) -> None:
    assert list(NativeRecords().decode(data, 0.0)) == [None]


def test_numbers_of_hundreds_of_digits_are_malformed() -> None:
    for field in ("t", "p"):
        digits = "1" + "0" * 400
        value = digits if field == "t" else f"[{digits}, 0, 0]"
        text = json.dumps({key: NATIVE[key] for key in NATIVE if key != field})
        data = f'{text[:-1]}, "{field}": {value}}}'.encode()
        assert list(NativeRecords().decode(data, 0.0)) == [None]


@pytest.mark.parametrize(("child", "ahead"), [(8, True), (12, True), (1, False), (20, False)])
def test_velocities_of_odometry_are_in_the_axes_that_it_names(child: int, ahead: bool) -> None:  # noqa: FBT001
    # Heading east: ahead is east.
    half = math.sqrt(0.5)
    message = common.MAVLink_odometry_message(
        1_000_000, 1, child, 1, 2, 3, [half, 0, 0, half], 1, 0, 0, 0, 0, 0, [0] * 21, [0] * 21
    )
    record = only(MavlinkRecords(ORIGIN), Autopilot()(message))
    assert record.rotation is not None
    moving = record.map_mps if record.body_mps is None else record.rotation @ record.body_mps
    assert moving == pytest.approx([1.0, 0.0, 0.0] if ahead else [0.0, 1.0, 0.0], abs=1e-6)


def test_mavlink_is_turned_from_north_east_down() -> None:
    decoder, send = MavlinkRecords(ORIGIN), Autopilot()
    place = only(
        decoder,
        send(common.MAVLink_local_position_ned_message(1500, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3)),
    )
    assert place.stamp_s == 1.5
    assert place.position_m == pytest.approx([2.0, 1.0, -3.0])
    assert place.map_mps == pytest.approx([0.2, 0.1, -0.3])
    # Heading east, nose 0.3 rad up, then rolled 0.2 rad to starboard.
    attitude = common.MAVLink_attitude_message(1500, 0.2, 0.3, math.pi / 2, 0.1, 0.2, 0.3)
    turned = only(decoder, send(attitude))
    assert turned.rotation is not None
    assert turned.rotation[:, 0] == pytest.approx([math.cos(0.3), 0.0, math.sin(0.3)], abs=1e-6)
    port = turned.rotation[:, 1]
    assert port[2] == pytest.approx(math.sin(0.2) * math.cos(0.3), abs=1e-6), "port side is up"
    assert turned.rates_rps == pytest.approx([0.1, -0.2, -0.3])


def test_geographic_positions_count_from_the_map_origin() -> None:
    pyproj = pytest.importorskip("pyproj")
    east, north = 120.0, -80.0
    project = pyproj.Proj(proj="tmerc", lat_0=-33.8, lon_0=151.2, ellps="WGS84")
    longitude, latitude = project(east, north, inverse=True)
    message = common.MAVLink_global_position_int_message(
        0, round(latitude * 1e7), round(longitude * 1e7), -4000, -4000, 10, 20, 30, 0
    )
    decoder = MavlinkRecords(ORIGIN)
    place = only(decoder, Autopilot()(message))
    assert place.position_m == pytest.approx([east, north, -4.0], abs=0.02)
    assert place.map_mps == pytest.approx([0.2, 0.1, -0.3])
    none_yet = common.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 0)
    assert only(decoder, Autopilot()(none_yet)).position_m is None


def test_a_local_position_goes_before_geographic_ones_until_it_is_silent() -> None:
    decoder, send = MavlinkRecords(ORIGIN), Autopilot()
    local = send(common.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, 0))
    globe = send(common.MAVLink_global_position_int_message(0, 1, 1, 0, 0, 0, 0, 0, 0))
    counts = [
        len(list(decoder.decode(data, time_s)))
        for data, time_s in ((globe, 0.0), (local, 1.0), (globe, 1.5), (globe, 4.0))
    ]
    assert counts == [1, 1, 0, 1]


def test_a_malformed_local_position_does_not_silence_geographic_ones() -> None:
    decoder, send = MavlinkRecords(ORIGIN), Autopilot()
    broken = common.MAVLink_local_position_ned_message(0, math.nan, 0, 0, 0, 0, 0)
    globe = common.MAVLink_global_position_int_message(
        0, -338_000_000, 1_512_000_000, 0, -4000, 0, 0, 0, 0
    )
    assert list(decoder.decode(send(broken), 1.0)) == [None]
    assert only(decoder, send(globe), 1.5).position_m == pytest.approx([0.0, 0.0, -4.0])


def test_only_the_first_autopilot_counts_and_noise_is_malformed() -> None:
    decoder = MavlinkRecords(ORIGIN)
    attitude = common.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
    assert list(decoder.decode(Autopilot(1, 100)(attitude), 0.0)) == [], "a camera"
    assert len(list(decoder.decode(Autopilot(7)(attitude), 0.0))) == 1
    assert list(decoder.decode(Autopilot(1)(attitude), 0.0)) == []
    assert decoder.autopilot == 7
    assert set(decoder.decode(b"\x00garbage" * 4, 0.0)) == {None}
    broken = common.MAVLink_attitude_message(0, math.nan, 0, 0, 0, 0, 0)
    assert list(decoder.decode(Autopilot(7)(broken), 0.0)) == [None]
    parser = common.MAVLink(None)
    asked = parser.parse_buffer(decoder.interval_requests(20_000))
    assert asked is not None
    assert {(m.target_system, m.command, m.param1, m.param2) for m in asked} == {
        (7, 511, 30.0, 20_000.0),
        (7, 511, 32.0, 20_000.0),
        (7, 511, 33.0, 20_000.0),
    }


def not_finite(value: float) -> list[Any]:
    """Messages of all kinds that are read, each with one number that no vehicle has."""
    level = [1.0, 0.0, 0.0, 0.0]

    def odometry(at: list[float], q: list[float], moving: list[float]) -> Any:
        none = [math.nan] * 21
        return common.MAVLink_odometry_message(0, 1, 8, *at, q, *moving, none, none)

    messages = []
    for k in range(6):
        numbers = [value if j == k else 0.0 for j in range(6)]
        messages += [
            common.MAVLink_attitude_message(0, *numbers),
            common.MAVLink_local_position_ned_message(0, *numbers),
            odometry([0.0] * 3, level, numbers),
        ]
    for k in range(4):
        quaternion = [value if j == k else level[j] for j in range(4)]
        messages += [
            common.MAVLink_attitude_quaternion_message(0, *quaternion, 0.0, 0.0, 0.0),
            odometry([0.0] * 3, quaternion, [0.0] * 6),
        ]
    for k in range(3):
        numbers = [value if j == k else 0.0 for j in range(3)]
        messages += [
            common.MAVLink_attitude_quaternion_message(0, *level, *numbers),
            odometry(numbers, level, [0.0] * 6),
        ]
    far = 2**31 - 1  # its fields are integers
    messages += [
        common.MAVLink_global_position_int_message(0, far, 1, 0, 0, 0, 0, 0, 0),
        common.MAVLink_global_position_int_message(0, 1, far, 0, 0, 0, 0, 0, 0),
        common.MAVLink_global_position_int_message(0, 1, 1, 0, far, 0, 0, 0, 0),
    ]
    return messages


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_mavlink_whose_numbers_are_not_finite_is_malformed(value: float) -> None:
    decoder, send = MavlinkRecords(ORIGIN), Autopilot()
    for k, message in enumerate(not_finite(value)):
        assert list(decoder.decode(send(message), 10.0 * k)) == [None], message
    good = common.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
    assert only(decoder, send(good)).rotation is not None


def test_odometry_between_other_frames_is_malformed() -> None:
    decoder, send = MavlinkRecords(ORIGIN), Autopilot()
    for frame, child in ((8, 8), (1, 0), (0, 1)):
        message = common.MAVLink_odometry_message(
            0, frame, child, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, [0] * 21, [0] * 21
        )
        assert list(decoder.decode(send(message), 0.0)) == [None]


def datagrams(form: str) -> Iterator[tuple[float, bytes]]:
    """The harbour's vehicle in a format, with delays of 2 to 12 ms."""
    scenario = load_scenario("harbour")
    sender = OdometrySender(scenario, scenario.trajectory, [], lambda s: round(1e9 * s))
    delay_s = np.random.default_rng(1)
    encoder = format_named(form)
    for sample in SimulatedOdometry(scenario.trajectory, scenario.vehicle).samples():
        if sample.time_s > 20.0:
            return
        for data in encoder.encode(sender.fix(sample)):
            yield sample.time_s + 0.002 + 0.01 * delay_s.random(), data


@pytest.mark.parametrize("form", ["native", "mavlink-ardusub", "mavlink-odometry"])
def test_a_path_told_over_a_link_is_the_true_one(form: str) -> None:
    scenario = load_scenario("harbour")
    truth = scenario.trajectory
    decoder: PoseDecoder = NativeRecords() if form == "native" else MavlinkRecords(scenario.vehicle)
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    errors_m, errors_deg = [], []
    for arrival_s, data in datagrams(form):
        for record in decoder.decode(data, arrival_s):
            assert record is not None
            assembler.take(record, arrival_s)
        if arrival_s > 2.0:
            ahead_s = arrival_s + 0.05
            pose, expected = live.pose(ahead_s), truth.pose(ahead_s)
            errors_m.append(float(np.linalg.norm(pose.position_m - expected.position_m)))
            cosine = 0.5 * (np.trace(pose.rotation.T @ expected.rotation) - 1.0)
            errors_deg.append(math.degrees(math.acos(min(1.0, cosine))))
    # Its noise is 5 mm and 0.1°, its stamps are carried over to some 2 ms, at 0.6 m/s and 30°/s.
    assert np.sqrt(np.mean(np.square(errors_m))) < 0.015
    assert np.sqrt(np.mean(np.square(errors_deg))) < 0.6
    assert live.updates > 400


def test_an_attitude_alone_is_not_followed() -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    follower = PoseFollower("mavlink://127.0.0.1:1", live, Vehicle(), lambda: 1.0)
    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    turned = common.MAVLink_attitude_message(10, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
    placed = common.MAVLink_local_position_ned_message(11, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    follower.take(turned.pack(link), lambda _: None)
    assert (follower.records, follower.state, live.updates) == (1, "waiting", 0)
    follower.take(placed.pack(link), lambda _: None)
    assert (follower.records, follower.state, live.updates) == (
        2,
        "following",
        2,
    )  # put there, then moved on


def test_a_vehicle_that_is_put_elsewhere_does_not_fly_there() -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    for time_s, x_m in ((10.0, 0.0), (10.1, 0.1), (10.2, 50.0)):
        place = PoseRecord(time_s, position_m=np.array([x_m, 0.0, -1.0]), rotation=np.eye(3))
        assembler.take(place, time_s + 0.5)
    assert live.pose(10.7).position_m[0] == pytest.approx(50.0)
    assert np.linalg.norm(live.velocity_mps(10.65)) < 5.0


def test_a_position_that_is_no_longer_heard_is_no_motion() -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    moving = np.array([1.0, 0.0, 0.0])
    assembler.take(PoseRecord(None, rotation=np.eye(3)), 10.0)
    assembler.take(PoseRecord(None, position_m=np.zeros(3), map_mps=moving), 10.0)
    assert live.velocity_mps(10.0)[0] == pytest.approx(1.0)
    for second in range(1, 6):
        assembler.take(PoseRecord(None, rotation=np.eye(3)), 10.0 + second)
    assert live.velocity_mps(15.0) == pytest.approx([0.0, 0.0, 0.0])
    assert live.pose(15.0).position_m[0] == pytest.approx(2.0)


def at(stamp_s: float, x_m: float) -> PoseRecord:
    """Return a record without a velocity."""
    return PoseRecord(stamp_s, position_m=np.array([x_m, 0.0, -1.0]), rotation=np.eye(3))


def test_parts_of_two_sources_are_late_each_for_itself() -> None:
    """PX4 stamps ODOMETRY with its samples, earlier than ATTITUDE."""
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    for k in range(100):
        now_s = 0.02 * k
        assembler.take(PoseRecord(now_s, rotation=np.eye(3)), 5.0 + now_s)
        assert assembler.take(at(now_s - 0.01, now_s - 0.01), 5.0 + now_s)
    assert live.pose(5.0 + now_s).position_m[0] == pytest.approx(now_s, abs=0.03)


def test_datagrams_in_another_order_do_not_set_the_clock_back() -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    order = [*range(51), 53, 51, 52, 54, 55]
    taken = [assembler.take(at(0.02 * k, 0.02 * k), 7.0 + 0.02 * k) for k in order]
    assert taken[-5:] == [True, False, False, True, True]
    assert live.velocity_mps(8.1)[0] == pytest.approx(1.0)


@pytest.mark.parametrize("step_m", [0.5, 0.9, 30.0])
def test_no_vehicle_is_faster_than_a_jump(step_m: float) -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    for k in range(20):
        assembler.take(at(0.02 * k, 0.0 if k < 19 else step_m), 5.0 + 0.02 * k)
    assert live.pose(5.0 + 0.38 + 0.5).position_m[0] == pytest.approx(step_m)


@pytest.mark.parametrize("gap_s", [0.05, 0.2, 0.5])
def test_a_jump_between_records_without_velocity_is_no_velocity(gap_s: float) -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    for k, x_m in enumerate((0.0, 0.0, 20.0)):
        assembler.take(at(gap_s * k, x_m), gap_s * k + 5.0)
    end_s = 2.0 * gap_s + 5.0
    assert live.velocity_mps(end_s + 0.1) == pytest.approx([0.0, 0.0, 0.0])
    assert live.pose(end_s + 0.4).position_m[0] == pytest.approx(20.0)


@pytest.mark.parametrize("age_s", [0.06, 0.9, 1.5, 100.0])
def test_a_late_record_moves_nothing(age_s: float) -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    for k in range(50):
        assert assembler.take(at(0.04 * k, 0.04 * k), 7.0 + 0.04 * k)
    assert not assembler.take(at(2.0 - age_s, -8.0), 9.0)
    assert live.pose(9.0).position_m[0] == pytest.approx(2.0)
    assert assembler.take(at(2.04, 2.04), 9.04)
    assert live.pose(9.1).position_m[0] == pytest.approx(2.1)
    assert live.velocity_mps(9.05)[0] == pytest.approx(1.0)


@pytest.mark.parametrize("step_s", [-1000.0, -0.9, 0.9, 1000.0])
def test_a_sender_whose_clock_is_set_is_followed_on(step_s: float) -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    errors_m = []
    for k in range(250):
        arrival_s, x_m = 2000.0 + 0.04 * k, 0.04 * k
        assembler.take(at(arrival_s + (step_s if k >= 50 else 0.0), x_m), arrival_s)
        errors_m.append(abs(live.pose(arrival_s).position_m[0] - x_m))
    assert max(errors_m[1:]) < 0.05
    assert errors_m[-1] < 1e-6


def test_a_delay_that_grows_is_followed_after_seconds() -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    for k in range(500):
        arrival_s = 10.0 + 0.04 * k + (0.3 if k >= 100 else 0.0)
        assembler.take(at(0.04 * k, 0.04 * k), arrival_s)
    assert live.pose(arrival_s).position_m[0] == pytest.approx(0.04 * 499)


def test_a_sender_that_begins_again_is_followed_on() -> None:
    live = LivePath(FramePose(np.zeros(3), np.eye(3)))
    assembler = PoseAssembler(live)
    for arrival_s, stamp_s in ((5.0, 1000.0), (5.1, 1000.1), (5.2, 3.0), (5.3, 3.1)):
        place = PoseRecord(stamp_s, position_m=np.array([arrival_s, 0, 0]), rotation=np.eye(3))
        assembler.take(place, arrival_s)
    assert live.pose(5.3).position_m[0] == pytest.approx(5.3)
