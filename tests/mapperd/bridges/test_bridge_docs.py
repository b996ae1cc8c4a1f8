"""docs/guides/ros2.md, autopilot.md and changes.md list what exists."""

import re
from pathlib import Path

import pytest

from mapperd.bridges.dds import SERVICES
from mapperd.bridges.mavlink import REPORTED
from mapperd.bridges.ros2 import TOPICS
from mapperd.bridges.ros2_services import Ros2Requests
from mapperd.cli.mapperctl.arguments import parser
from mapperd.config.catalog import parameters
from mapperd.config.tree import Config
from mapperd.daemon import problems
from tests.mapperd.bridges.bridge_fakes import BridgeStream

ROOT = Path(__file__).resolve().parents[3]
GUIDES = ROOT / "docs" / "guides"
ROS2, AUTOPILOT, CHANGES = (
    (GUIDES / f"{name}.md").read_text(encoding="utf-8") for name in ("ros2", "autopilot", "changes")
)


def test_every_topic_is_in_the_table() -> None:
    rows = re.findall(r"^\| `([^`]+)` \| (\w+/\w+) \|", ROS2, re.MULTILINE)
    topics = Config().topics
    named = {"sonar": topics.sonar, "cloud": topics.pointcloud, "markers": topics.marker}
    expected = {
        (named.get(key) or name, kind.replace("/msg/", "/"))
        for key, (name, kind, *_) in TOPICS.items()
    }
    assert len(expected) == len(TOPICS)
    assert set(rows[: len(TOPICS)]) == expected  # services come after them


class Offered:
    """Stands for a node: keeps the names of services."""

    def __init__(self) -> None:
        self.services: list[tuple[str, str]] = []

    def service(self, name: str, kind: str) -> None:
        self.services.append((name, kind))

    def subscriber(self, *_: object) -> None:
        return None


def test_every_service_is_explained_and_has_a_type() -> None:
    config = Config()
    on = type(config.ros2)(commands=True)
    node = Offered()
    Ros2Requests(BridgeStream(), node, None, Config(ros2=on), print)  # type: ignore[arg-type]
    assert len(node.services) > 12
    for name, kind in node.services:
        assert kind in SERVICES
        assert f"`{name.removeprefix('mapperd/')}`" in ROS2.replace("`mapperd/", "`"), name
    reading = Offered()
    Ros2Requests(BridgeStream(), reading, None, config, print)  # type: ignore[arg-type]
    assert {kind.partition("/")[0] for _, kind in reading.services} == {"rcl_interfaces"}


@pytest.mark.parametrize("page", [ROS2, AUTOPILOT, CHANGES])
def test_settings_and_commands_of_the_pages_exist(page: str) -> None:
    names = set(re.findall(r"`((?:ros2|topics|mavlink|changes|amcl|frames)\.\w+)`", page))
    assert names - set(parameters()) == set()
    assert len(names) > 1
    commands = re.findall(r"^mapperctl (.*?)(?:#.*)?$", page, re.MULTILINE)
    assert commands
    for command in commands:
        parser().parse_args(command.split())


def test_problems_that_an_autopilot_is_told_exist() -> None:
    text = problems.Problem.__doc__ or ""
    assert all(f"`{code}`" in text for code in REPORTED)
    assert {code for code, subject in REPORTED.items() if subject == "sonar"} == problems.SONAR
