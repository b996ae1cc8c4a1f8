"""The bridge to ROS 2: publishes the state of a map stream, and takes poses and commands.

Frames are the tree of REP-105: map, odom, base, sonar. What nobody subscribes to is not made.
"""

import asyncio
import os
import time
from collections.abc import Awaitable, Callable, Collection, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd.bridges.dds import DdsNode, Profile
from mapperd.bridges.ros2_messages import ERROR, OK, STALE, WARN, LiveMessages
from mapperd.bridges.ros2_services import OdometryForwarder, Ros2Requests, odometry_target
from mapperd.bridges.vehicle import (
    REPORT_VALID_S,
    BridgeClient,
    CloudCache,
    ConnectionState,
    LinkReporter,
    MapFrames,
    VehiclePose,
    has_odom_pose,
    inverse,
    map_odom_of,
    map_slice,
    planar_estimate,
)
from mapperd.client.changes import ClientChange, LinkChanged, MapChanged, MapReset
from mapperd.client.mirror import MapMirror, names_of
from mapperd.client.validation import bearings_of, image_of
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, ExportError
from mapperd.export.cells import UNKNOWN, GridLayer, GridWindow
from mapperd.export.rosbag import GRID_TOPIC, Turned
from mapperd.geometry.frames import Pose
from mapperd.imaging.ping_image import FanShape
from mapperd.wire.messages import (
    EventMessage,
    ImageMessage,
    LocalizationMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
    StatusMessage,
    Want,
)

__all__ = ["WANTS", "Ros2Bridge", "Ros2Client", "domain_of", "serve"]

Floats = NDArray[np.float64]

WANTS: tuple[Want, ...] = ("pose", "status", "events", "settings", "robots", "fan")
"""Requested always: what is small, and what tells the frames."""

TOPICS: Mapping[str, tuple[str, str, Profile, Want | None]] = {
    "tf": ("/tf", "tf2_msgs/msg/TFMessage", "tf", "localization"),
    "tf_static": ("/tf_static", "tf2_msgs/msg/TFMessage", "latched", None),
    "odometry": ("mapperd/odometry", "nav_msgs/msg/Odometry", "default", "localization"),
    "pose": (
        "amcl_pose",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "latched",
        "localization",
    ),
    "pose_array": ("particlecloud", "geometry_msgs/msg/PoseArray", "sensor", "localization"),
    "particles": ("particle_cloud", "nav2_msgs/msg/ParticleCloud", "sensor", "localization"),
    "sonar": ("", "sensor_msgs/msg/Image", "sensor", "image"),
    "ping": (
        "mapperd/ping",
        "marine_acoustic_msgs/msg/ProjectedSonarImage",
        "sensor",
        "image",
    ),
    "fan": ("mapperd/fan_image", "sensor_msgs/msg/Image", "sensor", "image"),
    "returns": ("mapperd/returns", "sensor_msgs/msg/PointCloud2", "sensor", "returns"),
    "cloud": ("", "sensor_msgs/msg/PointCloud2", "latched", "map"),
    "grid": (GRID_TOPIC, "nav_msgs/msg/OccupancyGrid", "latched", "map"),
    "markers": ("", "visualization_msgs/msg/MarkerArray", "latched", None),
    "diagnostics": ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "default", None),
    "log": ("/rosout", "rcl_interfaces/msg/Log", "log", None),
}
"""Name, type, QoS and what is requested of the daemon while somebody subscribes, by key.

The names of `sonar`, `cloud` and `markers` are settings.
"""

NS = 1_000_000_000
PARTICLES_NS = NS // 2
"""Shortest time between two messages with particles."""

SHARE = 66.0
"""A cloud or grid is made after this many times the processor time that the last one took."""

NO_GRID = GridLayer(np.full((1, 1), UNKNOWN, np.uint8), GridWindow(0, 0, 1, 1))
"""Replaces the grid of a map that was reset: Nav2 and RViz refuse one without cells."""

