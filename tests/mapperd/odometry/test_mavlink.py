import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.quaternion import Quaternion

from mapperd.config.odometry import (
    FormatSettings,
    OdometryFusionConfig,
    OdometrySourceConfig,
    WorldInitConfig,
)
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.geometry.frames import quaternion_to_matrix
from mapperd.odometry.bridge import OdometryBridge
from mapperd.odometry.fusion import FusedPose
from mapperd.odometry.mavlink import MavlinkDecoder
from mapperd.odometry.records import Odometry
from tests.support.peers.autopilot import NAN, Autopilot

SETTINGS = FormatSettings(format="mavlink")
SECOND = 1_000_000_000
small = st.floats(-50, 50, width=32)
triples = st.tuples(small, small, small)
angles = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
versions = st.sampled_from((1, 2))


def one(data: bytes, settings: FormatSettings = SETTINGS) -> Odometry | Reject:
    decoder = MavlinkDecoder(settings)
    (result,) = decoder.feed(data, None)
    assert decoder.counters.bytes_skipped == 0
    return result


def odometry(data: bytes, settings: FormatSettings = SETTINGS) -> Odometry:
    result = one(data, settings)
    assert isinstance(result, Odometry), result
    return result


def axes(record: Odometry) -> np.ndarray:
    """Columns: where forward, port and up of the base point in the map."""
    assert record.map_q_base is not None
    return quaternion_to_matrix(record.map_q_base)


def ned_to_enu_flu(matrix: np.ndarray) -> np.ndarray:
    """A rotation from FRD to NED as one from FLU to ENU, axis by axis."""
    north, east, down = matrix
    return np.array([[row[0], -row[1], -row[2]] for row in (east, north, -down)])


@given(triples, triples, versions)
def test_local_position_is_ned_in_metres(
    place: tuple[float, ...], velocity: tuple[float, ...], version: int
) -> None:
    record = odometry(Autopilot(version=version, boot_ms=1234).local_position(place, velocity))
    north, east, down = place
    assert record.position_m == pytest.approx([east, north, -down])
    north, east, down = velocity
    assert record.velocity_map_mps == pytest.approx([east, north, -down])
    assert record.velocity_mps is None
    assert record.map_q_base is None
    assert (record.stamp_ns, record.clock, record.source) == (1_234_000_000, "boot", "1/1")


@given(angles, triples, versions)
def test_attitude_and_its_quaternion_report_the_same(
    rpy: tuple[float, ...], rates: tuple[float, ...], version: int
) -> None:
    autopilot = Autopilot(version=version)
    theirs = Quaternion(rpy)  # pymavlink's own, (w, x, y, z)
    rows = (theirs.dcm.a, theirs.dcm.b, theirs.dcm.c)
    expected = ned_to_enu_flu(np.array([[row.x, row.y, row.z] for row in rows]))
    roll, pitch, yaw = rates
    for data in (
        autopilot.attitude(rpy, rates),
        autopilot.attitude_quaternion(tuple(theirs.q), rates),
    ):
        record = odometry(data)
        assert axes(record) == pytest.approx(expected, abs=2e-6)
        assert record.rate_radps == pytest.approx([roll, -pitch, -yaw])
    record = odometry(Autopilot().odometry(q=[*theirs.q]))
    assert axes(record) == pytest.approx(expected, abs=2e-6)


def test_heading_east_nose_up_points_east_and_up() -> None:
    record = odometry(Autopilot().attitude((0.0, math.radians(30), math.radians(90))))
    assert axes(record)[:, 0] == pytest.approx([math.sqrt(0.75), 0, 0.5], abs=1e-6)


def test_heading_north_starboard_down() -> None:
    record = odometry(Autopilot().attitude((math.radians(30), 0.0, 0.0)))
    assert axes(record)[:, 0] == pytest.approx([0, 1, 0], abs=1e-6)
    assert axes(record)[:, 1] == pytest.approx([-math.sqrt(0.75), 0, 0.5], abs=1e-6)


def test_quaternion_order_is_w_first() -> None:
    half = math.sqrt(0.5)
    record = odometry(Autopilot().attitude_quaternion((half, 0.0, 0.0, half)))  # heading east
    assert axes(record)[:, 0] == pytest.approx([1, 0, 0], abs=1e-6)
    assert axes(record)[:, 2] == pytest.approx([0, 0, 1], abs=1e-6)


