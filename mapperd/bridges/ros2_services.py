"""What ROS asks of the daemon: initial poses, parameters, commands, each at most once at a time."""

import asyncio
import contextlib
import math
import socket
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Any

import numpy as np

from mapperd.bridges.dds import DdsNode, DdsService
from mapperd.bridges.ros2_messages import LiveMessages, parameter_type, plain_parameter
from mapperd.bridges.vehicle import BridgeClient
from mapperd.client.validation import AskError
from mapperd.config.odometry import parse_address
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, os_reason
from mapperd.geometry.frames import angles_of
from mapperd.odometry.native import NativeRecord, encode_native

__all__ = [
    "OdometryForwarder",
    "Ros2Requests",
    "odometry_record",
    "odometry_target",
    "pose_request",
]

TIMEOUT_S = 10.0
MAX_TAKEN = 8
"""Requests of a service that are taken at once; more wait in DDS, the oldest are dropped there."""

MAX_RECORDS = 200
"""Odometry messages that are taken at once: ten times those of 200 Hz, for a loop that is late."""

MIN_POSE_S = 0.5
REPORT_S = 10.0
"""Shortest time between two initial poses, and between two lines about those in between."""

NS = 1_000_000_000
PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
NO_MAP, INVALID_MAP, FAILED = 1, 2, 255
"""Results of nav2_msgs/LoadMap."""

LOAD_RESULTS = {"no_such_map": NO_MAP, "bad_name": NO_MAP, "bad_map": INVALID_MAP}

Handler = Callable[[Any], Awaitable[dict[str, Any]]]


