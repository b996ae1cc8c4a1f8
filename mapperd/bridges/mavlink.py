"""The bridge to an autopilot: poses, obstacles and texts as MAVLink over UDP.

`AutopilotBridge` makes the bytes, without sockets and clocks; `serve` sends them. pymavlink
belongs to the extra `mavlink`.
"""

import asyncio
import contextlib
import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from mapperd.bridges.mavlink_messages import (
    AutopilotPose,
    JumpCounter,
    autopilot_pose,
    obstacle_distances,
    text_chunks,
)
from mapperd.bridges.vehicle import (
    NS,
    BridgeClient,
    ConnectionState,
    LinkReporter,
    RateLimit,
    VehiclePose,
    map_slice,
    sure_pose,
)
from mapperd.client.changes import ClientChange, LinkChanged
from mapperd.config.odometry import parse_address
from mapperd.config.tree import MavlinkConfig
from mapperd.errors import ConfigError, ExportError, os_reason
from mapperd.geometry.frames import quaternion_to_matrix
from mapperd.wire.messages import (
    EventMessage,
    LocalizationMessage,
    PoseMessage,
    ReturnsMessage,
    SettingsMessage,
    StatusMessage,
    Want,
)
from oculus_driver.back_off import BackOff, doubling_steps

__all__ = ["WANTS", "AutopilotBridge", "serve"]

WANTS: tuple[Want, ...] = (
    "map",
    "pose",
    "returns",
    "localization",
    "status",
    "events",
    "settings",
)

HEARTBEAT_HZ = 1.0
SILENT_S = 5.0
"""An autopilot is lost that sent no heartbeat for this time."""

FRESH_S = 1.0
"""Poses that are older are not sent; obstacles are from a ping that is no older than the pose."""

MAX_TEXTS = 16
SONAR, RECORDING = "sonar", "recording"
REPORTED = {
    **dict.fromkeys(("no_sonar", "sonar_in_use", "sonar_unreachable", "sonar_silent"), SONAR),
    "recording_paused": RECORDING,
}
"""Subject of the problems of the daemon's status that the autopilot is told."""

OVER = {SONAR: "sonar: pings again", RECORDING: "recording goes on"}
ERROR, WARNING, NOTICE = (
    common.MAV_SEVERITY_ERROR,
    common.MAV_SEVERITY_WARNING,
    common.MAV_SEVERITY_NOTICE,
)


