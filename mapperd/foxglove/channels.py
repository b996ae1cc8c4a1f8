"""The channels that Foxglove and Lichtblick see, live and in MCAP files: docs/foxglove.md."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import foxglove
import msgspec
from foxglove import channels as typed

from mapperd.wire.messages import Want

__all__ = ["CHANNELS", "Channel", "Channels", "Said"]


@dataclass(frozen=True, slots=True)
class Channel:
    """One of them.

    Attributes:
        topic: its name.
        schema: a message of the SDK, `PointCloud`; of JSON, a name of ours.
        want: what the daemon is asked for, for its sake.
    """

    topic: str
    schema: str
    want: Want

    @property
    def schema_name(self) -> str:
        """As viewers see it."""
        return self.schema if self.schema in JSON_SCHEMAS else f"foxglove.{self.schema}"


@dataclass(frozen=True, slots=True)
class Said:
    """A message on its way.

    Attributes:
        topic: of its channel.
        message: of the SDK; plain values for JSON.
        stamp_ns: of the daemon's Unix clock.
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
            "daemon": {**_OBJECT, "description": "as `mapperctl status --json` says it"},
        },
    },
    "mapperd.Localization": {
        "title": "mapperd.Localization",
        "type": "object",
        "description": "as `mapperctl localization --json` says it",
        "properties": {"state": {"type": "string"}},
    },
    "mapperd.Settings": {
        "title": "mapperd.Settings",
        "type": "object",
        "description": "values of settings by name: the first time all, then those that changed",
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
    """All of them, open for one server or file.

    Args:
        context: that the server or the file listens to.

    Attributes:
        newest_ns: time of the newest message; logs go forward, whatever the stamps do.
        messages: that were said.
    """

    def __init__(self, context: foxglove.Context) -> None:
        self.newest_ns = 0
        self.messages = 0
        self._context = context  # channels close when nobody holds it any more
        self._open = {channel.topic: _opened(channel, context) for channel in CHANNELS}

    def heard(self, topic: str) -> bool:
        """Somebody listens to it."""
        return bool(self._open[topic].has_sinks())

    def say(self, said: Said) -> None:
        """Tell those who listen."""
        self.newest_ns = max(self.newest_ns, said.stamp_ns)
        self.messages += 1
        message = said.message
        if isinstance(message, dict):
            message = msgspec.json.encode(message)
        self._open[said.topic].log(message, log_time=self.newest_ns)

    def close(self) -> None:
        """They are there no more."""
        for channel in self._open.values():
            channel.close()


def _opened(channel: Channel, context: foxglove.Context) -> Any:  # noqa: ANN401 one class for each schema
    schema = JSON_SCHEMAS.get(channel.schema)
    if schema is not None:
        return foxglove.Channel(channel.topic, schema=schema, context=context)
    return getattr(typed, f"{channel.schema}Channel")(channel.topic, context=context)