class Ros2Requests:
    """Answers requests.

    Args:
        client: client of the map stream.
        node: where services are offered.
        messages: makes responses.
        config: names of topics; whether anything may be changed.
        report: takes one line about each change.
    """

    def __init__(
        self,
        client: BridgeClient,
        node: DdsNode,
        messages: LiveMessages,
        config: Config,
        report: Callable[[str], None],
    ) -> None:
        self._client = client
        self._messages = messages
        self._report = report
        self._may_change = config.ros2.commands
        self._readers: list[tuple[DdsService, Handler]] = []
        self._changers: list[tuple[DdsService, Handler]] = []
        self._poses = None
        self._newest: Any = None
        self._pose_s = self._told_s = -math.inf
        self._skipped = 0
        for name, kind, handler in self._reading():
            self._readers.append((node.service(f"mapperd/{name}", kind), handler))
        for name, kind, handler in self._changing():
            self._changers.append((node.service(f"mapperd/{name}", kind), handler))
        if self._may_change:
            for name, kind, handler in self._commands():
                self._changers.append((node.service(name, kind), handler))
            self._poses = node.subscriber(
                config.amcl.initial_pose_topic, "geometry_msgs/msg/PoseWithCovarianceStamped"
            )

    async def look(self, _: float) -> None:
        """Answer what needs no daemon; call it several times a second."""
        await _answer(self._readers)

    async def look_at_commands(self, _: float) -> None:
        """Carry out commands one after the other, in a task of its own: a daemon may hang."""
        await _answer(self._changers)

    async def look_at_poses(self, now_s: float) -> None:
        """Take the newest initial pose, in a task of its own; those that come faster are skipped.

        Args:
            now_s: monotonic time.
        """
        if self._poses is not None:
            for message in self._poses.take(MAX_TAKEN):
                self._skipped += self._newest is not None
                self._newest = message
        if self._newest is not None and now_s - self._pose_s >= MIN_POSE_S:
            message, self._newest = self._newest, None
            self._pose_s = now_s
            reason = await self._asked("initial_pose", pose=pose_request(message))
            if now_s - self._told_s >= REPORT_S:
                self._told_s = now_s
                more = f"; {self._skipped} earlier ones were skipped" if self._skipped else ""
                self._skipped = 0
                self._report(f"initial pose from ROS: {reason or 'set'}{more}")

    async def _asked(self, do: str, **fields: Any) -> str:  # noqa: ANN401 plain values
        """Make a request of the daemon; return why it was not carried out, or ""."""
        try:
            await self._client.ask(do, timeout_s=TIMEOUT_S, **fields)
        except AskError as error:
            return str(error)
        return ""

    def _reading(self) -> list[tuple[str, str, Handler]]:
        """Services that read parameters, below the node's name, as of every ROS node."""
        return [
            ("get_parameters", "rcl_interfaces/GetParameters", self._get),
            ("get_parameter_types", "rcl_interfaces/GetParameterTypes", self._types),
            ("describe_parameters", "rcl_interfaces/DescribeParameters", self._describe),
            ("list_parameters", "rcl_interfaces/ListParameters", self._list),
        ]

    def _changing(self) -> list[tuple[str, str, Handler]]:
        """Services that change parameters, below the node's name."""
        return [
            ("set_parameters", "rcl_interfaces/SetParameters", self._set),
            ("set_parameters_atomically", "rcl_interfaces/SetParametersAtomically", self._set_all),
        ]

    def _commands(self) -> list[tuple[str, str, Handler]]:
        empty = [
            ("global_localization", "global_localization"),
            ("reinitialize_global_localization", "global_localization"),
            ("request_nomotion_update", "request_nomotion_update"),
        ]
        trigger = ("reset", "snapshot", "reload")
        return [
            *((name, "std_srvs/Empty", self._empty(do)) for name, do in empty),
            *((f"mapperd/{do}", "std_srvs/Trigger", self._trigger(do)) for do in trigger),
            ("mapperd/load_map", "nav2_msgs/LoadMap", self._load),
            ("mapperd/save_map", "nav2_msgs/SaveMap", self._save),
        ]

    def _empty(self, do: str) -> Handler:
        async def carry_out(_: Any) -> dict[str, Any]:  # noqa: ANN401 a message
            reason = await self._asked(do)
            self._report(f"{do} from ROS: {reason or 'done'}")
            return {"structure_needs_at_least_one_member": 0}

        return carry_out

    def _trigger(self, do: str) -> Handler:
        async def carry_out(_: Any) -> dict[str, Any]:  # noqa: ANN401 a message
            reason = await self._asked(do)
            self._report(f"{do} from ROS: {reason or 'done'}")
            return {"success": not reason, "message": reason}

        return carry_out

    async def _load(self, request: Any) -> dict[str, Any]:  # noqa: ANN401 a message
        """Localize on a map of the daemon's folder; a URL's last part is its name."""
        name = str(request.map_url).rpartition("/")[2]
        result = 0
        try:
            await self._client.ask("set_map", timeout_s=TIMEOUT_S, name=name)
        except AskError as error:
            result = LOAD_RESULTS.get(error.reason, FAILED)
            self._report(f"load_map from ROS: {error}")
        return {"map": self._messages.no_grid(), "result": result}

    async def _save(self, request: Any) -> dict[str, Any]:  # noqa: ANN401 a message
        """Save the map in the daemon's folder; without a suffix as an image for Nav2."""
        name = str(request.map_url).rpartition("/")[2]
        reason = await self._asked("save", name=name if "." in name else f"{name}.pgm")
        if reason:
            self._report(f"save_map from ROS: {reason}")
        return {"result": not reason}

    async def _get(self, request: Any) -> dict[str, Any]:  # noqa: ANN401 a message
        facts = self._client.settings
        values = [facts.get(name, {}).get("value") for name in request.names]
        return {"values": [self._messages.parameter(value) for value in values]}

    async def _types(self, request: Any) -> dict[str, Any]:  # noqa: ANN401 a message
        facts = self._client.settings
        kinds = [parameter_type(facts.get(name, {}).get("value"))[0] for name in request.names]
        return {"types": np.array(kinds, np.uint8)}

    async def _describe(self, request: Any) -> dict[str, Any]:  # noqa: ANN401 a message
        facts = self._client.settings
        described = [self._messages.descriptor(name, facts.get(name, {})) for name in request.names]
        return {"descriptors": described}

    async def _list(self, request: Any) -> dict[str, Any]:  # noqa: ANN401 a message
        """List names below the prefixes, at most `depth` parts deeper; 0 is no limit."""
        prefixes, names = list(request.prefixes), []
        for name in sorted(self._client.settings):
            found = [one for one in prefixes if name == one or name.startswith(f"{one}.")]
            if prefixes and not found:
                continue
            below = name.removeprefix(max(found, key=len)) if found else name
            if not request.depth or below.strip(".").count(".") < request.depth:
                names.append(name)
        sections = sorted({name.rpartition(".")[0] for name in names} - {""})
        return {"result": self._messages.parameter_list(names, sections)}

    async def _set(self, request: Any) -> dict[str, Any]:  # noqa: ANN401 a message
        results = [await self._change([one]) for one in request.parameters]
        return {"results": [self._messages.set_result(reason) for reason in results]}

    async def _set_all(self, request: Any) -> dict[str, Any]:  # noqa: ANN401 a message
        reason = await self._change(request.parameters)
        return {"result": self._messages.set_result(reason)}

    async def _change(self, parameters: list[Any]) -> str:
        """Set all or none; return why not, or ""."""
        if not self._may_change:
            return "changes are off: ros2.commands"
        twice = [
            name for name, number in Counter(one.name for one in parameters).items() if number > 1
        ]
        if twice:
            return f"{', '.join(twice)}: is there twice"
        facts = self._client.settings
        changes = {
            one.name: _like(facts.get(one.name, {}), plain_parameter(one.value))
            for one in parameters
        }
        reason = await self._asked("set", changes=changes) if changes else ""
        self._report(f"{', '.join(changes)} from ROS: {reason or 'set'}")
        return reason


