"""docs/reference/control.md says what there is, and its example is answered."""

import asyncio
import json
import re
from pathlib import Path

import msgspec
import pytest

from mapperd.cli.mapperctl.arguments import EPILOG, parser
from mapperd.cli.mapperctl.connection import REASONS
from mapperd.cli.mapperctl.errors import Exit
from mapperd.wire.auth import Limits
from mapperd.wire.control_messages import Answer, Ask, Events, Greeting
from tests.support.control_server import Line, served

pytestmark = pytest.mark.net

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "reference" / "control.md").read_text(encoding="utf-8")
SOURCES = [
    ROOT / "mapperd" / f"{name}.py"
    for name in (
        "api",
        "server/admission",
        "server/control_server",
        "server/control_session",
        "server/dispatch",
        "wire/control_messages",
    )
]
CODE = "\n".join(path.read_text(encoding="utf-8") for path in SOURCES)


def test_every_request_and_its_fields_are_explained() -> None:
    for kind in Ask.__args__:
        (row,) = re.findall(rf"^\| `{kind.__struct_config__.tag}` \|.*$", PAGE, re.MULTILINE)
        for field in set(kind.__struct_fields__) - {"id"}:
            assert f"`{field}`" in row
    assert Events in Ask.__args__


def test_every_reason_is_explained() -> None:
    told = set(re.findall(r'Fault\(\s*"(\w+)"', CODE)) | REASONS.keys()
    assert len(told) > 10
    for reason in told:
        assert re.search(rf"^\| .*`{reason}`.* \|", PAGE, re.MULTILINE), reason


def test_every_counter_of_a_cut_is_explained() -> None:
    counters = set(re.findall(r'"(cut_\w+|refused_full|throttled|malformed)"', CODE))
    assert len(counters) > 3
    for counter in counters:
        assert f"`{counter}`" in PAGE, counter


def test_limits_are_those_in_force() -> None:
    limits = Limits()
    for row in (
        f"| {limits.newcomers} | the oldest is cut |",
        f"| {limits.connects_per_s:g} a second | wait in the kernel |",
        f"| {limits.hello_s:g} s | cut | `cut_late_hello` |",
        f"| {limits.line_bytes // 1024} KiB | cut | `cut_too_long` |",
        f"| {limits.line_s:g} s | cut | `cut_slow_sending` |",
        f"| {limits.asks_per_s:g} a second, {limits.asks_at_once} at once | wait | `throttled` |",
        f"| {limits.malformed} | cut | `malformed`, `cut_malformed` |",
        f"| {limits.idle_s:g} s | cut | `cut_idle` |",
        f"| {limits.write_s:g} s | cut | `cut_slow_reading` |",
    ):
        assert row in PAGE, row


def test_every_exit_code_is_explained() -> None:
    for code in Exit:
        assert f"| {code:d} |" in PAGE
        assert re.search(rf"\b{code:d}\s", EPILOG)


def test_every_command_of_the_page_is_one() -> None:
    for line in re.findall(r"^mapperctl (.*?)(?: +#.*)?$", PAGE, re.MULTILINE):
        parser().parse_args(line.split())


def test_lines_of_the_page_are_the_protocol() -> None:
    blocks = re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)
    greeting, asks, answers = (block.splitlines() for block in blocks)
    msgspec.json.decode(greeting[0], type=Greeting)
    for line in asks:
        msgspec.json.decode(line, type=Ask)
    for line in answers:
        msgspec.json.decode(line, type=Answer)


def test_line_by_hand_is_answered(short: Path) -> None:
    (words,) = re.findall(r"^printf '%s\\n' (.*) \| nc -UN", PAGE, re.MULTILINE)
    lines = re.findall(r"'(.*?)'", words)

    async def run() -> list[int]:
        async with served(short) as one:
            line: Line = await one.raw("unix")
            await line.say("".join(f"{said}\n" for said in lines).encode())
            line.writer.write_eof()
            heard = [await line.hear() for _ in range(3)]
            with pytest.raises(EOFError):
                await line.hear()
            line.close()
            return [json.loads(json.dumps(said)).get("id", 0) for said in heard]

    assert asyncio.run(run()) == [0, 1, 2]
