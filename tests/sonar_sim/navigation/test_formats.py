"""The vehicle's odometry, decoded by mapperd, pymavlink, pynmea2 and tables of the protocols."""

import json
import math
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pynmea2
import pytest
from pymavlink.dialects.v20 import common
from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.pose import FramePose, rotation_of
from sonar_sim.navigation.fix import Fix
from sonar_sim.navigation.formats import FORMATS, format_named
from sonar_sim.navigation.water_linked import crc8, sentence
from sonar_sim.scene.vehicle import OdometryErrors, OdometrySample, Vehicle
from sonar_sim.scene.water import Water

from mapperd.geometry.frames import rotation_from_rpy
from mapperd.odometry.native import decode_native
from mapperd.odometry.records import Odometry

# 3 m east, 20 m north, 7 m deep; nose 10 deg down, rolled 5 deg to starboard, heading 60 deg.
EAST_M, NORTH_M, DEPTH_M = 3.0, 20.0, 7.0
ROLL_DEG, NOSE_DOWN_DEG, HEADING_DEG = 5.0, 10.0, 60.0
VALID_NS = 1_790_000_000_123_456_789


@pytest.fixture
def fix() -> Fix:
    rotation = rotation_of(*(math.radians(a) for a in (ROLL_DEG, NOSE_DOWN_DEG, 90 - HEADING_DEG)))
    sample = OdometrySample(
        time_s=4.0,
        arrival_s=4.01,
        pose=FramePose(np.array([EAST_M, NORTH_M, -DEPTH_M]), rotation),
        velocity_mps=np.array([0.5, 0.2, 0.1]),  # ahead, to port, up
        turn_rates_rps=np.array([0.01, 0.02, 0.03]),
    )
    errors = OdometryErrors(
        position_noise_m=0.02,
        attitude_noise_deg=0.5,
        velocity_noise_mps=0.01,
        turn_rate_noise_dps=0.1,
    )
    vehicle = Vehicle(errors=errors, latitude_deg=-33.0, longitude_deg=151.5)
    return Fix(sample, VALID_NS, VALID_NS + 10_000_000, 104.0, 4.2, vehicle, Water())


def decoded(data: bytes) -> dict[str, Any]:
    reader = common.MAVLink(None)
    messages = reader.parse_buffer(data)
    assert b"".join(bytes(message.get_msgbuf()) for message in messages) == data
    return {message.get_type(): message for message in messages}


def test_native_is_what_the_daemon_reads(fix: Fix) -> None:
    (data,) = format_named("native").encode(fix)
    odometry = decode_native(data)
    assert isinstance(odometry, Odometry)
    assert (odometry.stamp_ns, odometry.clock) == (VALID_NS, "unix")
    assert odometry.position_m == pytest.approx([EAST_M, NORTH_M, -DEPTH_M])
    expected = rotation_from_rpy(ROLL_DEG, NOSE_DOWN_DEG, 90 - HEADING_DEG)
    assert odometry.map_q_base is not None
    assert abs(odometry.map_q_base @ expected) == pytest.approx(1.0)
    assert odometry.velocity_mps == pytest.approx([0.5, 0.2, 0.1])


def test_mavlink_odometry_as_pymavlink_reads_it(fix: Fix) -> None:
    (data,) = format_named("mavlink-odometry").encode(fix)
    messages = decoded(data)
    assert set(messages) == {"HEARTBEAT", "SYSTEM_TIME", "ODOMETRY"}
    odometry = messages["ODOMETRY"]
    assert (odometry.frame_id, odometry.child_frame_id, odometry.time_usec) == (1, 12, 104_000_000)
    assert (odometry.x, odometry.y, odometry.z) == pytest.approx((NORTH_M, EAST_M, DEPTH_M))
    assert (odometry.vx, odometry.vy, odometry.vz) == pytest.approx((0.5, -0.2, -0.1))
    turns = (odometry.rollspeed, odometry.pitchspeed, odometry.yawspeed)
    assert turns == pytest.approx((0.01, -0.02, -0.03))
    assert _ned_angles_deg(odometry.q) == pytest.approx((ROLL_DEG, -NOSE_DOWN_DEG, HEADING_DEG))
    diagonal = [odometry.pose_covariance[k] for k in (0, 6, 11, 15, 18, 20)]
    assert diagonal == pytest.approx([4e-4] * 3 + [math.radians(0.5) ** 2] * 3)
    assert sum(number != 0.0 for number in odometry.pose_covariance) == 6
    assert odometry.velocity_covariance[0] == pytest.approx(1e-4)


def test_mavlink_on_the_wire_is_the_protocols_own(fix: Fix) -> None:
    (data,) = format_named("mavlink-odometry").encode(fix)
    _, _, frame = _frames(data)
    assert frame[0] == 0xFD
    assert (frame[5], frame[6], int.from_bytes(frame[7:10], "little")) == (1, 1, 331)
    crc = _x25(frame[1 : 10 + frame[1]] + bytes([91]))
    assert int.from_bytes(frame[10 + frame[1] :][:2], "little") == crc
    payload = frame[10 : 10 + frame[1]].ljust(233, b"\0")
    fields = struct.unpack("<Q3f4f3f3f21f21fBBBBb", payload)
    assert fields[0] == 104_000_000
    assert fields[1:4] == pytest.approx((NORTH_M, EAST_M, DEPTH_M))
    assert fields[-5:] == (1, 12, 0, common.MAV_ESTIMATOR_TYPE_AUTOPILOT, 100)


