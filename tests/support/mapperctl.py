"""`mapperctl` for files, with the settings of its command line alone."""

from collections.abc import Callable
from pathlib import Path

import pytest

from mapperd.cli.mapperctl.command import main

Call = Callable[..., tuple[int, list[str], str]]


@pytest.fixture(autouse=True)
def no_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("MAPPERD_CONFIG", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "xdg"))
    monkeypatch.setattr("mapperd.config.layers.load_settings.__defaults__", (tmp_path / "etc",))


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    def run(*words: str | Path) -> tuple[int, list[str], str]:
        code = main(list(map(str, words)))
        captured = capsys.readouterr()
        assert captured.err.count("\n") == (code != 0)
        return code, captured.out.splitlines(), captured.err

    return run