@given(triples, triples, triples)
def test_odometry_has_its_velocity_in_the_body(
    place: tuple[float, ...], velocity: tuple[float, ...], rates: tuple[float, ...]
) -> None:
    x, y, z = place
    vx, vy, vz = velocity
    roll, pitch, yaw = rates
    record = odometry(
        Autopilot(boot_ms=7).odometry(
            x=x, y=y, z=z, vx=vx, vy=vy, vz=vz, rollspeed=roll, pitchspeed=pitch, yawspeed=yaw
        )
    )
    assert record.position_m == pytest.approx([y, x, -z])
    assert record.velocity_mps == pytest.approx([vx, -vy, -vz])
    assert record.velocity_map_mps is None
    assert record.rate_radps == pytest.approx([roll, -pitch, -yaw])
    assert (record.stamp_ns, record.clock) == (7_000_000, "boot")


@pytest.mark.parametrize(
    ("frame", "place", "forward", "north_referenced"),
    [
        (1, [2, 1, -3], [0, 1, 0], True),
        (4, [1, 2, 3], [1, 0, 0], True),
        (20, [1, -2, -3], [1, 0, 0], False),
        (21, [1, 2, 3], [1, 0, 0], False),
    ],
)
def test_each_world_frame_is_its_own(
    frame: int, place: list[float], forward: list[float], *, north_referenced: bool
) -> None:
    record = odometry(Autopilot().odometry(frame_id=frame))
    assert record.position_m == pytest.approx(place)
    assert axes(record)[:, 0] == pytest.approx(forward, abs=1e-6)
    assert record.north_referenced is north_referenced


@pytest.mark.parametrize("child", [8, 9, 12])
def test_old_names_of_the_body_frame_are_known(child: int) -> None:
    assert odometry(Autopilot().odometry(child_frame_id=child)).velocity_mps is not None


def test_covariances_turn_with_their_axes() -> None:
    triangle = [0.0] * 21
    for place, value in ((0, 1.0), (6, 2.0), (11, 3.0), (15, 4.0), (18, 5.0), (20, 6.0)):
        triangle[place] = value  # the diagonal
    triangle[2] = 0.25  # x with z
    record = odometry(Autopilot().odometry(pose_covariance=triangle, velocity_covariance=triangle))
    assert record.pose_covariance is not None
    assert record.twist_covariance is not None
    assert np.diag(record.pose_covariance) == pytest.approx([2, 1, 3, 5, 4, 6])
    assert record.pose_covariance[1, 2] == pytest.approx(-0.25)  # north with up
    assert np.diag(record.twist_covariance) == pytest.approx([1, 2, 3, 4, 5, 6])
    assert record.twist_covariance[0, 2] == pytest.approx(-0.25)  # forward with up


@pytest.mark.parametrize("covariance", [[NAN] * 21, [0.0] * 21])
def test_covariance_that_nobody_filled_is_unknown(covariance: list[float]) -> None:
    record = odometry(Autopilot().odometry(pose_covariance=covariance))
    assert record.pose_covariance is None


def test_parts_that_are_nan_are_unknown() -> None:
    record = odometry(Autopilot().odometry(vx=NAN, vy=NAN, vz=NAN, q=[NAN] * 4))
    assert record.velocity_mps is None
    assert record.map_q_base is None
    assert record.position_m is not None


