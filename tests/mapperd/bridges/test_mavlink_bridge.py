"""The bridge to an autopilot, with pymavlink as the autopilot."""

import asyncio
import gc
import math
import signal
import sys
import tracemalloc
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega

from mapperd.bridges.mavlink import AutopilotBridge
from mapperd.cli.mapperctl.command import main
from mapperd.client.changes import ClientChange
from mapperd.config.tree import MavlinkConfig
from mapperd.errors import ConfigError
from mapperd.wire.blocks import CELLS, BlockSet
from mapperd.wire.messages import EventMessage, PoseMessage, SettingsMessage, StatusMessage
from tests.mapperd.bridges.bridge_fakes import (
    T0,
    BridgeStream,
    S,
    a_ping,
    a_pose,
    a_status,
    beat,
    linked,
    sure,
)
from tests.support.process import free_port
from tests.support.stream_server import Served, Server
from tests.support.waiting import until

POSES = MavlinkConfig(obstacle_rate=0.0, text_rate=0.0)
ODOMETRY = msgspec.structs.replace(POSES, message="odometry")
TEXTS = MavlinkConfig(pose_rate=0.0, obstacle_rate=0.0)
OBSTACLES = MavlinkConfig(pose_rate=0.0, text_rate=0.0)


class Peer:
    """An autopilot beside a bridge, on a clock of its own."""

    def __init__(self, config: MavlinkConfig) -> None:
        self.stream = BridgeStream()
        self.lines: list[str] = []
        self.bridge = AutopilotBridge(self.stream, config, self.lines.append)
        self.now_s = 100.0
        self._reader = ardupilotmega.MAVLink(None)
        self._sender = ardupilotmega.MAVLink(None, 1, 1)
        self.give(linked("connected"))

    def give(self, *changes: ClientChange) -> list[Any]:
        """Give changes; a heartbeat comes with each pose."""
        frames: list[bytes] = []
        for change in changes:
            if isinstance(change, PoseMessage):
                frames += self.bridge.take(StatusMessage(stamp_ns=change.stamp_ns), self.now_s)
            frames += self.bridge.take(change, self.now_s)
        return self._read(frames)

    def give_alone(self, *changes: ClientChange) -> list[Any]:
        frames = [frame for change in changes for frame in self.bridge.take(change, self.now_s)]
        return self._read(frames)

    def pass_s(self, seconds: float) -> list[Any]:
        read = []
        for _ in range(max(round(seconds / 0.05), 1)):
            self.now_s += 0.05
            read += self._read(self.bridge.tick(self.now_s))
        return read

    def beat(self, autopilot: int = ardupilotmega.MAV_AUTOPILOT_ARDUPILOTMEGA) -> None:
        message = self._sender.heartbeat_encode(12, autopilot, 0, 0, 4)
        self.bridge.heard(bytes(message.pack(self._sender)), self.now_s)

    def _read(self, frames: Iterable[bytes]) -> list[Any]:
        return [message for frame in frames for message in self._reader.parse_buffer(frame) or ()]


def drive(peer: Peer, seconds: float, rate_hz: float = 10.0) -> list[Any]:
    """Poses of a vehicle that moves along x."""
    read = []
    for number in range(round(seconds * rate_hz)):
        at_s = number / rate_hz
        read += peer.give(sure(), a_pose(at_s, (at_s, 0.0, -5.0)))
        peer.now_s += 1 / rate_hz
    return read


