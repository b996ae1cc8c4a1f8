"""The odometry guide matches the decoders."""

import ast
import re
from pathlib import Path
from typing import Any, get_args

import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.odometry import FormatName, FormatSettings
from mapperd.odometry import sonar_odometry
from mapperd.odometry.bridge import OdometryBridge
from mapperd.odometry.links import LinkPhase

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "guides" / "odometry.md").read_text(encoding="utf-8")
CODECS = [
    path
    for path in sorted((ROOT / "mapperd" / "odometry").glob("*.py"))
    if path.stem in ("decoder", "native", "nmea", "records", "water_linked")
    or path.stem.startswith("mavlink")
]
FUSING = [
    ROOT / "mapperd" / "odometry" / f"{name}.py"
    for name in (
        "fusion",
        "intake",
        "track",
        "series",
        "clock",
        "gate",
    )
]


def test_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(example, {})  # noqa: S102 our own page
    stated = capsys.readouterr().out
    assert "[ 0.12  0.4  -2.  ] 1.3 True" in stated
    assert "records=1" in stated


def test_every_format_and_setting_is_explained() -> None:
    for name in (*get_args(FormatName), *FormatSettings.__struct_fields__):
        assert f"`{name}`" in PAGE


def test_settings_load_as_they_stand_there() -> None:
    rov, dvl, sonar = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert config_from_text(rov).odometry.sources[0].format == "mavlink"
    assert config_from_text(sonar).odometry.sonar.enabled
    bridge = OdometryBridge(config_from_text(dvl))
    owners = config_from_text(dvl).odometry.owners
    assert (owners.position, owners.depth) == ("none", "autopilot")
    assert bridge.status()["quantities"].keys() == {"position", "attitude", "depth", "velocity"}


def test_every_state_of_a_link_and_every_limit_is_explained() -> None:
    for phase in LinkPhase:
        assert f"| `{phase}` |" in PAGE
    for name in ("policy", "max_gap_sec", "max_stamp_diff_sec", "max_odom_age_sec"):
        assert name in PAGE


def test_every_reason_of_fusion_is_explained() -> None:
    made = set().union(*(reasons(path) for path in FUSING))
    part = PAGE[PAGE.index("## Why a record is rejected") : PAGE.index("## Native records")]
    explained = "".join(re.findall(r"^\| (`.*?) \|", part, re.MULTILINE))
    made |= {"levelling", "not_finite", "out_of_range"}  # the last two are `bad_numbers`'s
    assert made == set(re.findall(r"`(\w+)`", explained))


def reasons(path: Path) -> set[str]:
    """First arguments of all Rejects that a module makes."""
    calls = [node for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.Call)]
    first: list[Any] = [c.args[0] for c in calls if getattr(c.func, "id", "") == "Reject"]
    return {str(argument.value) for argument in first}


def test_every_reason_is_explained_and_none_is_made_up() -> None:
    made = set().union(*(reasons(path) for path in CODECS))
    table = PAGE[PAGE.index("| reason |") :]
    explained = "".join(re.findall(r"^\| (`.*?) \|", table, re.MULTILINE))
    assert made == set(re.findall(r"`(\w+)`", explained))


def test_every_silence_of_sonar_odometry_is_explained() -> None:
    made = reasons(Path(sonar_odometry.__file__))
    part = PAGE[PAGE.index("## Sonar odometry") : PAGE.index("## Why a record is rejected")]
    explained = "".join(re.findall(r"^\| (`.*?) \|", part, re.MULTILINE))
    assert made == set(re.findall(r"`(\w+)`", explained))