def test_what_is_not_known_is_nan(fix: Fix) -> None:
    silent = replace(fix, vehicle=Vehicle(errors=OdometryErrors(position_noise_m=0.0)))
    (data,) = format_named("mavlink-odometry").encode(silent)
    assert math.isnan(decoded(data)["ODOMETRY"].pose_covariance[0])
    assert math.isnan(decoded(data)["ODOMETRY"].velocity_covariance[0])


def test_mavlink_of_a_vehicle_without_odometry_message(fix: Fix) -> None:
    form = format_named("mavlink-ardusub")
    messages = decoded(form.encode(fix)[0])
    position, attitude = messages["LOCAL_POSITION_NED"], messages["ATTITUDE"]
    assert position.time_boot_ms == attitude.time_boot_ms == 104_000
    assert (position.x, position.y, position.z) == pytest.approx((NORTH_M, EAST_M, DEPTH_M))
    body = fix.ned_R_frd.T @ [position.vx, position.vy, position.vz]  # world there, body here
    assert body == pytest.approx([0.5, -0.2, -0.1], abs=1e-6)
    angles = [math.degrees(a) for a in (attitude.roll, attitude.pitch, attitude.yaw)]
    assert angles == pytest.approx([ROLL_DEG, -NOSE_DOWN_DEG, HEADING_DEG], abs=1e-5)
    world = messages["GLOBAL_POSITION_INT"]
    assert world.hdg == 6000
    assert (world.alt, world.relative_alt) == (-7000, -7000)
    # One degree of latitude is 110.9 km at 33 deg south, one of longitude 93.4 km.
    assert (world.lat / 1e7 + 33.0) * 110_904 == pytest.approx(NORTH_M, abs=0.05)
    assert (world.lon / 1e7 - 151.5) * 93_453 == pytest.approx(EAST_M, abs=0.05)
    pressure = messages["SCALED_PRESSURE2"]
    assert pressure.press_abs == pytest.approx(1013.25 + 7.0 * 100.8, abs=0.5)  # 0.1008 bar a metre
    assert pressure.temperature == 1000
    assert "HEARTBEAT" not in decoded(form.encode(fix)[0])  # one a second


def test_mavlink_of_a_vehicle_without_a_dvl_has_no_position(fix: Fix) -> None:
    form = format_named("mavlink-attitude")
    form.encode(fix)  # with the heartbeat
    assert set(decoded(form.encode(fix)[0])) == {"ATTITUDE", "SCALED_PRESSURE2"}


def test_dvl_json(fix: Fix) -> None:
    form = format_named("waterlinked")
    velocity, reckoned = (json.loads(line) for line in form.encode(fix))
    assert (velocity["type"], velocity["velocity_valid"]) == ("velocity", True)
    speeds = velocity["vx"], velocity["vy"], velocity["vz"]
    assert speeds == pytest.approx((0.5, -0.2, -0.1))
    assert velocity["time_of_validity"] == VALID_NS // 1000
    assert velocity["time_of_transmission"] - velocity["time_of_validity"] == 10_000
    assert velocity["altitude"] == 4.2
    assert [beam["id"] for beam in velocity["transducers"]] == [0, 1, 2, 3]
    beams = np.array([beam["velocity"] for beam in velocity["transducers"]])
    assert beams.mean() / math.cos(math.radians(22.5)) == pytest.approx(-0.1)  # they share down
    assert reckoned["ts"] == pytest.approx(VALID_NS / 1e9)
    assert (reckoned["x"], reckoned["y"], reckoned["z"]) == (0.0, 0.0, 0.0)
    assert reckoned["yaw"] == pytest.approx(0.0, abs=1e-9)
    assert reckoned["pitch"] == pytest.approx(-NOSE_DOWN_DEG)
    pose = fix.sample.pose
    ahead = np.array([math.sin(math.radians(60)), math.cos(math.radians(60)), -0.5])
    moved = replace(fix.sample, pose=FramePose(pose.position_m + ahead, pose.rotation))
    later = replace(fix, sample=moved, boot_s=104.25)
    velocity, reckoned = (json.loads(line) for line in form.encode(later))
    assert velocity["time"] == pytest.approx(250.0)
    there = reckoned["x"], reckoned["y"], reckoned["z"]
    assert there == pytest.approx((1.0, 0.0, 0.5), abs=1e-9)
    assert len(form.encode(replace(later, boot_s=104.3))) == 1  # dead reckoning comes at 5 Hz


def test_dvl_without_bottom(fix: Fix) -> None:
    (data, _) = format_named("waterlinked").encode(replace(fix, altitude_m=None))
    velocity = json.loads(data)
    assert velocity["velocity_valid"] is False
    assert velocity["altitude"] == -1
    assert velocity["time_of_validity"] == VALID_NS // 1000