@pytest.mark.parametrize(
    ("quality", "confidence", "valid"),
    [(-1, None, False), (0, None, True), (50, 0.5, True), (100, 1.0, True)],
)
def test_quality_is_the_confidence(quality: int, confidence: float | None, *, valid: bool) -> None:
    record = odometry(Autopilot().odometry(quality=quality))
    assert record.confidence == confidence
    assert record.valid is valid
    assert (record.position_m is not None) is valid


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"x": NAN}, "not_finite"),
        ({"x": math.inf}, "not_finite"),
        ({"y": 1e9}, "out_of_range"),
        ({"vx": 1e5}, "out_of_range"),
        ({"yawspeed": -1e5}, "out_of_range"),
        ({"q": [0.0] * 4}, "zero_quaternion"),
        ({"q": [0.5, 0, 0, 0]}, "unnormalised_quaternion"),
        ({"q": [1, NAN, 0, 0]}, "not_finite"),
        ({"pose_covariance": [-1.0] * 21}, "negative_variance"),
        ({"time_usec": 2**64 - 1}, "out_of_range"),
        ({"frame_id": 0}, "unknown_frame"),
        ({"frame_id": 12}, "unknown_frame"),
        ({"child_frame_id": 1}, "unknown_frame"),
    ],
)
def test_bad_odometry_is_rejected_with_a_reason(changes: dict[str, Any], reason: str) -> None:
    reject = one(Autopilot().odometry(**changes))
    assert isinstance(reject, Reject)
    assert reject.reason == reason


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (lambda a: a.attitude((NAN, 0, 0)), "not_finite"),
        (lambda a: a.attitude((7.0, 0, 0)), "out_of_range"),
        (lambda a: a.attitude_quaternion((0, 0, 0, 0)), "zero_quaternion"),
        (lambda a: a.local_position((0, 0, NAN)), "not_finite"),
        (lambda a: a.local_position((0, 0, 0), (0, 1e6, 0)), "out_of_range"),
        (lambda a: a.global_position(lat=910_000_000), "out_of_range"),
        (lambda a: a.global_position(lat=0, lon=0), "no_fix"),
        (lambda a: a.pressure(NAN), "not_finite"),
        (lambda a: a.pressure(0.0), "out_of_range"),
        (lambda a: a.pressure(499.0), "out_of_range"),
        (lambda a: a.pressure(501.0), None),
        (lambda a: a.pressure(-500.0), "out_of_range"),
        (lambda a: a.pressure(1e9), "out_of_range"),
        (lambda a: a.distance(10), "out_of_range"),
    ],
)
def test_bad_message_is_rejected_with_a_reason(
    message: Callable[[Autopilot], bytes], reason: str | None
) -> None:
    result = one(message(Autopilot()))
    assert (result.reason if isinstance(result, Reject) else None) == reason


def test_global_position_is_in_small_units() -> None:
    record = odometry(Autopilot().global_position(vx=100, vy=200, vz=300, hdg=4500))
    assert record.geo is not None
    assert record.geo.latitude_rad == pytest.approx(math.radians(47.3977418))
    assert record.geo.longitude_rad == pytest.approx(math.radians(8.5455939))
    assert record.geo.altitude_m == 488.0
    assert record.velocity_map_mps == pytest.approx([2, 1, -3])
    assert record.heading_rad == pytest.approx(math.radians(45))
    assert odometry(Autopilot().global_position(hdg=65535)).heading_rad is None
    north_west = odometry(Autopilot().global_position(hdg=31500)).heading_rad
    assert north_west == pytest.approx(math.radians(135))


def test_pressure_is_depth_by_the_waters_density() -> None:
    ten_metres_hpa = 1013.25 + 1025 * 9.80665 * 10 / 100
    assert odometry(Autopilot().pressure(ten_metres_hpa)).depth_m == pytest.approx(10, abs=1e-5)
    fresh = FormatSettings(format="mavlink", water_density=998.0, surface_pressure=1000.0)
    hpa = 1000 + 998 * 9.80665 * 10 / 100
    assert odometry(Autopilot().pressure(hpa), fresh).depth_m == pytest.approx(10, abs=1e-5)


def test_only_a_distance_sensor_that_looks_down_reports_the_altitude() -> None:
    assert odometry(Autopilot().distance(250)).altitude_m == pytest.approx(2.5)
    decoder = MavlinkDecoder(SETTINGS)
    assert list(decoder.feed(Autopilot().distance(250, orientation=0), None)) == []
    assert decoder.counters.ignored == {"DISTANCE_SENSOR": 1}


def test_other_systems_are_not_heard() -> None:
    data = b"".join(
        Autopilot(*ids).local_position((1, 2, 3)) for ids in ((1, 1), (1, 194), (255, 1), (2, 1))
    )
    decoder = MavlinkDecoder(SETTINGS)
    assert len(list(decoder.feed(data, None))) == 1
    assert decoder.counters.ignored == {"other_system": 3}
    everybody = FormatSettings(format="mavlink", mavlink_system_id=0, mavlink_component_id=0)
    assert len(list(MavlinkDecoder(everybody).feed(data, None))) == 4


