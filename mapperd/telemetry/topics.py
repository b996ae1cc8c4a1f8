"""Names of the topics, `<prefix>/<vehicle>/mapper/...`."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from mapperd.config.tree import AmclConfig, MqttConfig

__all__ = ["Asked", "Topics"]

MAX_NAME = 128
"""Characters of a command or a setting in a topic; longer ones name nothing."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a topic asks for.

    Attributes:
        kind: `cmd`, or `config` for a setting.
        name: of the command or the setting.
    """

    kind: str
    name: str


@dataclass(frozen=True, slots=True)
class Topics:
    """All topics of one mapper.

    Attributes:
        root: what they begin with.
        also: names below `cmd/` by which settings call a command, and the command.
    """

    root: str
    also: Mapping[str, str] = field(default_factory=dict, hash=False)

    @classmethod
    def of(cls, settings: MqttConfig, amcl: AmclConfig | None = None) -> "Topics":
        """Return the topics that the settings name.

        Args:
            settings: prefix and vehicle.
            amcl: the names of its topics; `map_topic` is one only while maps come under it.
        """
        also = {}
        if amcl is not None:
            if amcl.use_map_topic:
                also[amcl.map_topic.strip("/")] = "set_map"
            also[amcl.initial_pose_topic.strip("/")] = "initial_pose"
        root = f"{settings.prefix.strip('/')}/{settings.vehicle}/mapper"
        return cls(root, also)

    def of_name(self, name: str) -> str:
        """Return the topic of one subject: `pose`, `/sonar_robot_detections`."""
        return f"{self.root}/{name.lstrip('/')}"

    def setting(self, name: str) -> str:
        """Where the value of a setting is kept."""
        return f"{self.root}/config/{name}"

    def result(self, asked: Asked) -> str:
        """Where the answer goes."""
        return f"{self.root}/{asked.kind}/{asked.name}/result"

    @property
    def requests(self) -> tuple[str, ...]:
        """Filters of what may be asked; answers do not match them."""
        deep = [f"{self.root}/cmd/{name}" for name in self.also if "/" in name]
        return f"{self.root}/cmd/+", f"{self.root}/config/+/set", *deep

    def asked(self, topic: str) -> Asked | None:
        """What a message on a topic asks for; None where it asks for nothing."""
        if not topic.startswith(f"{self.root}/"):
            return None
        match topic[len(self.root) + 1 :].split("/"):
            case ["cmd", name] if 0 < len(name) <= MAX_NAME:
                return Asked("cmd", name)
            case ["config", name, "set"] if 0 < len(name) <= MAX_NAME:
                return Asked("config", name)
            case ["cmd", *names] if (name := "/".join(names)) in self.also:
                return Asked("cmd", name)
        return None