class AutopilotBridge:
    """Makes the messages for one autopilot.

    Args:
        client: client of the map stream.
        config: settings.
        report: takes one line for each change of the links.

    Attributes:
        reason: why no pose is sent; "" while poses are sent.
    """

    def __init__(
        self, client: BridgeClient, config: MavlinkConfig, report: Callable[[str], None]
    ) -> None:
        self.reason = "no pose yet"
        self._client = client
        self._config = config
        self._report = report
        self._link = LinkReporter(report)
        self._mav = common.MAVLink(None, config.system_id, config.component_id)
        self._jumps = JumpCounter()
        self._poses = RateLimit(config.pose_rate)
        self._obstacles = RateLimit(config.obstacle_rate)
        self._text = RateLimit(config.text_rate)
        self._heartbeat = RateLimit(HEARTBEAT_HZ)
        self._texts: OrderedDict[str, tuple[int, str]] = OrderedDict()
        self._text_id = 0
        self._problems: dict[str, str] = {}
        self._suspected: set[str] = set()
        self._session = ""
        self._was_connected = False
        self._heard_s: float | None = None
        self._kind = common.MAV_AUTOPILOT_GENERIC
        self._state = ConnectionState()
        self._origin: tuple[str, bool | None] | None = None
        self._returns: ReturnsMessage | None = None

    def _forget(self) -> None:
        """Forget the state of the daemon: it may be old when it comes again."""
        self._state.clear()
        self._returns = None

    def take(self, change: ClientChange, now_s: float) -> Iterator[bytes]:
        """Yield the messages that a change causes.

        Args:
            change: of the client.
            now_s: monotonic time.

        Raises:
            ConfigError: these poses must not go to this autopilot.
        """
        self._state.take(change, now_s)
        match change:
            case LinkChanged(link):
                self._connected(is_connected=self._link.take(link))
            case LocalizationMessage():
                state = change.report.get("state")
                is_off = state == "off" and self._config.poses == "all"
                if not is_off and (state != "localized" or change.report.get("sure") is not True):
                    self._doubt("localization: not sure")
            case ReturnsMessage():
                self._returns = change
            case PoseMessage():
                yield from self._pose(change, now_s)
            case StatusMessage():
                self._look_at_problems(change.status)
            case EventMessage():
                self._look_at_event(change.event)
            case SettingsMessage():
                self._check_sources(change.facts)
            case _:
                pass

    def tick(self, now_s: float) -> Iterator[bytes]:
        """Yield what is due by time; call it some twenty times a second.

        Args:
            now_s: monotonic time.
        """
        if self._heard_s is not None and now_s - self._heard_s > SILENT_S:
            self._heard_s = None
            self._report(f"autopilot: silent for {SILENT_S:g} s; messages are still sent")
        if self._heartbeat.due(now_s):
            yield self._packed(
                self._mav.heartbeat_encode(
                    common.MAV_TYPE_ONBOARD_CONTROLLER,
                    common.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    common.MAV_STATE_ACTIVE,
                )
            )
        if self._texts and self._text.due(now_s):
            _, (severity, text) = self._texts.popitem(last=False)
            yield from self._status_text(severity, text)

    def heard(self, data: bytes, now_s: float) -> None:
        """Take a datagram of the autopilot: only its heartbeats matter.

        Args:
            data: begins with a message; routers send each one in its own datagram.
            now_s: monotonic time.
        """
        if data[:1] == b"\xfd":
            is_heartbeat = data[7:10] == bytes(3)
        else:
            is_heartbeat = data[:1] == b"\xfe" and data[5:6] == b"\0"
        if not is_heartbeat:
            return
        reader = common.MAVLink(None)
        reader.robust_parsing = True
        for message in reader.parse_buffer(data) or ():
            if (
                message.get_type() != "HEARTBEAT"
                or message.autopilot == common.MAV_AUTOPILOT_INVALID
                or message.get_srcSystem() != self._config.system_id
            ):
                continue
            if self._heard_s is None:
                self._report(f"autopilot: heard system {message.get_srcSystem()}")
            self._heard_s, self._kind = now_s, message.autopilot

    def _connected(self, *, is_connected: bool) -> None:
        welcome = self._client.welcome
        session = "" if welcome is None else welcome.session
        if is_connected:
            if self._session not in ("", session):
                self._jumps.lose()
            self._session = session
        else:
            self._forget()
            self.reason = "no connection to the daemon"
            self._problems.clear()
        if is_connected != self._was_connected:
            self._was_connected = is_connected
            text = "mapperd: connected" if is_connected else "mapperd: connection lost"
            self._say("daemon", NOTICE if is_connected else WARNING, text)

    def _check_sources(self, facts: Mapping[str, Any]) -> None:
        """Refuse to send an autopilot its own poses.

        Raises:
            ConfigError: the daemon's odometry is an autopilot's.
        """
        sources = facts.get("odometry.sources", {}).get("value") or ()
        if self._config.poses == "all" and any(
            isinstance(one, Mapping) and one.get("format") == "mavlink" for one in sources
        ):
            raise ConfigError(
                "mavlink.poses: all would send the autopilot its own poses, as odometry.sources "
                "has one of format mavlink; allowed there: localization",
                "$.mavlink.poses",
            )

    def _pose(self, vehicle: PoseMessage, now_s: float) -> Iterator[bytes]:
        localization = self._state.localization
        by_odometry = self._config.poses == "all" and self._state.localizes is False
        located = sure_pose(vehicle, localization.message, odometry=by_odometry)
        if localization.is_stale(now_s):
            located = "localization: no report"
        if self._state.age_s(vehicle.stamp_ns, now_s) > FRESH_S:
            self._doubt("pose is old")
            return
        if isinstance(located, str):
            self._doubt(located)
        else:
            self.reason = ""
            origin = vehicle.source, self._state.localizes
            if origin != self._origin:
                self._origin = origin
                self._jumps.lose()  # another frame, however near
            resets = self._jumps.take(located)
            if self._poses.due(now_s):
                yield self._packed(self._pose_message(located, resets))
        if self._obstacles.due(now_s):
            message = self._obstacle_message(VehiclePose.of(vehicle))
            if message is not None:
                yield self._packed(message)

    def _doubt(self, reason: str) -> None:
        if not self.reason:
            self._jumps.lose()
        self.reason = reason

    def _pose_message(self, located: VehiclePose, resets: int) -> Any:  # noqa: ANN401 no types
        is_ned = self._config.frame == "ned"
        pose: AutopilotPose = autopilot_pose(located, "ned" if is_ned else "local_frd")
        x, y, z = pose.position_m.tolist()
        covariance = pose.covariance.tolist()
        if self._config.message == "vision":
            return self._mav.vision_position_estimate_encode(
                pose.time_us, x, y, z, *pose.angles_rad, covariance, resets
            )
        # ArduPilot drops all but LOCAL_FRD; forward may be north.
        local = not is_ned or self._kind == common.MAV_AUTOPILOT_ARDUPILOTMEGA
        return self._mav.odometry_encode(
            pose.time_us,
            common.MAV_FRAME_LOCAL_FRD if local else common.MAV_FRAME_LOCAL_NED,
            common.MAV_FRAME_BODY_FRD,
            x,
            y,
            z,
            pose.quaternion.tolist(),
            *pose.velocity_mps.tolist(),
            *[math.nan] * 3,
            covariance,
            [math.nan] * 21,
            resets,
            common.MAV_ESTIMATOR_TYPE_VISION,
            0,
        )

    def _obstacle_message(self, located: VehiclePose) -> Any | None:  # noqa: ANN401 no types
        config, mirror = self._config, self._client.mirror
        if mirror is None:
            return None
        z_m, half_m = float(located.pose.position_m[2]), config.obstacle_height / 2
        points_m = self._ping_points(located.stamp_ns)
        points_m = points_m[np.abs(points_m[:, 2] - z_m) <= half_m]
        place = located.pose.position_m
        try:
            layer = map_slice(mirror, z_m - half_m, z_m + half_m, place, config.obstacle_range)
        except ExportError:
            layer = None
        distances = obstacle_distances(
            layer, mirror.cell_m, points_m, located, config.obstacle_range
        )
        return self._mav.obstacle_distance_encode(
            located.stamp_ns // 1000,
            common.MAV_DISTANCE_SENSOR_ULTRASOUND,
            distances.tolist(),
            5,
            0,
            round(100 * config.obstacle_range),
            5.0,
            0.0,
            common.MAV_FRAME_BODY_FRD,
        )

    def _ping_points(self, stamp_ns: int) -> NDArray[np.float64]:
        """Return the returns (N, 3) of the latest ping, map frame; none of an old one."""
        returns = self._returns
        if (
            returns is None
            or returns.sonar_position_m is None
            or returns.sonar_orientation_xyzw is None
            or abs(stamp_ns - returns.stamp_ns) > FRESH_S * NS
        ):
            return np.zeros((0, 3))
        points = np.frombuffer(returns.points, "<f4").reshape(-1, 3).astype(np.float64)
        turn = quaternion_to_matrix(np.roll(returns.sonar_orientation_xyzw, 1))
        placed: NDArray[np.float64] = points @ turn.T + returns.sonar_position_m
        return placed

    def _look_at_problems(self, status: Mapping[str, Any]) -> None:
        """Tell problems that two statuses in a row have, and their end."""
        if "problems" not in status:
            return
        found: dict[str, str] = {}
        for one in status["problems"]:
            subject = REPORTED.get(one.get("code"))
            if subject is not None:
                found.setdefault(subject, str(one.get("text", "")).partition(". ")[0])
        for subject, text in found.items():
            if subject in self._suspected and subject not in self._problems:
                self._problems[subject] = text
                self._say(subject, ERROR, text)
        for subject in self._problems.keys() - found.keys():
            del self._problems[subject]
            self._say(subject, NOTICE, OVER[subject])
        self._suspected = {*found}

    def _look_at_event(self, event: Mapping[str, Any]) -> None:
        """Tell errors, such as a map that cannot be saved, and changes of the map."""
        code = str(event.get("code", ""))
        if event.get("severity") == "error" and code != RECORDING:
            self._say(code, ERROR, str(event.get("text", code)))
        elif code in ("appeared", "vanished"):
            self._say(code, NOTICE, str(event.get("text", code)))

    def _say(self, subject: str, severity: int, text: str) -> None:
        """Queue a text; a newer one about the same subject replaces it."""
        self._texts.pop(subject, None)
        self._texts[subject] = (severity, text)
        while len(self._texts) > MAX_TEXTS:
            self._texts.popitem(last=False)

    def _status_text(self, severity: int, text: str) -> Iterator[bytes]:
        chunks = list(text_chunks(text))
        if len(chunks) > 1:
            self._text_id = self._text_id % 65535 + 1
        number = self._text_id if len(chunks) > 1 else 0
        for at, chunk in enumerate(chunks):
            yield self._packed(self._mav.statustext_encode(severity, chunk, number, at))

    def _packed(self, message: Any) -> bytes:  # noqa: ANN401 no types
        packed: bytes = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed


