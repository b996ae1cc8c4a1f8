"""The examples of docs/guides/driver.md run as they stand."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from oculus_driver.cli import SUBCOMMANDS, _parser
from tests.oculus_driver.cli.sonar_thread import played

if TYPE_CHECKING:
    from collections.abc import Callable

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "guides" / "driver.md"
TEXT = GUIDE.read_text(encoding="utf-8")
COMMANDS = re.findall(r"^oculus .*$", TEXT, re.MULTILINE)


def test_every_subcommand_is_shown() -> None:
    assert {module.NAME for module in SUBCOMMANDS} - {"watch"} <= {
        command.split()[1] for command in COMMANDS
    }


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_understood(command: str) -> None:
    _parser().parse_args(shlex.split(command)[1:])


def test_every_option_named_exists() -> None:
    options = set(re.findall(r"`(--[a-z-]+)", TEXT))
    known = {
        option
        for action in _parser()._subparsers._group_actions  # type: ignore[union-attr]
        for parser in (action.choices or {}).values()  # type: ignore[union-attr]
        for option in parser._option_string_actions
    }
    assert options - known == set()


def test_the_program_prints_pings(
    make_ping: Callable[..., bytes], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)[0]
    path = tmp_path / "dive.raw"
    path.write_bytes(b"".join(make_ping(ping_id=index, rows=40) for index in range(1, 30)))
    with played(path, speed=20.0) as (sonar, _):
        exec(code.replace('"192.168.2.3"', f'"127.0.0.1", port={sonar.port}'), {})  # noqa: S102
    first, *_, last = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"\d+ \(40, 256\) 0\.8 (pinging|configuring)", first)
    assert last.split()[0].endswith("9")
