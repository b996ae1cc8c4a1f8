"""docs/reference/control.md lists all requests, reasons and limits; its examples are valid."""

import re
from pathlib import Path

import msgspec
import pytest

from mapperd.cli.mapperctl.arguments import EPILOG, parser
from mapperd.cli.mapperctl.connection import REASONS
from mapperd.server.connection import EVENTS_AT_ONCE, MAX_UNSENT
from mapperd.server.session import ASKS, MESSAGES_AT_ONCE, MESSAGES_PER_S, QUIET_S
from mapperd.server.stream_server import NEWCOMERS
from mapperd.wire.auth import Limits
from mapperd.wire.messages import MAX_FROM_CLIENT, AnswerMessage
from mapperd.wire.requests import Fault, Request, decode_request
from oculus_driver.command_line import ExitCode

pytestmark = pytest.mark.net

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "reference" / "control.md").read_text(encoding="utf-8")
COMMANDS = (ROOT / "docs" / "reference" / "cli.md").read_text(encoding="utf-8")
STREAM = (ROOT / "docs" / "reference" / "map-stream.md").read_text(encoding="utf-8")
MODULES = ("api", "server/connection", "wire/requests")
CODE = "\n".join((ROOT / "mapperd" / f"{one}.py").read_text(encoding="utf-8") for one in MODULES)


def test_every_request_and_its_fields_are_explained() -> None:
    for kind in Request.__args__:
        (row,) = re.findall(rf"^\| `{kind.__struct_config__.tag}` \|.*$", PAGE, re.MULTILINE)
        for field in set(kind.__struct_fields__) - {"id"}:
            assert f"`{field}`" in row
    assert f"at most {EVENTS_AT_ONCE} events" in PAGE


def test_every_reason_is_explained() -> None:
    sent = set(re.findall(r'Fault\(\s*"(\w+)"', CODE))
    assert len(sent) > 4
    for reason in sent:
        assert re.search(rf"^\| .*`{reason}`.* \|", PAGE, re.MULTILINE), reason
    for reason in REASONS:
        assert re.search(rf"^\| .*`{reason}`.* \|", PAGE + STREAM, re.MULTILINE), reason


def test_limits_are_those_in_force() -> None:
    limits = Limits()
    at_once = f"{MESSAGES_AT_ONCE:,}".replace(",", " ")
    for row in (
        f"| {NEWCOMERS} | the oldest is cut | `cut_crowded_out` |",
        f"| {limits.connects_per_s:g} a second | wait in the kernel |",
        f"| {limits.hello_s:g} s | cut | `refused_late_hello` |",
        f"| {MAX_FROM_CLIENT // 1024} KiB | cut | `cut_too_long` |",
        f"| {MESSAGES_PER_S:g} a second, {at_once} at once | cut | `cut_too_many_messages` |",
        f"| {limits.asks_per_s:g} a second, {limits.asks_at_once} at once | wait | `throttled` |",
        f"| {ASKS} | cut | `cut_too_many_asks` |",
        f"| {QUIET_S:g} s | cut | `cut_no_acks` |",
        f"| {MAX_UNSENT >> 20} MiB | cut | `cut_unread` |",
    ):
        assert row in PAGE, row


def test_every_exit_code_is_explained() -> None:
    for code in ExitCode:
        assert f"| {code:d} |" in COMMANDS
        # NOT_ALL is of surveys alone.
        assert code is ExitCode.NOT_ALL or re.search(rf"\b{code:d}\s", EPILOG)


def test_every_command_of_the_command_line_page_is_one() -> None:
    lines = re.findall(r"^\| `mapperctl (.*?)` \|", COMMANDS, re.MULTILINE)
    shown = {parser().parse_args(line.split()).command for line in lines}
    assert shown == _commands()


def _commands() -> set[str]:
    (action,) = parser()._subparsers._group_actions  # type: ignore[union-attr]
    return set(action.choices or {})


def test_requests_of_the_page_are_the_protocol() -> None:
    requests, answers = (
        block.splitlines() for block in re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)
    )
    for line in requests:
        request, _ = decode_request(msgspec.msgpack.encode(msgspec.json.decode(line)))
        assert not isinstance(request, Fault), request
    for line in answers:
        msgspec.convert(msgspec.json.decode(line) | {"t": "answer"}, AnswerMessage)