def test_a_sure_pose_is_a_vision_position_in_ned() -> None:
    peer = Peer(POSES)
    (message,) = peer.give(sure(), a_pose(0.5, (1.0, 2.0, -5.0), 0.0))
    assert message.get_type() == "VISION_POSITION_ESTIMATE"
    assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 197)
    assert message.usec == (T0 + S // 2) // 1000
    assert (message.x, message.y, message.z) == pytest.approx((2.0, 1.0, 5.0))
    assert (message.roll, message.pitch) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert message.yaw == pytest.approx(math.pi / 2)  # heads east
    covariance = np.zeros((6, 6))
    covariance[np.triu_indices(6)] = message.covariance
    # x is north: its variance is that of the map's y; the vehicle's pitch is about north.
    assert np.diag(covariance) == pytest.approx([0.09, 0.04, 0.01, 0.001, 0.002, 0.003], rel=1e-5)
    assert message.reset_counter == 0


def test_odometry_has_velocity_in_the_body_and_states_its_frames() -> None:
    peer = Peer(ODOMETRY)
    (message,) = peer.give(sure(), a_pose(0.0, (1.0, 2.0, -5.0), math.pi / 2))
    assert message.get_type() == "ODOMETRY"
    assert (message.frame_id, message.child_frame_id) == (1, 12)  # LOCAL_NED, BODY_FRD
    assert (message.x, message.y, message.z) == pytest.approx((2.0, 1.0, 5.0))
    assert message.q == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-6)  # heads north
    assert (message.vx, message.vy, message.vz) == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert math.isnan(message.rollspeed)
    assert math.isnan(message.velocity_covariance[0])
    assert message.time_usec == T0 // 1000


def test_ardupilot_gets_the_only_frame_that_it_takes() -> None:
    peer = Peer(ODOMETRY)
    peer.beat()
    (message,) = peer.give(sure(), a_pose())
    assert (message.frame_id, message.child_frame_id) == (20, 12)  # LOCAL_FRD, BODY_FRD
    assert (message.x, message.y) == pytest.approx((2.0, 1.0))  # north is forward
    other = Peer(ODOMETRY)
    other.beat(ardupilotmega.MAV_AUTOPILOT_PX4)
    assert other.give(sure(), a_pose())[0].frame_id == 1


def test_a_map_of_unknown_heading_is_frd() -> None:
    peer = Peer(msgspec.structs.replace(ODOMETRY, frame="frd"))
    (message,) = peer.give(sure(), a_pose(0.0, (1.0, 2.0, -5.0), 0.3))
    assert message.frame_id == 20
    assert (message.x, message.y, message.z) == pytest.approx((1.0, -2.0, 5.0))
    w, _, _, z = message.q
    assert 2 * math.atan2(z, w) == pytest.approx(-0.3, abs=1e-6)


@pytest.mark.parametrize("rate_hz", [1.0, 4.0, 10.0])
def test_poses_arrive_at_the_set_rate(rate_hz: float) -> None:
    peer = Peer(msgspec.structs.replace(POSES, pose_rate=rate_hz))
    read = drive(peer, 20.0)
    assert len(read) == pytest.approx(20 * rate_hz, abs=1)
    assert {message.reset_counter for message in read} == {0}


@pytest.mark.parametrize(
    "doubt",
    [
        {"state": "ambiguous"},
        {"state": "lost"},
        {"sure": False},
        {"state": "waiting for a pose", "pose": None, "map_odom": None},
    ],
)
def test_nothing_is_sent_while_localization_is_not_sure(doubt: dict[str, Any]) -> None:
    peer = Peer(POSES)
    assert peer.give(sure(), a_pose(0.0))
    peer.now_s += 1
    for number in range(10):
        assert peer.give(sure(**doubt), a_pose(0.1 + number / 10)) == []
        peer.now_s += 1
    assert peer.bridge.reason.startswith("localization: ")
    (again,) = peer.give(sure(), a_pose(1.2))
    assert again.reset_counter == 1  # it may be another estimate


def test_a_doubt_without_a_pose_counts_as_a_reset() -> None:
    # With mapping: corrected the daemon has no pose while it is not sure.
    peer = Peer(POSES)
    assert peer.give(sure(), a_pose(0.0))[0].reset_counter == 0
    peer.now_s += 1
    assert peer.give(sure(state="ambiguous")) == []
    assert peer.give(sure(), a_pose(1.0))[0].reset_counter == 1


