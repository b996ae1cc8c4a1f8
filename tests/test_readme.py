"""The README's code runs as it stands."""

import importlib
import re
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest

from oculus_driver.encode import encode_ping

ROOT = Path(__file__).resolve().parents[1]


def test_the_readme_s_driver_example_prints_pings(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    data = encode_ping(
        ping_id=7,
        mode=1,
        frequency_hz=750e3,
        range_m=5.0,
        gain_percent=50.0,
        speed_of_sound_mps=1500.0,
        salinity_ppt=35.0,
        start_time=1.0,
        range_resolution_m=0.01,
        bearings_cdeg=np.arange(-64, 64, dtype=np.int16) * 50,
        image=np.zeros((500, 128), dtype=np.uint8),
    )
    exec(code, {"data": data})  # noqa: S102 our own README
    assert capsys.readouterr().out == "7 (500, 128) 5.0\n"


def test_the_readme_s_links_lead_somewhere() -> None:
    text = (ROOT / "README.md").read_text()
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []


def commands() -> list[str]:
    """The lines of the README that run one of the project's commands."""
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    text = (ROOT / "README.md").read_text()
    blocks = re.findall(r"```\n(.*?)```", text, re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    return [line for line in lines if line.partition(" ")[0] in scripts]


@pytest.mark.parametrize("line", commands())
def test_the_readme_s_commands_and_options_exist(
    line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    name, *words = shlex.split(line, comments=True)
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    module, _, function = scripts[name].partition(":")
    subcommand = words[:1] if words and not words[0].startswith("-") else []
    with pytest.raises(SystemExit) as end:
        getattr(importlib.import_module(module), function)([*subcommand, "--help"])
    assert end.value.code == 0
    known = re.findall(r"--[a-z-]+", capsys.readouterr().out)
    assert [word for word in words if word.startswith("--") and word not in known] == []


def test_the_readme_s_paths_exist() -> None:
    named = re.findall(r"config/\w+\.yaml", (ROOT / "README.md").read_text())
    assert named
    assert [path for path in named if not (ROOT / path).exists()] == []