ALONE_S = 10.0
MAX_TAKEN = 50
POSITION_M, TURN = 1e-6, 1e-9
"""A mounting that differs by less is the same: it is computed from poses."""


class Ros2Client(BridgeClient, Protocol):
    """A client of the map stream that can change what it requests."""

    async def change(self, *, wants: Collection[Want]) -> None: ...  # noqa: D102


class Ros2Bridge:
    """Publishes changes of a client.

    Args:
        client: client of the map stream.
        config: names of topics.
        node: where topics are published.
        report: takes one line for each change of a link.
        clock: monotonic time, seconds.

    Attributes:
        heard: keys of the topics that somebody subscribes to.
    """

    def __init__(
        self,
        client: Ros2Client,
        config: Config,
        node: DdsNode,
        report: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.heard: frozenset[str] = frozenset()
        self._client = client
        self._config = config
        self._report = report
        self._clock = clock
        self._link = LinkReporter(report)
        self.messages = LiveMessages(node.types.classes)
        topics = config.topics
        named = {"sonar": topics.sonar, "cloud": topics.pointcloud, "markers": topics.marker}
        self._publishers = {
            key: node.publisher(named.get(key) or name, kind, profile)
            for key, (name, kind, profile, _) in TOPICS.items()
        }
        self._shape = FanShape()
        self._cloud = CloudCache()
        self._changed: set[bytes] = set()
        self._map_stamp_ns = 0
        self._map_due_s = -np.inf
        self._is_reset = False
        self._grid_error = ""
        self._grid_z_m: float | None = None
        """Height of the slice that was published last."""
        self._has_grid = False
        """The last grid had cells: readers hold it until another one comes."""
        self._state = ConnectionState()
        self._is_in_odom = False
        """The daemon's map lies in the odometry's frame, as of the last pose."""
        self._particles_ns = 0
        self._due: set[str] = set()
        """Latched topics whose last message is outdated: DDS keeps that one for new readers."""
        self._mounting: tuple[Pose, str, str] | None = None
        self._changes: list[Mapping[str, Any]] = []
        self._wants: tuple[Want, ...] = WANTS
        self._began_s: float | None = None
        self._is_alone: bool | None = None
        self._stamp_ns = 0
        self._handlers: Mapping[type, Callable[[Any], object]] = {
            LinkChanged: self._linked,
            MapReset: self._reset,
            MapChanged: self._note,
            PoseMessage: self._pose,
            LocalizationMessage: self._localization,
            ImageMessage: self._image,
            ReturnsMessage: self._returns,
            RobotsMessage: lambda _: self._due.add("markers"),
            StatusMessage: self._status,
            EventMessage: self._event,
        }

    def take(self, change: ClientChange) -> None:
        """Publish a change, or schedule it for `tick`."""
        self._state.take(change, self._clock())
        handler = self._handlers.get(type(change))
        if handler is not None:
            handler(change)

    def _linked(self, change: LinkChanged) -> None:
        if not self._link.take(change.link):
            self._state.clear()

    def _reset(self, _: MapReset) -> None:
        self._is_reset = True
        self._map_stamp_ns = 0
        self._changed.clear()
        self._due |= {"cloud", "grid"}

    def _note(self, change: MapChanged) -> None:
        self._changed.update(names_of(change.keys))
        self._map_stamp_ns = change.stamp_ns or self._map_stamp_ns
        self._due |= {"cloud", "grid"}

    def _returns(self, returns: ReturnsMessage) -> None:
        if "returns" in self.heard:
            self._send("returns", self.messages.returns(returns, self._frame("sonar")))

    def _status(self, status: StatusMessage) -> None:
        self._stamp_ns = status.stamp_ns
        changes = status.status.get("changes")
        if isinstance(changes, list) and changes != self._changes:
            self._changes = changes
            self._due.add("markers")
        if "diagnostics" in self.heard and status.status:
            self._send("diagnostics", self._diagnostics(status))

    async def tick(self, now_s: float) -> None:
        """Look who subscribes; publish the map if it is due. Call it some five times a second.

        Args:
            now_s: monotonic time.
        """
        self.heard = heard = frozenset(k for k, one in self._publishers.items() if one.readers)
        self._look_for_peers(now_s)
        wants = [want for key in heard if (want := TOPICS[key][3]) is not None]
        wanted = tuple(dict.fromkeys((*WANTS, *sorted(wants))))
        if {*wanted} != {*self._wants}:
            self._wants = wanted
            await self._client.change(wants=wanted)
        if "markers" in heard & self._due:
            self._publish_markers()
        if heard & self._due & {"cloud", "grid"} and now_s >= self._map_due_s:
            took_s = await self._publish_map()
            self._map_due_s = now_s + max(self._config.ros2.cloud_period, SHARE * took_s)

    def _look_for_peers(self, now_s: float) -> None:
        """Report once that nobody is there, as in a wrong domain, and that somebody came."""
        if self._began_s is None:
            self._began_s = now_s
        if self.heard and self._is_alone is not False:
            self._is_alone = False
            self._report(f"ROS 2: {len(self.heard)} topics have subscribers")
        elif not self.heard and self._is_alone is not True and now_s - self._began_s > ALONE_S:
            self._is_alone = True
            self._report(
                "ROS 2: nobody subscribes; other programs need the same domain (ros2.domain, "
                "ROS_DOMAIN_ID)"
            )

    def _send(
        self,
        key: str,
        message: Any,  # noqa: ANN401 of rosbags
        rows: Floats | None = None,
    ) -> bool:
        """Publish a message; return whether it was sent."""
        return self._publishers[key].publish(message, rows)

    def _frame(self, which: str) -> str:
        """Return the name of a frame: `map`, `odom`, `base` or `sonar`."""
        mirror, welcome = self._client.mirror, self._client.welcome
        if which == "map":
            info = mirror.info if mirror else welcome.map if welcome else None
            return info.frame if info else self._config.frames.map
        name = "amcl.odom_frame_id" if which == "odom" else f"frames.{which}"
        config = self._config
        default = config.amcl.odom_frame_id if which == "odom" else getattr(config.frames, which)
        value = self._client.settings.get(name, {}).get("value")
        return value if isinstance(value, str) else default

    def _is_on(self, name: str) -> bool:
        return self._client.settings.get(name, {}).get("value") is not False

    def _pose(self, vehicle: PoseMessage) -> None:
        self._stamp_ns = max(self._stamp_ns, vehicle.stamp_ns)
        self._look_at_frame(vehicle)
        self._look_at_height(vehicle)
        localization, frames = self._state.localization.message, self._frames(vehicle)
        if frames is None:
            return
        world, odom, base = (self._frame(name) for name in ("map", "odom", "base"))
        if "tf" in self.heard:
            turned = [Turned(odom, base, frames.odom_of_base)]
            self._send("tf", self.messages.transforms(vehicle.stamp_ns, turned))
            report = localization.report if localization else {}
            is_known = map_odom_of(report) is not None or self._state.localizes is False
            if is_known and not self._is_stale() and self._is_on("amcl.tf_broadcast"):
                stamp_ns = self._valid_until_ns(vehicle, localization)
                turned = [Turned(world, odom, frames.map_of_odom)]
                self._send("tf", self.messages.transforms(stamp_ns, turned))
        if self._is_on("frames.publish_tf"):
            self._publish_mounting(frames.base_of_sonar, vehicle.stamp_ns)
        if "odometry" in self.heard:
            located = VehiclePose.of(vehicle)
            if not frames.served_in_odom:
                located = located.moved(inverse(frames.map_of_odom))
            self._send("odometry", self.messages.vehicle_odometry(located, odom, base))

    def _frames(self, vehicle: PoseMessage) -> MapFrames | None:
        """Return the frames at a pose; None until the state of localization is known."""
        localization = self._state.localization.message
        if has_odom_pose(vehicle):
            return MapFrames.of(vehicle, localization)
        is_corrected = vehicle.source == "localization"
        if localization is None and (self._state.localizes is not False or is_corrected):
            return None
        if is_corrected and (
            localization is None or map_odom_of(localization.report) is None or self._is_stale()
        ):
            return None  # the pose is in the map, and the odometry's frame is not known
        return MapFrames.of(vehicle, localization)

    def _valid_until_ns(
        self, vehicle: PoseMessage, localization: LocalizationMessage | None
    ) -> int:
        """Return the stamp of the odometry's frame in the map: ahead of its scan, as of AMCL."""
        if has_odom_pose(vehicle):  # the transform is that of this pose
            fact = self._client.settings.get("amcl.transform_tolerance", {}).get("value")
            ahead_s = (
                fact if isinstance(fact, int | float) else self._config.amcl.transform_tolerance
            )
            return vehicle.stamp_ns + round(ahead_s * NS)
        transform = localization.report.get("map_odom") if localization else None
        stamp_s = transform.get("t_s") if isinstance(transform, Mapping) else None
        until_ns = round(stamp_s * NS) if isinstance(stamp_s, int | float) else 0
        return max(until_ns, vehicle.stamp_ns)

    def _is_stale(self) -> bool:
        return self._state.localization.is_stale(self._clock())

    def _publish_mounting(self, mounting: Pose, stamp_ns: int) -> None:
        """Publish the sonar's place on the vehicle when it changes."""
        base, sonar, before = self._frame("base"), self._frame("sonar"), self._mounting
        if before is not None and before[1:] == (base, sonar):
            shift_m = np.abs(before[0].position_m - mounting.position_m).max()
            turn = 1 - abs(float(before[0].map_q_base @ mounting.map_q_base))
            if shift_m < POSITION_M and turn < TURN:
                return
        turned = [Turned(base, sonar, mounting)]
        if self._send("tf_static", self.messages.transforms(stamp_ns, turned)):
            self._mounting = (mounting, base, sonar)

    def _localization(self, state: LocalizationMessage) -> None:
        estimate = planar_estimate(state.report)
        stamp_s = state.report.get("t_s")
        vehicle = self._state.vehicle
        if vehicle is None or not isinstance(stamp_s, int | float):
            return  # the estimate has no height without a pose
        stamp_ns, height_m = round(stamp_s * NS), vehicle.position_m[2]
        frame = str((state.report.get("pose") or {}).get("frame", self._frame("map")))
        if estimate is not None and "pose" in self.heard:
            self._send("pose", self.messages.estimate(stamp_ns, frame, *estimate, height_m))
        is_due = abs(stamp_ns - self._particles_ns) >= PARTICLES_NS
        if self.heard & {"pose_array", "particles"} and is_due:
            self._particles_ns = stamp_ns
            array, cloud = self.messages.particles(state, stamp_ns, frame, height_m)
            self._send("pose_array", *array)
            self._send("particles", *cloud)

    def _image(self, image: ImageMessage) -> None:
        if not self.heard & {"sonar", "ping", "fan"}:
            return
        pixels, frame = image_of(image), self._frame("sonar")
        if "sonar" in self.heard:
            self._send("sonar", self.messages.image(image.stamp_ns, frame, pixels))
        if "ping" in self.heard:
            sonar = self._state.status.get("sonar") or {}
            speed_mps = float(sonar.get("speed_of_sound_mps") or 0.0)
            message = self.messages.ping(image, pixels, frame, self._client.fan, speed_mps)
            self._send("ping", message)
        if "fan" in self.heard:
            fan = self._shape.fan_image(bearings_of(image), pixels)
            self._send("fan", self.messages.image(image.stamp_ns, frame, fan))

    def _event(self, message: EventMessage) -> None:
        event = message.event
        stamp_ns = round(float(event.get("t_s", 0.0)) * NS) or self._stamp_ns
        code = str(event.get("code", ""))
        self._send(
            "log",
            self.messages.log(
                stamp_ns, str(event.get("severity")), "mapperd", f"{code}: {event.get('text', '')}"
            ),
        )

    def _publish_markers(self) -> None:
        if not self._stamp_ns:
            return
        robots = self._client.robots
        places = [place for _, *place in robots.seen] if robots else []
        frame = self._map_frame()
        message = self.messages.markers(self._stamp_ns, frame, places, self._changes)
        if self._send("markers", message):
            self._due.discard("markers")

    def _look_at_frame(self, vehicle: PoseMessage) -> None:
        """Note the frame of the daemon's map; all of the map is due again when it changes."""
        localizes = self._state.localizes
        if localizes is None:
            return
        is_in_odom = localizes and vehicle.source == "odometry"
        if is_in_odom != self._is_in_odom:
            self._is_in_odom = is_in_odom
            self._due |= {"cloud", "grid", "markers"}

    def _look_at_height(self, vehicle: PoseMessage) -> None:
        """A slice around the vehicle is due again when its depth changed by a cell."""
        mirror, before_m = self._client.mirror, self._grid_z_m
        if not self._config.ros2.slice_height or mirror is None or before_m is None:
            return
        if abs(vehicle.position_m[2] - before_m) > mirror.cell_m:
            self._due.add("grid")

    def _map_frame(self) -> str:
        """Return the frame that the served map lies in."""
        return self._frame("odom" if self._is_in_odom else "map")

    async def _publish_map(self) -> float:
        """Publish cloud and grid; return the processor time that it took."""
        mirror = self._client.mirror
        if mirror is None:
            return 0.0
        if self._is_reset:
            self._is_reset = False
            self._cloud.clear()
        wanted = self.heard & self._due & {"cloud", "grid"}
        vehicle = self._state.vehicle
        if self._config.ros2.slice_height and vehicle is None:
            wanted -= {"grid"}  # with the first pose
        if not wanted:
            return 0.0
        self._due -= wanted
        if "grid" in wanted and vehicle is not None:
            self._grid_z_m = vehicle.position_m[2]
        names, self._changed = self._changed, set()
        took_s, failed = await asyncio.to_thread(self._map, mirror, wanted, names)
        self._due |= failed
        return took_s

    def _map(
        self, mirror: MapMirror, wanted: Collection[str], names: Collection[bytes]
    ) -> tuple[float, set[str]]:
        """Publish the map; return the processor time, and what was not sent; runs in a thread."""
        failed: set[str] = set()
        began_s = time.thread_time()
        frame, stamp_ns = self._map_frame(), self._map_stamp_ns or self._stamp_ns
        self._cloud.update(mirror, names)
        if "cloud" in wanted:
            cloud = self.messages.points(stamp_ns, frame, self._cloud.rows())
            if not self._send("cloud", cloud):
                failed.add("cloud")
        if "grid" in wanted:
            try:
                layer = map_slice(mirror, *self._heights())
                self._grid_error = ""
            except ExportError as error:
                if self._grid_error != str(error):
                    self._grid_error = str(error)
                    self._report(f"grid: {error}")
                layer = None
            if layer is None and self._has_grid and not self._grid_error:
                layer = NO_GRID
            if layer is not None:
                grid = self.messages.grid(stamp_ns, frame, layer, mirror.cell_m)
                if self._send("grid", grid):
                    self._has_grid = layer is not NO_GRID
                else:
                    failed.add("grid")
        return time.thread_time() - began_s, failed

    def _heights(self) -> tuple[float, float]:
        half_m, z_m = self._config.ros2.slice_height / 2, self._grid_z_m
        if half_m and z_m is not None:
            return z_m - half_m, z_m + half_m
        return self._config.export.min_z, self._config.export.max_z

    def _diagnostics(self, status: StatusMessage) -> Any:  # noqa: ANN401 of rosbags
        """Return the diagnostics: of the daemon with its problems, and of localization."""
        daemon = status.status
        vehicle = self._client.welcome.vehicle if self._client.welcome else ""
        problems = [str(one.get("text", "")) for one in daemon.get("problems") or ()]
        pings = daemon.get("pings") or {}
        values = {
            "phase": daemon.get("phase"),
            "uptime_s": daemon.get("uptime_s"),
            "pings": pings.get("total"),
            "pings_mapped": pings.get("mapped"),
            "sonar": (daemon.get("sonar") or {}).get("state"),
            **{f"problem_{number}": text for number, text in enumerate(problems, 1)},
        }
        text = problems[0] if problems else str(daemon.get("activity", daemon.get("phase", "")))
        level = ERROR if problems else OK
        make = self.messages.diagnostic
        statuses = [make(level, "mapperd: daemon", text, vehicle, values)]
        localization = self._state.localization.message
        report = localization.report if localization else {}
        if report.get("state", "off") != "off":
            found = report.get("diagnostics") or {}
            deviations = {
                name: one["value"] for name, one in found.items() if isinstance(one, Mapping)
            }
            level = WARN if found.get("level") == "WARN" or not report.get("sure") else OK
            text = f"{report['state']}: {found.get('text', '')}"
            if self._is_stale():
                level, text = STALE, f"no report for {REPORT_VALID_S:g} s"
            statuses.append(make(level, "mapperd: localization", text, vehicle, deviations))
        return self.messages.diagnostics(status.stamp_ns, statuses)


TICK_S, LOOK_S = 0.2, 0.1
"""Time between two ticks of the bridge, and between two looks at what ROS sends."""


def domain_of(config: Config, environ: Mapping[str, str]) -> int:
    """Return the DDS domain of the settings, or of ROS_DOMAIN_ID.

    Raises:
        ConfigError: the variable is no domain.
    """
    if config.ros2.domain >= 0:
        return config.ros2.domain
    text = environ.get("ROS_DOMAIN_ID", "") or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= 232):  # noqa: PLR2004 as ros2.domain
        raise ConfigError(f"ROS_DOMAIN_ID: {text!r}; allowed: 0 to 232", "$.ros2.domain")
    return int(text)