def test_a_ping_without_a_transform_of_its_own_is_no_doubt() -> None:
    peer = Peer(POSES)
    first, *_ = peer.give(sure(), a_pose(0.0, source="odometry"))
    peer.now_s += 1
    again, *_ = peer.give(sure(map_odom=None), a_pose(1.0, source="odometry"))
    assert again.reset_counter == first.reset_counter


def test_a_report_that_is_not_renewed_is_not_sure_for_ever() -> None:
    peer = Peer(POSES)
    assert peer.give(sure(), a_pose(0.0))[0].reset_counter == 0
    for _ in range(3):
        peer.now_s += 0.9
        assert peer.give(a_pose(peer.now_s - 100))
    for _ in range(5):
        peer.now_s += 0.9
        assert peer.give(a_pose(peer.now_s - 100)) == []
    assert peer.bridge.reason == "localization: no report"
    assert peer.give(sure(), a_pose(peer.now_s - 100))[0].reset_counter == 1


def test_odometry_goes_on_where_nothing_localizes() -> None:
    peer = Peer(msgspec.structs.replace(POSES, poses="all"))
    peer.give(sure(state="off"))
    peer.now_s += 60
    assert peer.give(a_pose(60.0, source="odometry"))


def test_nothing_is_sent_before_localization_states_that_it_is_sure() -> None:
    peer = Peer(POSES)
    assert peer.give(a_pose(0.0)) == []
    assert peer.give(a_pose(0.1, source="odometry")) == []
    assert peer.give(a_pose(0.2, source="fixed")) == []


def test_a_jump_counts_the_resets_up() -> None:
    peer = Peer(msgspec.structs.replace(POSES, pose_rate=50.0))
    counters = []
    for at_s, x_m in ((0.0, 0.0), (0.1, 0.1), (0.2, 3.0), (0.3, 3.1), (0.4, 0.4)):
        counters += [m.reset_counter for m in peer.give(sure(), a_pose(at_s, (x_m, 0.0, -5.0)))]
        peer.now_s += 0.1
    assert counters == [0, 0, 1, 1, 2]


def test_another_session_of_the_daemon_is_a_reset() -> None:
    peer = Peer(POSES)
    assert peer.give(sure(), a_pose(0.0))[0].reset_counter == 0
    peer.give(linked("waiting", "gone"))
    peer.now_s += 1
    assert peer.give(a_pose(0.1)) == []  # an old state of localization means nothing now
    peer.give(linked("waiting", "gone"), peer.stream.connect("s-2"))
    (message,) = peer.give(sure(), a_pose(0.3))
    assert message.reset_counter == 1


def test_a_broken_link_to_the_same_session_is_none() -> None:
    peer = Peer(POSES)
    peer.give(sure(), a_pose(0.0))
    peer.now_s += 1
    peer.give(linked("waiting", "gone"), linked("connected"))
    (message,) = peer.give(sure(), a_pose(0.3))
    assert message.reset_counter == 0


def test_odometry_of_a_slam_is_sent_where_it_is_wanted() -> None:
    peer = Peer(msgspec.structs.replace(POSES, poses="all"))
    # Until the state is known, this may be a vehicle that localizes, in another frame.
    assert peer.give(a_pose(source="odometry")) == []
    peer.now_s += 1
    (message,) = peer.give(a_status(localization=None), a_pose(1.0, source="odometry"))
    assert (message.x, message.y) == pytest.approx((2.0, 1.0))


