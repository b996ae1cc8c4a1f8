"""The store page matches the code."""

import re
from pathlib import Path
from typing import Any

import pytest

from mapperd.errors import StoreError
from mapperd.store.database import ADVICE, FIRST

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "store.md").read_text(
    encoding="utf-8"
)


def test_the_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, Any] = {}
    exec(example, names)  # noqa: S102 our own page
    assert names["loaded"].position == (1).to_bytes(8, "little")


def test_every_reason_and_every_table_is_explained() -> None:
    assert StoreError.__doc__ is not None
    reasons = set(re.findall(r"`(\w+)`", StoreError.__doc__)) - {"advance"}
    assert set(ADVICE) < reasons
    for reason in reasons - {"closed"}:
        assert f"`{reason}`" in PAGE, reason
    for table in re.findall(r"CREATE TABLE (\w+)", " ".join(FIRST)):
        assert f"| `{table}` |" in PAGE