TICK_S = 0.05
RETRY_DELAY_S, MAX_RETRY_DELAY_S = 1.0, 30.0


class _Datagrams(asyncio.DatagramProtocol):
    """The socket to one autopilot."""

    def __init__(self, bridge: AutopilotBridge, report: Callable[[str], None]) -> None:
        self._bridge = bridge
        self._report = report
        self._refused = ""
        self.transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: object) -> None:  # noqa: ARG002
        self._refused = ""
        self._bridge.heard(data, asyncio.get_running_loop().time())

    def error_received(self, exc: Exception) -> None:
        reason = os_reason(exc) if isinstance(exc, OSError) else str(exc)
        if reason != self._refused:
            self._refused = reason
            self._report(f"autopilot: {reason}; messages are still sent")


async def serve(client: BridgeClient, config: MavlinkConfig, report: Callable[[str], None]) -> None:
    """Send to the autopilot until cancelled, or until the client ends.

    Args:
        client: running client of the map stream with `WANTS`.
        config: has the address.
        report: takes one line for each change of a link.

    Raises:
        ConfigError: there is no address, or the autopilot would get its own poses.
        StreamError: the daemon refuses the client.
    """
    if not config.address:
        raise ConfigError(
            "mavlink.address: empty; allowed: udp://HOST:PORT of the autopilot or its router",
            "$.mavlink.address",
        )
    bridge = AutopilotBridge(client, config, report)
    protocol = _Datagrams(bridge, report)
    loop = asyncio.get_running_loop()

    def send(frames: Iterator[bytes]) -> None:
        for frame in frames:
            if protocol.transport is not None:
                protocol.transport.sendto(frame)

    async def tick() -> None:
        await _open(protocol, config.address, report)
        while True:
            send(bridge.tick(loop.time()))
            await asyncio.sleep(TICK_S)

    ticking = asyncio.create_task(tick())
    try:
        async for change in client.changes():
            send(bridge.take(change, loop.time()))
            if ticking.done():
                ticking.result()
    finally:
        ticking.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await ticking
        if protocol.transport is not None:
            protocol.transport.close()


async def _open(protocol: _Datagrams, address: str, report: Callable[[str], None]) -> None:
    """Open the socket; again and again while the name or the network is not there."""
    place = parse_address(address)
    back_off = BackOff(doubling_steps(RETRY_DELAY_S, MAX_RETRY_DELAY_S))
    reported = ""
    while True:
        try:
            await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: protocol, remote_addr=(place.host, place.port)
            )
        except OSError as error:
            reason = f"autopilot: {place}: {os_reason(error)}"
            if reason != reported:
                reported = reason
                report(reason)
            await asyncio.sleep(back_off.failed())
        else:
            return
