"""The export and ROS 2 pages match the code."""

import re
import tomllib
from pathlib import Path

import pytest

from mapperd.cli.mapperctl.arguments import parser
from mapperd.cli.mapperctl.export import MCAP
from mapperd.export.formats import FORMATS
from mapperd.export.rosbag import CLOUD_TOPIC, GRID_TOPIC, ODOMETRY_TOPIC, SONAR_TOPIC

ROOT = Path(__file__).resolve().parents[4]
EXPORT, ROS = (
    (ROOT / "docs" / name).read_text("utf-8") for name in ("guides/export.md", "guides/ros-bags.md")
)


def test_table_and_formats_are_the_same() -> None:
    rows = re.findall(r"^\| `(\.\w+)` \| [^|]* \| (?:`(\w+)` )?\| [^|]*\|$", EXPORT, re.MULTILINE)
    assert [suffix for suffix, _ in rows] == [*FORMATS, MCAP]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert {extra for _, extra in rows if extra} == {"las", "geo", "foxglove"}
    assert {"las", "geo", "foxglove", "ros"} <= project["optional-dependencies"].keys()


def test_every_topic_is_reported() -> None:
    reported = re.findall(r"^\| `(/\S+)` \|", ROS, re.MULTILINE)
    expected = [SONAR_TOPIC, ODOMETRY_TOPIC, "/tf", "/tf_static", CLOUD_TOPIC, GRID_TOPIC]
    assert reported == expected


@pytest.mark.parametrize("page", [EXPORT, ROS], ids=["export", "ros2"])
def test_every_command_of_a_page_is_one(page: str) -> None:
    lines = re.findall(r"^mapperctl (.*?)(?: +#.*)?$", page, re.MULTILINE)
    assert len(lines) > 3
    for line in lines:
        parser().parse_args(line.split())


def test_every_option_of_an_export_is_reported() -> None:
    output = vars(parser().parse_args(["export", "a.ply"]))
    others = {"command", "file", "json", "socket", "address", "token_file", "tls_ca", "config"}
    for name in output.keys() - others:
        assert f"--{name.replace('_', '-')}" in EXPORT, name