def test_dvl_checksum_is_crc_8_with_polynomial_7() -> None:
    assert crc8(b"123456789") == 0xF4  # the check value of the catalogues
    assert sentence("wrx", "1") == b"wrx,1*%02x\r\n" % crc8(b"wrx,1")


def test_dvl_serial(fix: Fix) -> None:
    *beams, velocity, reckoned = format_named("waterlinked-serial").encode(fix)
    for line in (*beams, velocity, reckoned):
        text, _, checksum = line.partition(b"*")
        assert checksum == b"%02x\r\n" % crc8(text)
    assert [beam[:6] for beam in beams] == [b"wru,%d," % number for number in range(4)]
    parts = velocity.partition(b"*")[0].decode().split(",")
    assert parts[:7] == ["wrz", "0.500", "-0.200", "-0.100", "y", "4.20", "0.010"]
    assert len(parts) == 12
    assert len(parts[7].split(";")) == 9
    assert parts[8] == str(VALID_NS // 1000)
    fields = reckoned.partition(b"*")[0].decode().split(",")
    assert fields[0] == "wrp"
    assert len(fields) == 10
    assert [float(part) for part in fields[6:]] == [5.0, -10.0, 0.0, 0.0]


def test_nmea_as_pynmea2_reads_it(fix: Fix) -> None:
    form = format_named("nmea")
    lines = [line.decode("ascii") for line in form.encode(fix)]
    assert all(line.endswith("\r\n") for line in lines)
    read = {line[1:6]: pynmea2.parse(line.strip(), check=True) for line in lines}
    assert set(read) == {"GPGGA", "GPRMC", "GPVTG", "GPHDT", "PRDID", "PASHR"}
    gga = read["GPGGA"]
    assert (gga.latitude + 33.0) * 110_904 == pytest.approx(NORTH_M, abs=0.05)
    assert (gga.longitude - 151.5) * 93_453 == pytest.approx(EAST_M, abs=0.05)
    assert (gga.lat_dir, gga.lon_dir, gga.altitude) == ("S", "E", -7.0)
    utc = "2026-09-21T14:13:20.120000+00:00"  # of 1 790 000 000.12 s
    assert read["GPRMC"].datetime.isoformat() == utc
    assert float(read["GPHDT"].heading) == HEADING_DEG
    north, east, _ = fix.velocity_ned_mps
    course = math.degrees(math.atan2(east, north)) % 360
    assert float(read["GPVTG"].true_track) == pytest.approx(course, abs=0.01)
    assert float(read["GPVTG"].spd_over_grnd_kts) == pytest.approx(
        math.hypot(north, east) * 1.94384, abs=1e-3
    )
    angles = [float(part) for part in lines[1].partition("*")[0].split(",")[1:]]
    assert angles == [-NOSE_DOWN_DEG, ROLL_DEG, HEADING_DEG]  # pitch, roll, heading
    assert lines[2].startswith("$PASHR,141320.12,60.00,T,+5.00,-10.00,-7.00,")
    assert len(form.encode(replace(fix, boot_s=104.5))) == 3  # positions come once a second


def test_a_heading_never_is_360_nor_minutes_60(fix: Fix) -> None:
    north = FramePose(np.zeros(3), rotation_of(0.0, 0.0, math.radians(90.0 + 1e-4)))
    vehicle = Vehicle(latitude_deg=53.999999999999, longitude_deg=-8.1)
    at_north = replace(fix, sample=replace(fix.sample, pose=north), vehicle=vehicle)
    lines = [line.decode() for line in format_named("nmea").encode(at_north)]
    assert "$GPHDT,0.00,T" in lines[0]
    assert ",5400.0000000,N,00806.0000000,W," in lines[3]


def test_unknown_formats_are_reported() -> None:
    with pytest.raises(SonarSimError, match=r"'nema'.*native"):
        format_named("nema")
    for name in FORMATS:
        format_named(name)


def _ned_angles_deg(q: Any) -> tuple[float, float, float]:
    w, x, y, z = q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(2 * (w * y - z * x))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def _frames(data: bytes) -> list[bytes]:
    frames = []
    while data:
        size = 12 + data[1]
        frames.append(data[:size])
        data = data[size:]
    return frames


def _x25(data: bytes) -> int:
    """CRC-16, reflected 0x8408, start 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0x8408 if crc & 1 else crc >> 1
    return crc


def test_a_kilometre_is_a_kilometre_on_the_ellipsoid(fix: Fix) -> None:
    far = replace(fix.sample, pose=FramePose(np.array([1e3, 1e3, 0.0]), fix.sample.pose.rotation))
    latitude_deg, longitude_deg = replace(fix, sample=far).latitude_longitude_deg
    # Length of a degree at 33 deg: the usual series in cosines of the latitude (WGS-84).
    assert (latitude_deg + 33.0) * 110_904.5 == pytest.approx(1e3, abs=0.05)
    assert (longitude_deg - 151.5) * 93_453.2 == pytest.approx(1e3, abs=0.05)
