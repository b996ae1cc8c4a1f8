"""What is generated from the settings' types agrees with them."""

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest
import yaml
from config_docs.page import configuration_page, library_page
from config_docs.schema import json_schema

from mapperd.config.aliases import IGNORED
from mapperd.config.catalog import Parameter, inner_parameters, parameters
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "reference" / "configuration.md"
LIBRARY = PAGE.with_name("library.md")
JUDGE = jsonschema.Draft202012Validator(json_schema())


def tree_with(name: str, value: Any) -> dict[str, Any]:
    tree: Any = value
    for part in reversed(name.split(".")):
        tree = {part: tree}
    assert isinstance(tree, dict)
    return tree


def taken(name: str, value: Any) -> bool:
    """Whether the types take a value, rules about several settings aside."""
    try:
        msgspec.convert(value, parameters()[name].annotation)
    except msgspec.ValidationError:
        return False
    return True


def samples(parameter: Parameter) -> list[Any]:
    """Values at and around the limits of a setting, and of other kinds."""
    (meta,) = parameter.annotation.__metadata__
    limits = [getattr(meta, each) for each in ("gt", "ge", "lt", "le")]
    edges = [limit + d for limit in limits if limit is not None for d in (-1, -1e-3, 0, 1e-3, 1)]
    whole = [round(edge) for edge in edges]
    words = ["", "rect", "a b", "192.168.2.3", "192.168.2.300", "/a/b", "open", "x" * 400]
    return [*edges, *whole, *words, None, True, False, [], {}, parameter.default]


@pytest.mark.parametrize("name", parameters())
def test_schema_and_types_agree(name: str) -> None:
    for value in samples(parameters()[name]):
        plain = json.loads(json.dumps(value))
        assert JUDGE.is_valid(tree_with(name, plain)) == taken(name, value), value


def test_schema_knows_lists_sections_and_mistyped_names() -> None:
    source = {"name": "dvl", "format": "water_linked_json", "link": "tcp://192.168.2.95:16171"}
    assert JUDGE.is_valid({"odometry": {"sources": [source]}})
    assert not JUDGE.is_valid({"odometry": {"sources": [source | {"format": "morse"}]}})
    assert not JUDGE.is_valid({"odometry": {"sources": [source | {"nme": "x"}]}})
    assert not JUDGE.is_valid({"odometry": {"origin": {"latitude": 1}}})
    assert not JUDGE.is_valid({"octre": {}})
    assert not JUDGE.is_valid({"octree": {"resolution": 1}})


def test_schema_reports_unit_and_whether_it_is_live() -> None:
    definitions = json_schema()["$defs"]
    assert definitions["OctreeConfig"]["properties"]["voxel_resolution"]["x-unit"] == "m"
    assert definitions["OctreeConfig"]["properties"]["voxel_resolution"]["x-dynamic"] is False
    assert definitions["OrientationConfig"]["properties"]["pitch"]["x-dynamic"] is True
    assert definitions["GeoOriginConfig"]["properties"]["latitude"]["x-unit"] == "deg"
    assert definitions["OdometrySourceConfig"]["properties"]["latency_sec"]["x-dynamic"] is False


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda p: p.name)
def test_schema_takes_the_files_to_start_from(path: Path) -> None:
    JUDGE.validate(yaml.safe_load(path.read_text(encoding="utf-8")))


def test_written_files_are_those_of_the_types() -> None:
    again = "run PYTHONPATH=tools python -m config_docs"
    assert PAGE.read_text(encoding="utf-8") == configuration_page(), again
    library = LIBRARY.read_text(encoding="utf-8")
    assert library == library_page(library), again
    written = (ROOT / "config" / "schema.json").read_text(encoding="utf-8")
    assert json.loads(written) == json.loads(json.dumps(json_schema())), again


def test_settings_without_effect_are_listed_beside_the_compatible_classes_only() -> None:
    listed = re.findall(r"^- `([\w.]+)`: (.+)$", LIBRARY.read_text(), re.MULTILINE)
    assert dict(listed) == dict(IGNORED)
    renamed = {*re.findall(r"^\| `([\w.]+)` \|", PAGE.read_text(), re.MULTILINE)}
    assert renamed
    assert set(IGNORED) & renamed == set()


def shown(parameter: Parameter) -> str:
    """A number's limits as an interval: "a number > 0 and <= 9 (m)" is "(0, 9] m"."""
    number = re.fullmatch(
        r"a (whole )?number (>=?) (\S+) and (<=?) (\S+)(?: \((.*)\))?", parameter.allowed
    )
    if number is None:
        return parameter.allowed
    whole, low, least, high, most, unit = number.groups()
    interval = f"{'[' if low == '>=' else '('}{least}, {most}{']' if high == '<=' else ')'}"
    return f"{'integer ' if whole else ''}{interval}{f' {unit}' if unit else ''}"


def test_page_has_every_setting_with_default_limits_and_meaning() -> None:
    rows = re.findall(
        r"^\| `([^`]*)` \| (.*?) \| (.*?) \| (.*?) \| (.*) \|$", PAGE.read_text(), re.MULTILINE
    )
    page = {name: rest for name, *rest in rows}
    for name, one in parameters().items():
        default, allowed, live, meaning = page[name]
        assert (allowed, meaning) == (shown(one), one.description)
        assert live == ("yes" if one.dynamic else "")
        assert default
        assert all(inner.name in page for inner in inner_parameters(one))
    assert page["octree.voxel_resolution"][0] == "`0.05`"
    assert page["odometry.origin.latitude"][0] == "required"


def test_page_s_example_loads() -> None:
    (example,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    config = config_from_text(example)
    assert config.octree.voxel_resolution == 0.1
    assert config.mounting.orientation.pitch == 30


def test_defaults_are_what_the_parameters_report() -> None:
    tree: dict[str, Any] = msgspec.to_builtins(Config())
    for name, one in parameters().items():
        value: Any = tree
        for part in name.split("."):
            value = value[part]
        assert value == one.default
