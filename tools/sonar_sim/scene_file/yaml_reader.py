"""Read scene files: YAML with places, checked against the schema."""

import math
import re
import textwrap
from pathlib import Path

import msgspec
import yaml

from oculus_driver.command_line import did_you_mean
from sonar_sim.errors import SceneError, SceneMissingError
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.schema import Section

MAX_BYTES = 1 << 20
MAX_DEPTH = 20


class _SceneLoader(yaml.SafeLoader):
    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse what makes a small file huge, or not what it looks like."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None) is not None:
            raise SceneError(f"line {line}: aliases and tags are not taken")
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise SceneError(f"line {line}: nested deeper than {MAX_DEPTH}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        if isinstance(node, yaml.MappingNode):
            _refuse_twice(node)
        return node


def _finite(loader: _SceneLoader, node: yaml.ScalarNode) -> float:
    """Read a number; nothing in a scene is infinite, and NaN passes through every limit."""
    number = float(loader.construct_yaml_float(node))
    if not math.isfinite(number):
        line = node.start_mark.line + 1
        raise SceneError(f"line {line}: {node.value[:60]} is not a finite number")
    return number


_SceneLoader.add_constructor("tag:yaml.org,2002:float", _finite)


def _refuse_twice(node: yaml.MappingNode) -> None:
    names: set[str] = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise SceneError(f"line {key.start_mark.line + 1}: a key must be a name")
        if key.value in names:
            raise SceneError(f"line {key.start_mark.line + 1}: {key.value[:60]} is set twice")
        names.add(key.value)


# All that an unquoted word may be besides text: YAML 1.1 has more (no, 1:30, 010, 2001-01-01),
# and lacks 1e-3.
_SceneLoader.yaml_implicit_resolvers = {}
for _kind, _pattern, _first in (
    ("bool", r"true|false", "tf"),
    ("null", r"~|null|", ["~", "n", ""]),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", "-+0123456789"),
    ("float", r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?[0-9]+[eE][-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?\.inf|\.nan", "-+."),
):
    _SceneLoader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_kind}", re.compile(f"^(?:{_pattern})$"), list(_first)
    )


def read_tree(path: Path) -> object:
    """Read a file's one document into plain dicts, lists and scalars.

    Raises:
        SceneError: it cannot be read or is not YAML as we take it; names file and line.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise SceneMissingError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > MAX_BYTES:
        raise SceneError(f"{path}: larger than {MAX_BYTES >> 20} MiB, not a scene")
    try:
        return yaml.load(data.decode("utf-8-sig"), _SceneLoader)  # noqa: S506 a subclass of the safe one
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        raise SceneError(f"{path}: {where}not YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        line = (str(error).splitlines() or ["cannot be read"])[0]
        raise SceneError(f"{path}: not YAML: {line}") from error


def read_scene_file(path: Path) -> schema.SceneFile:
    """Read and check a file; nothing is built yet.

    Raises:
        SceneError: one line that names the file, the place in it, and what is wrong.
    """
    tree = read_tree(path)
    if not isinstance(tree, dict):
        raise SceneError(f"{path}: $: a mapping of sections was expected")
    try:
        return msgspec.convert(tree, schema.SceneFile)
    except msgspec.ValidationError as error:
        raise SceneError(f"{path}: {_explained(str(error), tree)}") from error


def _explained(message: str, tree: object) -> str:
    match = re.fullmatch(r"(.*?)(?: - at (?:`key` in )?`(\$[^`]*)`)?", message, re.DOTALL)
    what, place = (match[1], match[2] or "$") if match else (message, "$")
    found = _at(tree, place)
    if unknown := re.search(r"unknown field `(.*)`", what, re.DOTALL):
        return f"{place}.{unknown[1][:60]}: there is no such setting{_hint(unknown[1], found)}"
    if "required field" in what or isinstance(found, (dict, list)):
        return f"{place}: {what}"
    return f"{place}: {_shown(found)} is not allowed: {what}"


def _hint(name: str, section: object) -> str:
    names = sorted(FIELD_NAMES - set(section if isinstance(section, dict) else ()))
    return did_you_mean(name, names)


def _at(tree: object, place: str) -> object:
    """What stands at a place such as `$.objects[3].shape`."""
    for key, index in re.findall(r"\.([^.\[\]]+)|\[(\d+)\]", place):
        if isinstance(tree, dict):
            tree = tree.get(key)
        elif isinstance(tree, list) and index and int(index) < len(tree):
            tree = tree[int(index)]
        else:
            return None
    return tree


def _shown(value: object) -> str:
    text = "nothing" if value is None else " ".join(yaml.safe_dump(value, width=10**6).split())
    return textwrap.shorten(text.removesuffix("..."), 60, placeholder="...")


FIELD_NAMES = {
    name
    for section in vars(schema).values()
    if isinstance(section, type) and issubclass(section, Section)
    for name in section.__struct_fields__
}