def test_better_message_supersedes_until_it_falls_silent() -> None:
    autopilot, decoder = Autopilot(), MavlinkDecoder(SETTINGS)

    def heard(data: bytes, t_s: float) -> list[Any]:
        return list(decoder.feed(data, round(t_s * SECOND)))

    level = autopilot.attitude((0, 0, 0))
    assert len(heard(level, 0)) == 1
    assert len(heard(autopilot.attitude_quaternion((1, 0, 0, 0)), 1)) == 1
    assert heard(level, 2) == []
    (whole,) = heard(autopilot.global_position(), 2.1)
    assert whole.velocity_map_mps is not None
    assert len(heard(autopilot.local_position((0, 0, 0)), 2.2)) == 1
    assert whole.geo is not None
    assert whole.heading_rad is None
    assert heard(autopilot.global_position(), 2.3) == []
    assert len(heard(level, 3.5)) == 1
    (place,) = heard(autopilot.global_position(), 9)
    assert place.geo is not None
    assert place.heading_rad is None  # a heading is the attitude of a level vehicle alone
    assert decoder.counters.ignored == {"superseded": 2}


def test_a_place_on_earth_is_not_mixed_with_local_positions() -> None:
    autopilot, decoder = Autopilot(), MavlinkDecoder(SETTINGS)
    assert len(list(decoder.feed(autopilot.local_position((0, 0, 0)), 0))) == 1
    (rest,) = decoder.feed(autopilot.global_position(), SECOND)
    assert isinstance(rest, Odometry)
    assert (rest.geo, rest.velocity_map_mps) == (None, None)
    assert rest.heading_rad is not None