async def serve(client: Ros2Client, config: Config, report: Callable[[str], None]) -> None:
    """Publish until cancelled, or until the client ends.

    Args:
        client: running client of the map stream with `WANTS`.
        config: sections `ros2` and `topics`.
        report: takes one line for each change of a link.

    Raises:
        ConfigError: a setting does not fit, or the host of `ros2.odometry_link` is unknown.
        LiveError: DDS cannot start, or refuses a topic.
        StreamError: the daemon refuses the client.
    """
    link = config.ros2.odometry_link
    target = await odometry_target(link) if link else None
    ros2 = config.ros2
    node = DdsNode(domain_of(config, os.environ), ros2.namespace, report, ros2.remap)
    bridge = Ros2Bridge(client, config, node, report)
    requests = Ros2Requests(client, node, bridge.messages, config, report)
    forwarder = OdometryForwarder(node, config.topics.odometry, target) if target else None
    works = (
        _follow(client, bridge),
        _repeat(bridge.tick, TICK_S),
        _repeat(requests.look),
        _repeat(requests.look_at_commands),
        _repeat(requests.look_at_poses),
        _repeat(forwarder.look) if forwarder is not None else asyncio.Event().wait(),
    )
    tasks: list[asyncio.Task[Any]] = [asyncio.create_task(work) for work in works]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        if forwarder is not None:
            forwarder.close()
        node.close()


async def _follow(client: Ros2Client, bridge: Ros2Bridge) -> None:
    async for change in client.changes():
        bridge.take(change)


async def _repeat(look: Callable[[float], Awaitable[None]], period_s: float = LOOK_S) -> None:
    while True:
        await look(asyncio.get_running_loop().time())
        await asyncio.sleep(period_s)
