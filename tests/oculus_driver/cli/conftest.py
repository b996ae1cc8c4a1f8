"""The command `oculus`, called as a person calls it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from oculus_driver.cli import main


@dataclass(frozen=True)
class CommandResult:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str

    @property
    def facts(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.out.splitlines()]


Oculus = Callable[..., CommandResult]


@pytest.fixture
def oculus(capsys: pytest.CaptureFixture[str]) -> Oculus:
    def call(*words: object) -> CommandResult:
        try:
            code = main([str(word) for word in words])
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capsys.readouterr()
        return CommandResult(code, out, err)

    return call
