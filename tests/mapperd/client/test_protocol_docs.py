"""docs/reference/map-stream.md describes what the code does."""

import re
import typing

import pytest
import zstandard

from mapperd.config.loader import config_from_text
from mapperd.errors import ConfigError
from mapperd.wire import messages
from mapperd.wire.auth import proof_of
from mapperd.wire.blocks import MAX_BODY, MAX_KEY, decode_blocks, encode_blocks
from mapperd.wire.framing import framed
from mapperd.wire.messages import FromClient, FromServer, GreetingMessage
from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "reference" / "map-stream.md").read_text(encoding="utf-8")


def test_every_message_and_every_key_has_its_row() -> None:
    for kind in (*typing.get_args(FromClient), *typing.get_args(FromServer)):
        section = PAGE.split(f"\n### `{kind.__struct_config__.tag}`\n")[1]
        table = re.split(r"\n##+ |\n`\w+`:", section)[0]
        assert _keys(table) == list(kind.__struct_fields__), kind


def test_every_key_of_what_messages_hold_has_its_row() -> None:
    for name, kind in {
        "interest": messages.Interest,
        "resume": messages.Resume,
        "map": messages.MapInfo,
    }.items():
        table = re.split(r"\n##", PAGE.split(f"\n`{name}`:")[1])[0].split("\n\n")
        rows = next(part for part in table if "| key |" in part)
        assert _keys(rows) == list(kind.__struct_fields__)


def test_limits_are_those_of_the_code() -> None:
    for number in (messages.MAX_FROM_SERVER, messages.MAX_FROM_CLIENT, MAX_BODY, messages.MAX_PATH):
        assert f"{number:,}".replace(",", " ") in PAGE
    assert MAX_KEY == 1 << 30
    config_from_text(f"stream: {{path_points: {messages.MAX_PATH}}}")  # and no longer one:
    with pytest.raises(ConfigError):
        config_from_text(f"stream: {{path_points: {messages.MAX_PATH + 1}}}")
    assert f"at most {messages.MAX_BLOCKS}" in PAGE
    assert all(f"`{want}`" in PAGE for want in messages.WANTS)


def test_greeting_is_byte_for_byte_as_shown() -> None:
    assert framed(GreetingMessage()) == _bytes(_block("hex-greeting"))


def test_body_is_as_shown() -> None:
    shown = _bytes(_block("hex-body"))
    blocks = decode_blocks(zstandard.ZstdCompressor().compress(shown), counts=False)
    assert blocks.keys.tolist() == [[1, -1, 0], [2, 0, 0], [0, 0, -3]]
    assert blocks.ages_ms.tolist() == [1000, 0, 0]
    assert (blocks.cells[0] == -6).all()
    assert (blocks.cells[1] == -128).all()
    assert blocks.cells[2, :3].tolist() == [12, 0, -128]
    assert zstandard.ZstdDecompressor().decompress(encode_blocks(blocks)) == shown


def test_proof_is_as_shown() -> None:
    assert _block("proof").strip() == proof_of(b"correct-horse-battery", "5f0c")


def test_example_is_the_file() -> None:
    example = (ROOT / "examples" / "watch_map.py").read_text(encoding="utf-8")
    assert _block("python") == example
    assert len(example.splitlines()) <= 21


def _keys(table: str) -> list[str]:
    return re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)


def _block(name: str) -> str:
    return PAGE.split(f"```{name}\n")[1].split("```")[0]


def _bytes(shown: str) -> bytes:
    """`0c 80*3  text` is 0c 80 80 80."""
    found = b""
    for line in shown.splitlines():
        hexes = re.match(r"(?:(?:[0-9a-f]{2}(?:\*\d+)?)(?:\s+|$))+", line)
        assert hexes, line
        for token in hexes[0].split():
            byte, _, times = token.partition("*")
            found += bytes.fromhex(byte) * int(times or 1)
    return found
