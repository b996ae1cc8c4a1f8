"""docs/guides/foxglove.md lists what exists."""

import re
from pathlib import Path

from mapperd.cli.mapperctl.arguments import parser
from mapperd.foxglove.channels import CHANNELS

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "guides" / "foxglove.md").read_text(
    encoding="utf-8"
)


def test_every_channel_is_in_the_table() -> None:
    changing = re.findall(r"^\| `(/[^`]+)` \| `([^`]+)` \|", PAGE, re.MULTILINE)
    assert changing == [(channel.topic, channel.schema_name) for channel in CHANNELS]


def test_commands_of_the_page_are_understood() -> None:
    commands = re.findall(r"^mapperctl (.*?)(?:#.*)?$", PAGE, re.MULTILINE)
    assert len(commands) == 7
    for command in commands:
        parser().parse_args(command.split())
