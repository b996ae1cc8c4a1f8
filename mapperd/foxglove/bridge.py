"""From what a client of the map stream is told to what Foxglove's channels say, and when."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from foxglove.messages import Log, LogLevel

from mapperd.client.changes import (
    ClientChange,
    LinkChanged,
    LinkStatus,
    MapChanged,
    MapReset,
)
from mapperd.foxglove.channels import Channels, Said
from mapperd.foxglove.geometry import stamp
from mapperd.foxglove.map_publisher import MapPublisher, Pace
from mapperd.foxglove.messages import Follows, StateMessages, values_of
from mapperd.foxglove.scene import PathDrawing
from mapperd.wire.messages import (
    Event,
    Fan,
    Image,
    Localization,
    Pose,
    Returns,
    Robots,
    Settings,
    Status,
)

__all__ = ["Relay"]

NS = 1e9
PATH_S = 1.0
JUMP_BACK_NS = 10_000_000_000
"""The daemon's clock was set anew, rather than that two messages overtook each other."""

LEVELS: Mapping[str, LogLevel] = {
    "error": LogLevel.Error,
    "warning": LogLevel.Warning,
    "notice": LogLevel.Info,
    "info": LogLevel.Info,
    "debug": LogLevel.Debug,
}

TOPICS: Mapping[type, tuple[str, ...]] = {
    Pose: ("/tf", "/pose", "/odometry"),
    Fan: ("/fan",),
    Returns: ("/returns",),
    Image: ("/sonar/polar", "/sonar/fan"),
    Robots: ("/robots",),
    Localization: (
        "/localization/particles",
        "/localization/pose",
        "/localization/covariance",
        "/localization/scan",
        "/localization/report",
    ),
    Status: ("/status",),
    LinkChanged: ("/status",),
}
"""What a change of the newest state is told on; all others are told as changes."""


class Relay:
    """Tells the channels what a client is told.

    Args:
        client: whose changes these are; its state is what is told.
        channels: that are told.
        pace: of whole maps.
        on_set_back: told when the daemon's clock was set back, so that logs go on from there; None
            lets the times of logs stand still until it has caught up.
    """

    def __init__(
        self,
        client: Follows,
        channels: Channels,
        pace: Pace,
        on_set_back: Callable[[], None] | None = None,
    ) -> None:
        self.stamp_ns = 0
        self._client = client
        self._channels = channels
        self._on_set_back = on_set_back
        self._map = MapPublisher(pace)
        self._path = PathDrawing()
        self._path_s = -math.inf
        self._link_text = ""
        self._state = StateMessages(client)
        self._waiting: set[str] = set()
        """Topics of state that came before the first stamp."""

    def take(self, change: ClientChange) -> None:
        """Tell of a change, or note that it is to be told."""
        stamp_ns = getattr(change, "stamp_ns", None)
        if stamp_ns:
            self._hear(stamp_ns)
        for topic in TOPICS.get(type(change), ()):
            self._tell(topic)
        match change:
            case MapChanged():
                self._map.note(change)
            case MapReset():
                self._map.reset()
            case Event():
                self._event(change)
            case Settings():
                self._values(change.facts)
            case LinkChanged(link):
                self._link(link)
            case _:
                pass

    def tick(self, now_s: float, *, last: bool = False) -> None:
        """Tell what may not be told at once; several times a second.

        Args:
            now_s: monotonic.
            last: nothing follows.
        """
        if not self.stamp_ns:
            return
        mirror = self._client.mirror
        heard = self._channels.heard("/map") or self._channels.heard("/map_changes")
        if mirror is not None and heard:
            for said in self._map.due(mirror, now_s, self.stamp_ns, last=last):
                self._channels.say(said)
        path = self._client.path
        soon = last or now_s - self._path_s >= PATH_S
        if soon and self._channels.heard("/path"):
            self._path_s = now_s
            drawn = self._path.update(path, self._state.frames().map, self.stamp_ns)
            if drawn is not None:
                self._channels.say(Said("/path", drawn, self.stamp_ns))

    def renew(self, topic: str) -> None:
        """Somebody new listens: tell again what is told by changes, or seldom."""
        if topic in ("/map", "/map_changes"):
            self._map.renew()
        elif topic == "/path":
            self._path.clear()
            self._path_s = -math.inf
        elif topic in self._state.topics:
            self._tell(topic)

    def log(self, level: LogLevel, name: str, text: str, stamp_ns: int | None = None) -> None:
        """Say something to people; before the first stamp there is no time to say it at."""
        stamp_ns = stamp_ns or self.stamp_ns
        if not stamp_ns:
            return
        message = Log(timestamp=stamp(stamp_ns), level=level, message=text, name=name)
        self._channels.say(Said("/log", message, stamp_ns))

    def _hear(self, stamp_ns: int) -> None:
        if self._on_set_back is not None and stamp_ns < self.stamp_ns - JUMP_BACK_NS:
            self.stamp_ns = self._channels.newest_ns = stamp_ns
            self._on_set_back()
        elif stamp_ns > self.stamp_ns or stamp_ns < self.stamp_ns - JUMP_BACK_NS:
            self.stamp_ns = stamp_ns
        waiting, self._waiting = self._waiting, set()
        for topic in waiting:
            self._tell(topic)

    def _tell(self, topic: str) -> None:
        if not self.stamp_ns:
            self._waiting.add(topic)
        elif self._channels.heard(topic):
            message = self._state.message(topic, self.stamp_ns)
            if message is not None:
                self._channels.say(Said(topic, message, self.stamp_ns))

    def _values(self, facts: Mapping[str, Any]) -> None:
        """Settings that changed; without a stamp all of them are told as soon as there is one."""
        if self.stamp_ns and self._channels.heard("/settings"):
            self._channels.say(Said("/settings", values_of(facts), self.stamp_ns))
        else:
            self._waiting.add("/settings")

    def _link(self, link: LinkStatus) -> None:
        """Each attempt to connect is no news, nor that it failed as the one before."""
        text = f"{link.state}: {link.address} {link.reason}".strip()
        if link.state != "connecting" and text != self._link_text:
            self._link_text = text
            level = LogLevel.Info if link.state == "connected" else LogLevel.Warning
            self.log(level, "connection", text)

    def _event(self, told: Event) -> None:
        event = told.event
        stamp_ns = round(float(event.get("t_s", 0.0)) * NS) or self.stamp_ns
        if told.lost:
            self.log(LogLevel.Warning, "events", f"{told.lost} events are lost", stamp_ns)
        level = LEVELS.get(str(event.get("severity")), LogLevel.Unknown)
        self.log(level, str(event.get("code", "")), str(event.get("text", "")), stamp_ns)
