"""Publishes the changes of a map stream client on Foxglove channels."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from foxglove.messages import Log, LogLevel

from mapperd.client.changes import (
    ClientChange,
    ConnectionStatus,
    LinkChanged,
    MapChanged,
    MapReset,
)
from mapperd.foxglove.channels import ChannelMessage, Channels
from mapperd.foxglove.geometry import PathDrawing, stamp
from mapperd.foxglove.map_publisher import MapPublisher, PublishPace
from mapperd.foxglove.messages import Follows, StateMessages, values_of
from mapperd.wire.messages import (
    EventMessage,
    FanMessage,
    ImageMessage,
    LocalizationMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
)

__all__ = ["FoxgloveRelay"]

NS = 1e9
PATH_S = 1.0
JUMP_BACK_NS = 10_000_000_000
"""A larger step back means that the daemon's clock was set; a smaller one is reordering."""

LEVELS: Mapping[str, LogLevel] = {
    "error": LogLevel.Error,
    "warning": LogLevel.Warning,
    "notice": LogLevel.Info,
    "info": LogLevel.Info,
    "debug": LogLevel.Debug,
}

TOPICS: Mapping[type, tuple[str, ...]] = {
    PoseMessage: ("/tf", "/pose", "/odometry"),
    FanMessage: ("/fan",),
    ReturnsMessage: ("/returns", "/sonar/annotations"),
    ImageMessage: ("/sonar/polar", "/sonar/fan"),
    RobotsMessage: ("/robots",),
    LocalizationMessage: (
        "/localization/particles",
        "/localization/pose",
        "/localization/covariance",
        "/localization/scan",
        "/localization/report",
    ),
    StatusMessage: ("/status",),
    LinkChanged: ("/status",),
}
"""Topics that publish the newest state, by type of change."""


class FoxgloveRelay:
    """Publishes each change of a client on the channels that have subscribers.

    Args:
        client: source of the changes and of the newest state.
        channels: where to publish.
        pace: rate limits of whole maps.
        on_set_back: called when the daemon's clock was set back, so that log times continue from
            there; with None, log times stay constant until the clock has caught up.
    """

    def __init__(
        self,
        client: Follows,
        channels: Channels,
        pace: PublishPace,
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
        self._bricks_lost = 0
        self._state = StateMessages(client)
        self._waiting: set[str] = set()
        """State topics that changed before the first stamp."""

    def take(self, change: ClientChange) -> None:
        """Publish a change, or schedule it for `tick`."""
        stamp_ns = getattr(change, "stamp_ns", None)
        if stamp_ns:
            self._advance_time(stamp_ns)
        for topic in TOPICS.get(type(change), ()):
            self._publish(topic)
        match change:
            case MapChanged():
                self._map.note(change)
            case MapReset():
                self._map.reset()
            case EventMessage():
                self._log_event(change)
            case SettingsMessage():
                self._values(change.facts)
            case LinkChanged(link):
                self._link(link)
            case _:
                pass

    def tick(self, now_s: float, *, last: bool = False) -> None:
        """Publish what is rate-limited; call several times a second.

        Args:
            now_s: monotonic.
            last: this is the last call.
        """
        if not self.stamp_ns:
            return
        mirror = self._client.mirror
        if mirror is not None:
            self._log_lost(mirror.info.bricks_lost)
        heard = self._channels.heard("/map") or self._channels.heard("/map_changes")
        if mirror is not None and heard:
            for message in self._map.due(mirror, now_s, self.stamp_ns, last=last):
                self._channels.publish(message)
        path = self._client.path
        soon = last or now_s - self._path_s >= PATH_S
        if soon and self._channels.heard("/path"):
            self._path_s = now_s
            drawn = self._path.update(path, self._state.frames().map, self.stamp_ns)
            if drawn is not None:
                self._channels.publish(ChannelMessage("/path", drawn, self.stamp_ns))

    def renew(self, topic: str) -> None:
        """Publish for a new subscriber what is otherwise published on change or rarely."""
        if topic in ("/map", "/map_changes"):
            self._map.renew()
        elif topic == "/path":
            self._path.clear()
            self._path_s = -math.inf
        elif topic in self._state.topics:
            self._publish(topic)

    def log(self, level: LogLevel, name: str, text: str, stamp_ns: int | None = None) -> None:
        """Publish a log message; it is dropped before the first stamp, as it would have no time."""
        stamp_ns = stamp_ns or self.stamp_ns
        if not stamp_ns:
            return
        message = Log(timestamp=stamp(stamp_ns), level=level, message=text, name=name)
        self._channels.publish(ChannelMessage("/log", message, stamp_ns))

    def _advance_time(self, stamp_ns: int) -> None:
        if self._on_set_back is not None and stamp_ns < self.stamp_ns - JUMP_BACK_NS:
            self.stamp_ns = self._channels.newest_ns = stamp_ns
            self._on_set_back()
        elif stamp_ns > self.stamp_ns or stamp_ns < self.stamp_ns - JUMP_BACK_NS:
            self.stamp_ns = stamp_ns
        waiting, self._waiting = self._waiting, set()
        for topic in waiting:
            self._publish(topic)

    def _publish(self, topic: str) -> None:
        if not self.stamp_ns:
            self._waiting.add(topic)
        elif self._channels.heard(topic):
            message = self._state.message(topic, self.stamp_ns)
            if message is not None:
                self._channels.publish(ChannelMessage(topic, message, self.stamp_ns))

    def _values(self, facts: Mapping[str, Any]) -> None:
        """Publish changed settings; before the first stamp, publish all once there is one."""
        if self.stamp_ns and self._channels.heard("/settings"):
            self._channels.publish(ChannelMessage("/settings", values_of(facts), self.stamp_ns))
        else:
            self._waiting.add("/settings")

    def _link(self, link: ConnectionStatus) -> None:
        """Log a new state of the connection; attempts and repeated failures are not logged."""
        text = f"{link.state}: {link.address} {link.reason}".strip()
        if link.state != "connecting" and text != self._link_text:
            self._link_text = text
            level = LogLevel.Info if link.state == "connected" else LogLevel.Warning
            self.log(level, "connection", text)

    def _log_lost(self, bricks: int) -> None:
        """Log a new number of damaged bricks that are missing in the map."""
        if bricks != self._bricks_lost and self._channels.heard("/log"):
            self._bricks_lost = bricks
            level = LogLevel.Error if bricks else LogLevel.Info
            self.log(level, "bricks_lost", f"{bricks} damaged bricks are missing in the map")

    def _log_event(self, message: EventMessage) -> None:
        event = message.event
        stamp_ns = round(float(event.get("t_s", 0.0)) * NS) or self.stamp_ns
        if message.lost:
            self.log(LogLevel.Warning, "events", f"{message.lost} events were lost", stamp_ns)
        level = LEVELS.get(str(event.get("severity")), LogLevel.Unknown)
        self.log(level, str(event.get("code", "")), str(event.get("text", "")), stamp_ns)
