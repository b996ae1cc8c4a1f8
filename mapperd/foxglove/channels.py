"""The channels that Foxglove and Lichtblick show, live and in MCAP files."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import foxglove
import msgspec
from foxglove import channels as typed

from mapperd.wire.messages import Want

__all__ = ["CHANNELS", "Channel", "ChannelMessage", "Channels"]


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel.

    Attributes:
        topic: name.
        schema: message of the SDK such as `PointCloud`, or a key of `JSON_SCHEMAS`.
        want: what to request from the daemon while someone subscribes.
    """

    topic: str
    schema: str
    want: Want

    @property
    def schema_name(self) -> str:
        """Name of the schema as viewers see it."""
        return self.schema if self.schema in JSON_SCHEMAS else f"foxglove.{self.schema}"


@dataclass(frozen=True, slots=True)
class ChannelMessage:
    """A message to publish.

    Attributes:
        topic: name of its channel.
        message: message of the SDK, or plain values for JSON.
        stamp_ns: Unix time by the daemon's clock.
    """

    topic: str
    message: Any
    stamp_ns: int


_OBJECT = {"type": "object"}

JSON_SCHEMAS: Mapping[str, dict[str, Any]] = {
    "mapperd.Status": {
        "title": "mapperd.Status",
        "type": "object",
        "properties": {
            "connection": {
                "type": "object",
                "description": "to the daemon",
                "properties": {
                    "state": {"type": "string"},
                    "address": {"type": "string"},
                    "reason": {"type": "string"},
                    "connects": {"type": "integer"},
                    "bytes": {"type": "integer"},
                },
            },
            "stream": {**_OBJECT, "description": "how the daemon sees this connection"},
            "daemon": {**_OBJECT, "description": "output of `mapperctl status --json`"},
        },
    },
    "mapperd.Localization": {
        "title": "mapperd.Localization",
        "type": "object",
        "description": "output of `mapperctl localization --json`",
        "properties": {"state": {"type": "string"}},
    },
    "mapperd.Settings": {
        "title": "mapperd.Settings",
        "type": "object",
        "description": "values of settings by name: first all, then those that changed",
    },
}

CHANNELS: tuple[Channel, ...] = (
    Channel("/map", "PointCloud", "map"),
    Channel("/map_changes", "PointCloud", "map"),
    Channel("/tf", "FrameTransforms", "pose"),
    Channel("/pose", "PoseInFrame", "pose"),
    Channel("/odometry", "Odometry", "pose"),
    Channel("/path", "SceneUpdate", "path"),
    Channel("/fan", "SceneUpdate", "fan"),
    Channel("/returns", "PointCloud", "returns"),
    Channel("/sonar/polar", "RawImage", "image"),
    Channel("/sonar/fan", "RawImage", "image"),
    Channel("/sonar/annotations", "ImageAnnotations", "returns"),
    Channel("/robots", "SceneUpdate", "robots"),
    Channel("/localization/particles", "PosesInFrame", "localization"),
    Channel("/localization/pose", "PoseInFrame", "localization"),
    Channel("/localization/covariance", "SceneUpdate", "localization"),
    Channel("/localization/scan", "PointCloud", "localization"),
    Channel("/localization/report", "mapperd.Localization", "localization"),
    Channel("/log", "Log", "events"),
    Channel("/status", "mapperd.Status", "status"),
    Channel("/settings", "mapperd.Settings", "settings"),
)


class Channels:
    """All channels, open for one server or file.

    Args:
        context: context of the server or file.

    Attributes:
        newest_ns: time of the newest message; log times never decrease.
        messages: number published.
    """

    def __init__(self, context: foxglove.Context) -> None:
        self.newest_ns = 0
        self.messages = 0
        self._context = context  # channels close with it
        self._open = {channel.topic: _opened(channel, context) for channel in CHANNELS}

    def heard(self, topic: str) -> bool:
        """Return whether a topic has a subscriber."""
        return bool(self._open[topic].has_sinks())

    def publish(self, channel_message: ChannelMessage) -> None:
        """Send a message to the subscribers."""
        self.newest_ns = max(self.newest_ns, channel_message.stamp_ns)
        self.messages += 1
        message = channel_message.message
        if isinstance(message, dict):
            message = msgspec.json.encode(message)
        self._open[channel_message.topic].log(message, log_time=self.newest_ns)

    def close(self) -> None:
        """Close all channels."""
        for channel in self._open.values():
            channel.close()


def _opened(channel: Channel, context: foxglove.Context) -> Any:  # noqa: ANN401 one class for each schema
    schema = JSON_SCHEMAS.get(channel.schema)
    if schema is not None:
        return foxglove.Channel(channel.topic, schema=schema, context=context)
    return getattr(typed, f"{channel.schema}Channel")(channel.topic, context=context)