def test_a_heading_does_not_level_a_vehicle_that_leans() -> None:
    """What an ArduSub sends all the time: attitude, local and global position, each in turn."""
    source = OdometrySourceConfig(name="autopilot", format="mavlink", link="udp://0.0.0.0:27000")
    bridge = OdometryBridge(Config(odometry=OdometryFusionConfig(sources=(source,))))
    autopilot, began_ns = Autopilot(), 1_700_000_000 * SECOND

    def feed(data: bytes, after_ms: int) -> None:
        autopilot.boot_ms += after_ms
        bridge.feed("autopilot", data, began_ns + autopilot.boot_ms * SECOND // 1000)

    for _ in range(20):
        feed(autopilot.attitude((0.0, math.radians(6), 1.0)), 10)
        feed(autopilot.local_position((5, 3, 2)), 10)
        feed(autopilot.global_position(hdg=5730), 30)
    for ago_ms in range(100, 150, 10):
        fused = bridge.fusion.at(began_ns + (autopilot.boot_ms - ago_ms) * SECOND // 1000)
        assert isinstance(fused, FusedPose)
        assert fused.pose.map_T_base[2, 0] == pytest.approx(math.sin(math.radians(6)), abs=1e-6)
    assert bridge.status()["quantities"]["position"]["rejected"] == {}


def test_reset_counter_and_reboots_are_distinguished() -> None:
    autopilot, decoder = Autopilot(boot_ms=100_000), MavlinkDecoder(SETTINGS)

    def count(data: bytes) -> int:
        (result,) = decoder.feed(data, None)
        assert isinstance(result, Odometry)
        return result.reset_count

    assert count(autopilot.odometry(reset_counter=3)) == 3
    assert count(autopilot.pressure(1100)) == 3  # one counter for the whole link
    autopilot.boot_ms = 99_900
    assert count(autopilot.pressure(1100)) == 3  # overtaken on the way
    autopilot.boot_ms = 200
    assert count(autopilot.odometry(reset_counter=3)) == 256 + 3


def test_boot_time_runs_on_when_its_counter_wraps() -> None:
    autopilot, decoder = Autopilot(), MavlinkDecoder(SETTINGS)
    stamps = []
    for autopilot.boot_ms in (2**32 - 100, 2**32 - 1, 50, 2**32 - 50, 100):
        (result,) = decoder.feed(autopilot.pressure(1100), None)
        assert isinstance(result, Odometry)
        assert result.reset_count == 0
        stamps.append(result.stamp_ns // 1_000_000 - 2**32)
    assert stamps == [-100, -1, 50, -50, 100]


def test_large_microseconds_are_unix_time() -> None:
    record = odometry(Autopilot().odometry(time_usec=1_700_000_000_000_000))
    assert (record.stamp_ns, record.clock) == (1_700_000_000 * SECOND, "unix")


def test_payload_without_its_zeros_is_whole() -> None:
    data = Autopilot().local_position((0, 0, 0))
    assert len(data) < 12 + 28
    assert odometry(data).position_m == pytest.approx([0, 0, 0])


IMUS = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "SCALED_IMU2")
AT_REST_FRD = (0.0, 0.0, -9.80665)


def forces(records: Any) -> list[list[float] | None]:
    return [
        None if one.specific_force_mps2 is None else one.specific_force_mps2.round(2).tolist()
        for one in records
    ]


@pytest.mark.parametrize("kind", IMUS)
@pytest.mark.parametrize("version", [1, 2])
def test_acceleration_goes_with_the_next_attitude(kind: str, version: int) -> None:
    autopilot, decoder = Autopilot(version=version), MavlinkDecoder(SETTINGS)
    data = autopilot.imu(kind, (0.98, -1.96, -9.6)) + autopilot.local_position((0, 0, 0))
    data += autopilot.attitude((0, 0, 0)) * 2
    assert forces(decoder.feed(data, None)) == [None, [0.98, 1.96, 9.6], None]
    assert not decoder.counters.ignored


def test_acceleration_of_long_ago_or_of_a_worse_message_is_left_out() -> None:
    autopilot, decoder = Autopilot(), MavlinkDecoder(SETTINGS)
    imu, attitude = autopilot.imu("SCALED_IMU2", AT_REST_FRD), autopilot.attitude((0, 0, 0))
    assert list(decoder.feed(imu, 0)) == []
    assert forces(decoder.feed(attitude, 3 * SECOND // 10)) == [None]
    list(decoder.feed(imu, SECOND))
    assert forces(decoder.feed(attitude, SECOND * 11 // 10)) == [[0, 0, 9.81]]
    list(decoder.feed(autopilot.imu("SCALED_IMU", (0.0, 0.0, -9.7)) + imu, 2 * SECOND))
    assert forces(decoder.feed(attitude, 2 * SECOND)) == [[0, 0, 9.7]]
    assert decoder.counters.ignored == {"superseded": 1}
    assert list(decoder.feed(autopilot.imu("HIGHRES_IMU", AT_REST_FRD, updated=3), None)) == []
    (bad,) = decoder.feed(autopilot.imu("HIGHRES_IMU", (0.0, 0.0, NAN)), None)
    assert isinstance(bad, Reject)
    assert bad.reason == "not_finite"


def test_waiting_acceleration_is_part_of_the_state() -> None:
    autopilot, decoder, other = Autopilot(), MavlinkDecoder(SETTINGS), MavlinkDecoder(SETTINGS)
    list(decoder.feed(autopilot.imu("SCALED_IMU", AT_REST_FRD), 0))
    other.restore(msgspec.json.decode(msgspec.json.encode(decoder.state())))
    data = autopilot.imu("RAW_IMU", (0.0, 0.0, -9.6)) + autopilot.attitude((0, 0, 0))
    assert forces(other.feed(data, 0)) == forces(decoder.feed(data, 0)) == [[0, 0, 9.81]]
    earlier = msgspec.json.decode(msgspec.json.encode(MavlinkDecoder(SETTINGS).state()[:5]))
    other.restore(earlier)
    assert forces(other.feed(autopilot.attitude((0, 0, 0)), 0)) == [None]


def test_world_of_a_tilted_autopilot_is_levelled_by_its_accelerations() -> None:
    config = Config(
        odometry=OdometryFusionConfig(sources=(OdometrySourceConfig(name="ap", format="mavlink"),)),
        world_init=WorldInitConfig(enabled=True, init_samples=20),
    )
    bridge, autopilot, t_ns = OdometryBridge(config), Autopilot(), SECOND
    tilted = (0.0, 9.80665 * 0.5, -9.80665 * math.sqrt(0.75))  # 30 degrees to starboard
    for _ in range(40):
        autopilot.boot_ms += 100
        t_ns += SECOND // 10
        for data in (
            autopilot.imu("SCALED_IMU", tilted),
            autopilot.attitude((0, 0, 0)),
            autopilot.local_position((1, 0, 0)),
        ):
            bridge.feed("ap", data, t_ns)
    fused = bridge.fusion.at(t_ns - SECOND // 5)
    assert isinstance(fused, FusedPose)
    port = quaternion_to_matrix(fused.pose.map_q_base)[:, 1]
    assert abs(port[2]) == pytest.approx(0.5, abs=0.01)
