"""Names of the topics, `<prefix>/<vehicle>/mapper/...`."""

from dataclasses import dataclass

from mapperd.config import Mqtt

__all__ = ["Asked", "Topics"]

MOST_NAME = 128
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
    """

    root: str

    @classmethod
    def of(cls, settings: Mqtt) -> "Topics":
        """As the settings have it."""
        return cls(f"{settings.prefix.strip('/')}/{settings.vehicle}/mapper")

    def of_name(self, name: str) -> str:
        """Of one subject: `pose`, `/sonar_robot_detections`."""
        return f"{self.root}/{name.lstrip('/')}"

    def setting(self, name: str) -> str:
        """Where the value of a setting is kept."""
        return f"{self.root}/config/{name}"

    def result(self, asked: Asked) -> str:
        """Where the answer goes."""
        return f"{self.root}/{asked.kind}/{asked.name}/result"

    @property
    def requests(self) -> tuple[str, str]:
        """Filters of what may be asked; answers do not match them."""
        return f"{self.root}/cmd/+", f"{self.root}/config/+/set"

    def asked(self, topic: str) -> Asked | None:
        """What a message on a topic asks for; None where it asks for nothing."""
        if not topic.startswith(f"{self.root}/"):
            return None
        match topic[len(self.root) + 1 :].split("/"):
            case ["cmd", name] if 0 < len(name) <= MOST_NAME:
                return Asked("cmd", name)
            case ["config", name, "set"] if 0 < len(name) <= MOST_NAME:
                return Asked("config", name)
        return None