@pytest.mark.parametrize("source", ["localization", "odometry"])
def test_another_origin_of_the_pose_is_a_reset(source: str) -> None:
    peer = Peer(msgspec.structs.replace(POSES, poses="all"))
    counters = []
    for at_s, state in ((0.0, sure()), (0.2, sure()), (0.4, sure(state="off")), (0.6, None)):
        peer.give(*([] if state is None else [state]))
        by = source if at_s < 0.3 else "odometry"
        (message,) = peer.give(a_pose(at_s, (at_s, 2.0, -5.0), source=by))
        counters.append(message.reset_counter)
        peer.now_s += 0.2
    assert counters == [0, 0, 1, 1]


def test_a_heartbeat_without_a_status_says_nothing_of_localization() -> None:
    peer = Peer(msgspec.structs.replace(POSES, poses="all"))
    by_odometry = a_pose(source="odometry")
    assert peer.give(beat(), by_odometry) == []
    localizes = a_status(localization={"state": "waiting for a pose"})
    assert peer.give(localizes, beat(), by_odometry) == []
    off = a_status(localization=None)
    peer.now_s += 1
    assert peer.give(off, beat(), by_odometry)
    peer.give(linked("waiting", "gone"), peer.stream.connect("s-2"))
    peer.now_s += 1
    assert peer.give(beat(), by_odometry) == []  # another session may localize


def test_an_old_pose_is_not_sent_however_often_the_daemon_is_found() -> None:
    peer = Peer(msgspec.structs.replace(POSES, obstacle_rate=10.0))
    old = a_pose(0.0)
    assert peer.give_alone(sure(), old) == []  # how old it is, is not known
    for _ in range(3):
        peer.give_alone(linked("waiting", "gone"), linked("connected"))
        assert peer.give_alone(beat(1.1), sure(), old) == []
        assert peer.bridge.reason == "pose is old"
        peer.now_s += 1
    assert len(peer.give_alone(beat(20.0), sure(), a_pose(19.1))) == 2
    peer.now_s += 0.8
    assert peer.give_alone(a_pose(19.7)) == []  # 1.1 s old
    assert peer.give_alone(a_pose(19.9))


def test_an_old_state_of_localization_is_not_sure() -> None:
    peer = Peer(POSES)
    moved = {"position_m": [3.0, 0.0, 0.0], "orientation_wxyz": [1.0, 0.0, 0.0, 0.0]}
    fresh = a_pose(0.0, source="odometry")
    for age_s, sent in ((-1.0, 1), (2.9, 1), (3.1, 0)):
        peer.give_alone(linked("waiting", "gone"), linked("connected"), beat())
        report = sure(map_odom=moved | {"t_s": T0 / S - age_s})
        assert len(peer.give_alone(report, fresh)) == sent
        peer.now_s += 1
    assert peer.bridge.reason == "localization: no report"


def test_an_autopilot_never_gets_its_own_odometry() -> None:
    peer = Peer(msgspec.structs.replace(POSES, poses="all"))
    own = {"odometry.sources": {"value": [{"name": "a", "format": "mavlink"}]}}
    with pytest.raises(ConfigError, match="its own poses"):
        peer.give(SettingsMessage(facts=own))
    other = {"odometry.sources": {"value": [{"name": "a", "format": "native"}]}}
    assert peer.give(SettingsMessage(facts=other)) == []
    assert Peer(POSES).give(SettingsMessage(facts=own)) == []


