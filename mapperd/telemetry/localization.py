"""Which messages of localization are due, under the names of the published node's topics."""

from typing import Any

from mapperd.api import Operations
from mapperd.telemetry.outbox import Kind, Message, Outbox
from mapperd.telemetry.pace import Pace
from mapperd.telemetry.payloads import encoded
from mapperd.telemetry.topics import Topics

__all__ = ["SAMPLE", "LocalizationReporter"]

CLOUD_S = 1.0
AGAIN_S = 5.0
"""Of diagnostics that do not change."""
CHANGE_S = 1.0

SAMPLE = 100
"""Particles of a cloud that are told."""

CLOUD = ("t_s", "state", "particles", "effective_size", "ambiguous", "elsewhere", "clusters")


class LocalizationReporter:
    """Puts what is due into the outbox; used by one thread.

    Args:
        operations: the daemon.
        topics: where things are said.
        outbox: takes the messages.
    """

    def __init__(self, operations: Operations, topics: Topics, outbox: Outbox) -> None:
        self._operations = operations
        self._topics = topics
        self._outbox = outbox
        self.renew()

    def renew(self) -> None:
        """Say everything again that a broker keeps."""
        self._level: object = None
        self._pose_s: object = None
        self._transform_s: object = None
        self._cloud_s: object = None
        self._pose, self._cloud = Pace(CHANGE_S), Pace(CLOUD_S)
        self._again, self._change = Pace(AGAIN_S), Pace(CHANGE_S)

    def collect(self, now_s: float) -> None:
        """Put what is due into the outbox; poses come at `mqtt.pose_rate` at most.

        Args:
            now_s: Unix time that is never set back.
        """
        self._pose.period_s = 1 / self._operations.settings.current.mqtt.pose_rate
        if not self._pose.due(now_s):
            return
        said = self._operations.localization()
        self._say_pose(said)
        self._say_diagnostics(now_s, said)
        if said.get("t_s") != self._cloud_s and self._cloud.due(now_s):
            self._cloud_s = said.get("t_s")
            said = self._operations.localization(SAMPLE)
            cloud = {key: said.get(key) for key in CLOUD}
            self._tell("particle_cloud", cloud | {"sample_x_y_yaw_weight": said["sample"]})

    def _say_pose(self, said: dict[str, Any]) -> None:
        pose, transform = said["pose"], said["map_odom"]
        if pose is not None and pose["t_s"] != self._pose_s:
            self._pose_s = pose["t_s"]
            self._tell("amcl_pose", pose | {"state": said["state"]})
        if transform is not None and transform["t_s"] != self._transform_s:
            self._transform_s = transform["t_s"]
            self._tell("map_odom", transform)

    def _say_diagnostics(self, now_s: float, said: dict[str, Any]) -> None:
        diagnostics = said["diagnostics"] | {"state": said["state"]}
        level = (diagnostics["level"], diagnostics["state"])
        again = self._again.due(now_s)
        if again or (level != self._level and self._change.due(now_s)):
            self._level = level
            topic = self._topics.of_name("diagnostics")
            payload = encoded({"t_s": now_s, **diagnostics})
            self._outbox.put(Message(topic, payload, Kind.STATE, retain=True))

    def _tell(self, name: str, said: object) -> None:
        topic, payload = self._topics.of_name(name), encoded(said)
        self._outbox.put(Message(topic, payload, Kind.TELEMETRY))