async def _answer(services: Iterable[tuple[DdsService, Handler]]) -> None:
    for service, handler in services:
        for request in service.take(MAX_TAKEN):
            service.answer(request, **await handler(request))


def _like(fact: Mapping[str, Any], value: object) -> object:
    """Convert between whole and other numbers as the setting has them: callers mix them up."""
    before = fact.get("value")
    if isinstance(before, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    is_whole = isinstance(before, int) and not isinstance(before, bool)
    if is_whole and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def pose_request(message: Any) -> dict[str, Any]:  # noqa: ANN401 PoseWithCovarianceStamped
    """Return an initial pose as the daemon takes it."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    norm = math.hypot(turn.w, turn.x, turn.y, turn.z) or 1.0
    _, _, yaw_rad = angles_of(np.array([turn.w, turn.x, turn.y, turn.z]) / norm)
    covariance = np.reshape(message.pose.covariance, (6, 6))[PLANAR]
    request = {"x_m": place.x, "y_m": place.y, "yaw_rad": yaw_rad}
    if message.header.frame_id:
        request["frame"] = message.header.frame_id
    if covariance.any():
        request["covariance"] = ((covariance + covariance.T) / 2).tolist()
    return request


async def odometry_target(link: str) -> tuple[str, int]:
    """Return the numeric address of `ros2.odometry_link`; a name is looked up beside the loop.

    Raises:
        ConfigError: the link is invalid, or its host is unknown.
    """
    try:
        address = parse_address(link)
        found = await asyncio.get_running_loop().getaddrinfo(
            address.host, address.port, type=socket.SOCK_DGRAM
        )
    except (OSError, ValueError) as error:
        reason = os_reason(error) if isinstance(error, OSError) else str(error)
        raise ConfigError(
            f"ros2.odometry_link: {link}: {reason}", "$.ros2.odometry_link"
        ) from error
    # A source listens on one address: that of IPv4 for a name that has both, such as localhost.
    found.sort(key=lambda one: one[0] != socket.AF_INET)
    host, port = found[0][4][:2]
    return str(host), int(port)


class OdometryForwarder:
    """Passes subscribed odometry to the daemon as native records.

    Args:
        node: where odometry is subscribed.
        topic: of the odometry.
        target: numeric address of the daemon's source.
    """

    def __init__(self, node: DdsNode, topic: str, target: tuple[str, int]) -> None:
        self._to = target
        self._reader = node.subscriber(topic, "nav_msgs/msg/Odometry", "stream")
        family = socket.AF_INET6 if ":" in target[0] else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)  # noqa: FBT003 the call's own form

    async def look(self, _: float) -> None:
        """Send what has arrived; call it several times a second."""
        for message in self._reader.take(MAX_RECORDS):
            with contextlib.suppress(OSError):  # nobody listens, as while the daemon restarts
                self._socket.sendto(encode_native(odometry_record(message)), self._to)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def odometry_record(message: Any) -> NativeRecord:  # noqa: ANN401 nav_msgs/Odometry
    """Return a native record of odometry in ROS's axes; a covariance of zeros is unknown."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    upper = np.triu_indices(6)

    def triangle(covariance: Iterable[float]) -> tuple[float, ...] | None:
        whole = np.reshape(np.asarray(covariance, np.float64), (6, 6))
        return tuple(whole[upper].tolist()) if whole.any() else None

    # All zeros are what publishers without a velocity send.
    velocity = triangle(message.twist.covariance)
    moving = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    is_known = velocity is not None or any(moving)
    return NativeRecord(
        v=1,
        t=message.header.stamp.sec * NS + message.header.stamp.nanosec,
        clk="unix",
        w="enu",
        b="flu",
        p=(place.x, place.y, place.z),
        q=(turn.w, turn.x, turn.y, turn.z),
        u=moving[:3] if is_known else None,
        r=moving[3:] if is_known else None,
        pc=triangle(message.pose.covariance),
        uc=velocity,
        src="ros2",
    )