def test_obstacles_come_from_the_map_and_the_latest_ping() -> None:
    peer = Peer(OBSTACLES)
    cells = np.full((1, CELLS), -128, np.int8)
    cells[0, 3 + 8 * 4 + 64 * 6] = 40  # centre at (9.75, 2.25, -4.75)
    assert peer.stream.mirror is not None
    key = np.array([[2, 0, -2]], np.int32)
    peer.stream.mirror.put(BlockSet(key, np.zeros(1, np.uint32), cells), 5)
    ping = a_ping(0.0, [(0.0, -4.0, 0.0), (0.0, 3.0, 2.0)])  # to starboard; another too high
    (message,) = peer.give(ping, a_pose(0.1))
    assert message.get_type() == "OBSTACLE_DISTANCE"
    assert (message.frame, message.increment_f, message.angle_offset) == (12, 5.0, 0.0)
    assert (message.min_distance, message.max_distance) == (0, 2000)
    assert message.distances[18] == 400
    assert message.distances[0] == pytest.approx(850, abs=2)
    assert {*message.distances} - {400, message.distances[0]} <= {65535, *message.distances[70:]}
    assert message.time_usec == (T0 + S // 10) // 1000


def test_obstacles_of_an_old_ping_or_without_a_pose_are_none() -> None:
    peer = Peer(OBSTACLES)
    assert peer.give(a_ping(0.0)) == []
    assert {*peer.give(a_pose(5.0))[0].distances} == {65535}
    peer.now_s += 1
    nowhere = a_ping(6.0, sonar_position_m=None)
    assert {*peer.give(nowhere, a_pose(6.0))[0].distances} == {65535}


def test_obstacles_arrive_at_their_rate() -> None:
    peer = Peer(msgspec.structs.replace(OBSTACLES, obstacle_rate=2.0))
    assert len(drive(peer, 10.0)) == pytest.approx(20, abs=1)


def texts(read: Iterable[Any]) -> list[tuple[int, str]]:
    return [(one.severity, one.text) for one in read if one.get_type() == "STATUSTEXT"]


def test_a_lost_sonar_and_a_full_disk_are_told_once_and_their_end() -> None:
    peer = Peer(TEXTS)
    peer.pass_s(2)  # that the daemon is connected
    peer.give(a_status("no_sonar"))
    assert texts(peer.pass_s(3)) == []  # one look may be wrong
    for _ in range(5):
        peer.give(a_status("sonar_silent", "recording_paused", "no_odometry"))
    told = [(3, "sonar_silent: it is so"), (3, "recording_paused: it is so")]
    assert texts(peer.pass_s(5)) == told
    for _ in range(3):
        peer.give(a_status("recording_paused"))
    assert texts(peer.pass_s(5)) == [(5, "sonar: pings again")]
    peer.give(a_status())
    assert texts(peer.pass_s(5)) == [(5, "recording goes on")]


def test_texts_keep_their_rate_and_long_ones_come_in_pieces() -> None:
    peer = Peer(msgspec.structs.replace(TEXTS, text_rate=0.5))
    peer.pass_s(3)
    for number in range(20):
        event = {"code": f"save_{number}", "severity": "error", "text": f"{number} " + "x" * 120}
        peer.give(EventMessage(event=event))
    read = [one for one in peer.pass_s(10) if one.get_type() == "STATUSTEXT"]
    assert len(read) in (12, 15, 18)
    assert [one.chunk_seq for one in read[:3]] == [0, 1, 2]
    assert len({one.id for one in read}) == len(read) // 3
    assert min(one.id for one in read) > 0
    first = "".join(one.text for one in read[:3])
    assert first == "4 " + "x" * 120  # the oldest made room for the newest 16


def test_a_lost_daemon_is_told() -> None:
    peer = Peer(TEXTS)
    assert texts(peer.pass_s(1)) == [(5, "mapperd: connected")]
    peer.give(linked("waiting", "no such file"), linked("connecting"), linked("waiting", "no"))
    assert texts(peer.pass_s(5)) == [(4, "mapperd: connection lost")]
    assert len([line for line in peer.lines if "waiting" in line]) == 1


def test_heartbeats_say_that_a_computer_is_there() -> None:
    peer = Peer(MavlinkConfig(pose_rate=0, obstacle_rate=0, text_rate=0))
    beats = [one for one in peer.pass_s(10) if one.get_type() == "HEARTBEAT"]
    assert len(beats) == pytest.approx(10, abs=1)
    assert {(one.type, one.autopilot) for one in beats} == {(18, 8)}


def test_an_autopilot_that_comes_and_goes_is_one_line_each() -> None:
    peer = Peer(POSES)
    del peer.lines[:]
    for _ in range(10):
        peer.beat()
        peer.beat(ardupilotmega.MAV_AUTOPILOT_INVALID)  # a ground station on the same link
        peer.pass_s(1)
    peer.pass_s(20)
    peer.beat()
    assert [line.split()[1] for line in peer.lines] == ["heard", "silent", "heard"]


def test_other_bytes_are_no_heartbeat() -> None:
    peer = Peer(POSES)
    random = np.random.default_rng(2)
    for start in (b"", b"\xfd", b"\xfe", b"\xfd\x09\0\0\0\1\1\0\0\0"):
        for size in (0, 3, 20, 300):
            peer.bridge.heard(start + random.bytes(size), peer.now_s)
    assert not any("heard" in line for line in peer.lines)


@pytest.mark.parametrize("reconnects", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_reconnects_leave_nothing_behind(reconnects: int) -> None:
    peer = Peer(MavlinkConfig())

    def reconnect(number: int) -> None:
        peer.give(linked("waiting", f"reason {number}"), peer.stream.connect(f"s-{number}"))
        peer.give(sure(), a_pose(number), a_ping(number), a_status("no_sonar"))
        peer.beat()
        peer.pass_s(0.05)

    for number in range(200):
        reconnect(number)
    del peer.lines[:]
    gc.collect()
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for number in range(200, 200 + reconnects):
        reconnect(number)
        if number % 100 == 0:
            del peer.lines[:]  # a terminal keeps them, not the bridge
    del peer.lines[:]
    gc.collect()
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 50_000


@pytest.mark.net
def test_an_autopilot_on_the_network_hears_the_program(short: Path) -> None:
    """pymavlink listens; the daemon is lost and comes again; each loss is one line."""
    port = free_port()

    async def run() -> None:
        autopilot: Any = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=1)
        served = Served(status_s=0.05)
        code = "import sys; from mapperd.cli.mapperctl.command import main; sys.exit(main())"
        given = ["mavlink", "--to", f"udp://127.0.0.1:{port}", "--socket", str(short / "m.sock")]
        program = await asyncio.create_subprocess_exec(
            sys.executable,
            "-c",
            code,
            *given,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        read: list[Any] = []

        def hears(kind: str, **fields: object) -> bool:
            while (message := autopilot.recv_match(blocking=False)) is not None:
                read.append(message)
            return any(
                one.get_type() == kind
                and all(getattr(one, name) == value for name, value in fields.items())
                for one in read
            )

        await until(lambda: hears("HEARTBEAT", type=18))
        autopilot.mav.heartbeat_send(12, 3, 0, 0, 4)
        for _ in range(2):
            async with Server(served, short / "m.sock") as server:
                await until(lambda: hears("STATUSTEXT", text="mapperd: connected"))
                server.connections[0].send(sure(), a_pose(0.0, (1.0, 2.0, -5.0)))
                await until(lambda: hears("VISION_POSITION_ESTIMATE"))
            await until(lambda: hears("STATUSTEXT", text="mapperd: connection lost"))
            read.clear()
        program.send_signal(signal.SIGTERM)
        out, err = await program.communicate()
        assert (program.returncode, err) == (0, b"")
        lines = out.decode().splitlines()
        assert sum("connected" in line for line in lines) == 2
        assert sum("waiting" in line for line in lines) == 3
        assert sum("autopilot: heard system 1" in line for line in lines) == 1
        autopilot.close()

    asyncio.run(asyncio.wait_for(run(), 60))


def test_a_missing_or_wrong_address_is_one_line(
    short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nobody = ["mavlink", "--socket", str(short / "none.sock")]
    assert main(nobody) == 78
    assert "mavlink.address: empty" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*nobody, "--to", "tcp://127.0.0.1:5"])
    assert "udp://HOST:PORT was expected" in capsys.readouterr().err
