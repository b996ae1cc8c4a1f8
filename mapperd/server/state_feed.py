"""The state of the daemon and its settings as messages, made once for all clients."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mapperd.api import DaemonApi
from mapperd.config.live import changes_between, facts_of
from mapperd.config.tree import Config
from mapperd.events import Event
from mapperd.geometry.frames import Pose
from mapperd.localization.report import localization_report
from mapperd.localization.status import LocalizationSnapshot
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.step import PingResult
from mapperd.server.state_messages import (
    IMAGE_SIZES,
    SonarMounting,
    VehiclePath,
    fan_message,
    image_message,
    localized_covariance,
    pose_message,
    returns_message,
)
from mapperd.wire.framing import framed
from mapperd.wire.messages import EventMessage, LocalizationMessage, RobotsMessage, Vector
from mapperd.wire.requests import plain, plain_map

if TYPE_CHECKING:
    from mapperd.pipeline.worker import StatusSnapshot

__all__ = ["Newest", "SettingLog", "StateFeed"]

_ENCODER = msgspec.msgpack.Encoder(enc_hook=plain)


class SettingLog:
    """Facts of settings, each once, in the order of their last changes.

    Args:
        facts: of all settings, by name.

    Attributes:
        last: number of the newest change.
    """

    def __init__(self, facts: Mapping[str, Any]) -> None:
        self.last = 0
        self._facts: dict[str, msgspec.Raw] = {}
        self._numbers: dict[str, int] = {}
        self._order: list[tuple[int, str]] = []
        self.put(facts)

    def put(self, facts: Mapping[str, Any]) -> None:
        """Add changed facts."""
        for name, fact in facts.items():
            self.last += 1
            self._facts[name] = msgspec.Raw(_ENCODER.encode(fact))
            self._numbers[name] = self.last
        self._order = sorted((number, name) for name, number in self._numbers.items())

    def since(self, number: int, most_bytes: int) -> tuple[int, dict[str, msgspec.Raw]]:
        """Return the next facts after a number: about this many bytes, and at least one.

        Returns:
            the number of the last of these facts, and the facts by name.
        """
        at = bisect_right(self._order, number, key=lambda entry: entry[0])
        sent: dict[str, msgspec.Raw] = {}
        size = 0
        while at < len(self._order) and (not sent or size < most_bytes):
            number, name = self._order[at]
            sent[name] = self._facts[name]
            size += len(name) + len(bytes(self._facts[name]))
            at += 1
        return number, sent


SPACING_M = 0.1
"""Distance between points of the path, until it is full."""

SLOW_S = 0.2
"""Shortest time between two messages with a localization; images and returns take half."""

EVENTS = 64
"""Encoded events that are kept."""


@dataclass(frozen=True, slots=True)
class Newest:
    """The newest message of a kind as bytes of the wire, and its number among its kind."""

    number: int = 0
    frame: bytes = b""


NOTHING = Newest()


class StateFeed:
    """The newest message of each kind, for all clients.

    The mapping thread calls `put`, a worker thread `draw`, the event loop everything else.

    Args:
        operations: the daemon.
        snapshot: returns the newest status of the mapping thread.
        path_points: maximum number of points of the path.

    Attributes:
        path: of the vehicle.
        settings: facts of the settings.
        position_m: of the vehicle, map frame; None before it is known.
        left_out: values left out because they were not finite, by kind.
    """

    def __init__(
        self,
        operations: DaemonApi,
        snapshot: "Callable[[], StatusSnapshot | None]",
        path_points: int,
    ) -> None:
        config = operations.settings.current
        self.path = VehiclePath(path_points, SPACING_M)
        self.position_m: Vector | None = None
        self.left_out: Counter[str] = Counter()
        self._operations = operations
        self._snapshot = snapshot
        self._config = config
        self._mounting = SonarMounting(config)
        self.settings = SettingLog(self._described([]))
        self._newest: dict[str, Newest] = {}
        self._images = [NOTHING] * len(IMAGE_SIZES)
        self._drawings = 0
        self._last: dict[str, object] = {}
        self._made_s: dict[str, float] = {}
        self._put: PingResult | None = None
        self._shown: PingResult | None = None
        self._drawn: PingResult | None = None
        self._events: dict[int, bytes] = {}
        self.status = msgspec.Raw(b"\x80")

    def put(self, result: PingResult) -> None:
        """Take a processed ping; fast, for the mapping thread."""
        self._put = result
        if isinstance(result.pose, FusedPose):
            self.path.add(result.pose.pose.position_m)

    def newest(self, kind: str) -> Newest:
        """Return the newest message of `pose`, `fan`, `returns`, `robots` or `localization`."""
        return self._newest.get(kind, NOTHING)

    def image(self, coarseness: int) -> Newest:
        """Return the newest image of a size; 0 is the finest.

        Its number is 0 if the newest ping was drawn in other sizes only.
        """
        return self._images[coarseness]

    def refresh(self, wanted: Collection[str], now_s: float) -> None:
        """Encode what is new.

        Args:
            wanted: kinds of messages that clients want.
            now_s: monotonic time.
        """
        self._follow_settings()
        result = self._put
        if result is not None and result is not self._shown:
            self._shown = result
            self._add_ping(result, wanted)
        snapshot = self._snapshot()
        if snapshot is None:
            return
        if "robots" in wanted and snapshot.robots != self._last.get("robots"):
            self._last["robots"] = snapshot.robots
            self._make("robots", RobotsMessage(seen=[_seen(robot) for robot in snapshot.robots]))
        if snapshot.localization is not None:
            self._add_localization(snapshot.localization, wanted, now_s)

    def make_status(self) -> None:
        """Encode the daemon's status for the heartbeats of the next second."""
        self.status = msgspec.Raw(_ENCODER.encode(self._operations.status()))

    def wants_drawing(self, wanted: Collection[str], now_s: float) -> bool:
        """Return whether clients want returns or images, and a new ping is there to draw."""
        if not {"returns", "image"} & {*wanted}:
            self._newest.pop("returns", None)  # outdated when a client wants it again
            self._images = [NOTHING] * len(IMAGE_SIZES)
            return False
        if self._shown is None or self._shown is self._drawn:
            return False
        return self._due("draw", now_s, SLOW_S / 2)

    def draw(self, wanted: Collection[str], coarseness: Collection[int]) -> None:
        """Encode returns and images of the newest ping; runs in the worker thread.

        Args:
            wanted: kinds of messages that clients want.
            coarseness: image sizes that clients get.
        """
        result, config = self._shown, self._config
        if result is None:
            return
        self._drawn = result
        if "returns" in wanted:
            sonar = None
            if isinstance(result.pose, FusedPose):
                sonar = self._mounting.of_sonar(result.pose.pose)
            self._make("returns", returns_message(result, sonar, config))
        ping, stamp_ns = result.posed.ping, result.posed.complete_ns or 0
        self._drawings += 1
        images = [Newest(0, image.frame) for image in self._images]  # keeps their lengths
        for coarse in coarseness:
            message = image_message(ping, stamp_ns, IMAGE_SIZES[coarse])
            images[coarse] = Newest(self._drawings, framed(message))
        self._images = images

    def event(self, event: Event, lost: int) -> bytes:
        """Return the message of an event, and the number of lost events before it."""
        if lost:
            return framed(EventMessage(event=_plain_event(event), lost=lost))
        frame = self._events.get(event.number)
        if frame is None:
            frame = self._events[event.number] = framed(EventMessage(event=_plain_event(event)))
            while len(self._events) > EVENTS:
                self._events.pop(next(iter(self._events)))
        return frame

    def _add_ping(self, result: PingResult, wanted: Collection[str]) -> None:
        posed, fused = result.posed, result.pose
        if isinstance(fused, FusedPose):
            odom = posed.pose if isinstance(posed.pose, FusedPose) else fused
            self._add_pose(
                fused.pose,
                posed.t_ns or posed.complete_ns or 0,
                self._source(),
                velocity_mps=fused.velocity_mps,
                covariance=fused.covariance,
                odom=None if odom is fused else odom.pose,
            )
        if "fan" in wanted:
            fan = fan_message(posed.ping, self._config)
            if fan != self._last.get("fan"):
                self._last["fan"] = fan
                self._make("fan", fan)

    def _add_pose(
        self,
        base: Pose,
        stamp_ns: int,
        source: str,
        *,
        velocity_mps: NDArray[np.float64] | None = None,
        covariance: NDArray[np.float64] | None = None,
        odom: Pose | None = None,
    ) -> None:
        if velocity_mps is not None and not np.isfinite(velocity_mps).all():
            self.left_out["not_finite_velocity"] += 1
            velocity_mps = None
        sonar = self._mounting.of_sonar(base)
        message = pose_message(
            base,
            sonar,
            stamp_ns=stamp_ns,
            source=source,
            velocity_mps=velocity_mps,
            covariance=covariance,
            odom=odom,
        )
        self.position_m = message.position_m
        self._make("pose", message)

    def _source(self) -> str:
        snapshot = self._snapshot()
        if snapshot is None or snapshot.odometry.get("source") == "fixed":
            return "fixed"
        corrected = self._config.localization.mapping == "corrected"
        return "localization" if snapshot.localization is not None and corrected else "odometry"

    def _add_localization(
        self, snapshot: LocalizationSnapshot, wanted: Collection[str], now_s: float
    ) -> None:
        if snapshot is self._last.get("localization"):
            return
        where = self._config.localization.mapping
        if where == "off" and snapshot.pose is not None and snapshot.odom_ns is not None:
            self.path.add(snapshot.pose.position_m)
            covariance = localized_covariance(snapshot)
            self._add_pose(
                snapshot.pose,
                snapshot.odom_ns,
                "localization",
                covariance=covariance,
                odom=snapshot.odom,
            )
        if "localization" in wanted and self._due("localization", now_s, SLOW_S):
            self._last["localization"] = snapshot
            self._make("localization", _localization(snapshot, self._config))

    def _follow_settings(self) -> None:
        before, config = self._config, self._operations.settings.current
        if config is before:
            return
        self._config, self._mounting = config, SonarMounting(config)
        names = [*changes_between(before, config)]
        if names:
            self.settings.put(self._described(names))

    def _described(self, names: list[str]) -> dict[str, dict[str, Any]]:
        settings = self._operations.settings
        return facts_of(settings.current, settings.origin_of, names)

    def _make(self, kind: str, message: msgspec.Struct | None) -> None:
        if message is not None:
            number = self.newest(kind).number + 1
            self._newest[kind] = Newest(number, framed(message))  # type: ignore[arg-type]

    def _due(self, what: str, now_s: float, period_s: float) -> bool:
        if now_s - self._made_s.get(what, -period_s) < period_s:
            return False
        self._made_s[what] = now_s
        return True


def _plain_event(event: Event) -> dict[str, Any]:
    return plain_map(event.plain())


def _seen(robot: dict[str, Any]) -> tuple[int, float, float, float]:
    x, y, z = (float(one) for one in robot["position_m"])
    return round(robot["t_s"] * 1e9), x, y, z


def _localization(snapshot: LocalizationSnapshot, config: Config) -> LocalizationMessage:
    report = msgspec.to_builtins(localization_report(snapshot, config, 0), enc_hook=plain)
    points = snapshot.scan_points_m
    return LocalizationMessage(
        report=report,
        particles=_rows(snapshot.particles),
        scan=b"" if points is None else _rows(points),
    )


def _rows(points: NDArray[np.float64]) -> bytes:
    """Encode the rows that are finite: clients refuse others."""
    rows = points.astype("<f4")
    sent: bytes = rows[np.isfinite(rows).all(axis=1)].tobytes()
    return sent
