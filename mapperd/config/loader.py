"""Read settings from YAML files; reject unknown, duplicate and invalid values."""

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import yaml

from mapperd.config.aliases import tree_renamed, tree_updated
from mapperd.config.catalog import hint_at, rule_text, section_of
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, os_reason
from oculus_driver.command_line import hint_at_name

__all__ = [
    "MAX_DEPTH",
    "MAX_FILE_BYTES",
    "YamlProblem",
    "check_value",
    "config_from_text",
    "config_of",
    "holds_nodes",
    "load_config",
    "parse_yaml",
    "read_tree",
]

MAX_DEPTH = 16
"""Nesting beyond this is refused before it can exhaust the stack."""


class YamlProblem(ValueError):  # noqa: N818 it is always wrapped by the caller's error
    """The text is not YAML as we take it; the message is one line with the place."""


class _SettingsLoader(yaml.SafeLoader):
    """Safe loading that refuses what a settings file never needs."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse aliases (a bomb of them is small to write, huge to hold) and deep nesting."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise YamlProblem(
                f"{_place(event.start_mark)}: aliases (*{event.anchor}) are not taken"
            )
        if getattr(event, "tag", None) is not None:
            raise YamlProblem(f"{_place(event.start_mark)}: tags ({event.tag}) are not taken")
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise YamlProblem(f"{_place(event.start_mark)}: nested deeper than {MAX_DEPTH}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:  # noqa: FBT001, FBT002 the base class's signature
        """Build a mapping; duplicate keys and merges are mistakes, not last-one-wins."""
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise YamlProblem(f"{_place(key.start_mark)}: a key must be a name")
            if key.value in seen:
                raise YamlProblem(f"{_place(key.start_mark)}: {key.value[:60]} is set twice")
            if key.tag == "tag:yaml.org,2002:merge":
                raise YamlProblem(f"{_place(key.start_mark)}: merge keys (<<) are not taken")
            seen.add(key.value)
        return super().construct_mapping(node, deep=deep)


# What an unquoted word may be, else it is text. YAML 1.1 also reads 1:30 as 90, 1_0 as 10, 010 as
# 8, no as false and 2001-01-01 as a date, but 1e-3 as text.
_SettingsLoader.yaml_implicit_resolvers = {}
for _kind, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", "-+0123456789"),
    ("float", r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?[0-9]+[eE][-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", "-+."),
    ("merge", r"<<", "<"),  # to be refused by name
):
    _SettingsLoader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_kind}", re.compile(f"^(?:{_pattern})$"), list(_first)
    )


def parse_yaml(text: str) -> object:
    """Parse one YAML document into plain dicts, lists and scalars.

    Raises:
        YamlProblem: one line with place and reason.
    """
    try:
        return yaml.load(text, _SettingsLoader)  # noqa: S506 a subclass of the safe loader
    except YamlProblem:
        raise
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = _place(mark) if mark else "somewhere"
        raise YamlProblem(f"{where}: not YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        line = (str(error).splitlines() or ["cannot be read"])[0]
        raise YamlProblem(f"not YAML: {line}") from error


def _place(mark: Any) -> str:  # noqa: ANN401 the two kinds of mark have no common type
    return f"line {mark.line + 1}, column {mark.column + 1}"


MAX_FILE_BYTES = 256 * 1024
"""A settings file is a few kilobytes; more is a mistake or an attack."""


def load_config(path: Path) -> Config:
    """Read settings from one YAML file.

    Raises:
        ConfigError: the file cannot be read, or something in it is wrong; one line that names
            the file, the place, what is wrong and what is allowed.
    """
    return config_of(read_tree(path), str(path))


def config_from_text(text: str, name: str = "config") -> Config:
    """Read settings from YAML text; an empty document or section means the defaults.

    Args:
        text: the document.
        name: what to call it in messages.

    Raises:
        ConfigError: as `load_config`.
    """
    return config_of(_tree_of(text, name), name)


def read_tree(path: Path) -> dict[str, Any]:
    """Read the sections and values of a YAML file, without defaults.

    Settings of earlier versions are in it as they stand: see `tree_updated`.

    Raises:
        ConfigError: as `load_config`, but for rules about several settings, as long as others may
            be set elsewhere.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would keep us waiting
            kind = "a directory" if path.is_dir() else "no regular file"
            raise ConfigError(f"{path}: cannot be read: is {kind}")
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {os_reason(error)}") from error
    if len(data) > MAX_FILE_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_FILE_BYTES // 1024} KiB, not a settings file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start})") from error
    return _tree_of(text, str(path))


def check_value(value: object, path: str, name: str) -> None:
    """Check one setting on its own.

    Args:
        value: plain.
        path: `$.octree.voxel_resolution`.
        name: name of the source, for messages.

    Raises:
        ConfigError: it is not allowed.
    """
    try:
        msgspec.convert(value, hint_at(path))
    except msgspec.ValidationError as error:
        raise _explained(str(error), value, path, name) from error


def _tree_of(text: str, name: str) -> dict[str, Any]:
    try:
        tree = parse_yaml(text)
    except YamlProblem as problem:
        raise ConfigError(f"{name}: {problem}") from problem
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{name}: $: a mapping of sections was expected")
    tree = _without_nodes(tree, name)
    for section in Config.__struct_fields__:
        if section in tree and tree[section] is None:
            tree[section] = {}
    try:
        tree = tree_renamed(tree)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}", error.path) from error
    _check_section(tree_updated(tree)[0], Config, "$", name)
    return tree


ROS = "ros__parameters"
AMCL_NODE = "amcl"


def _without_nodes(tree: dict[Any, Any], name: str) -> dict[Any, Any]:
    """Sections and values of a ROS 2 parameter file, all nodes together; other files as they are.

    A node called `amcl` has the settings of that section.
    """
    nodes = list(_nodes_of(tree, ""))
    if not nodes:
        return tree
    for key, value in tree.items():
        if not any(_nodes_of({key: value}, "")):
            raise ConfigError(f"{name}: {key}: stands beside nodes with {ROS}; allowed: in one")
    merged: dict[Any, Any] = {}
    origins: dict[str, str] = {}
    for node, values in nodes:
        if not isinstance(values, dict | None):
            raise ConfigError(f"{name}: {node}.{ROS}: a mapping of sections was expected")
        in_section = node.rpartition("/")[2] == AMCL_NODE and AMCL_NODE not in (values or {})
        for path, value in _values_in({AMCL_NODE: values} if in_section else values or {}, ()):
            *sections, leaf = path
            inner = merged
            for section in sections:
                inner = inner.setdefault(section, {})
                if not isinstance(inner, dict):
                    break
            shown = ".".join(map(str, path))
            if not isinstance(inner, dict) or inner.setdefault(leaf, value) != value:
                text = f"is set otherwise in {origins.get(shown, 'the same file')}"
                raise ConfigError(f"{name}: {node}: {shown}: {text}", f"$.{shown}")
            origins[shown] = node
    return merged


def holds_nodes(tree: object) -> bool:
    """Whether these are parameters of ROS 2 nodes, as `parse_yaml` gives them."""
    return isinstance(tree, dict) and any(_nodes_of(tree, ""))


def _nodes_of(tree: dict[Any, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Nodes and their parameters: `node: {ros__parameters: ...}`, also in namespaces."""
    for key, value in tree.items():
        if key == ROS:
            yield prefix or ROS, value
        elif isinstance(value, dict):
            yield from _nodes_of(value, f"{prefix}/{key}".removeprefix("/"))


def _values_in(tree: dict[Any, Any], prefix: tuple[Any, ...]) -> Iterator[tuple[Any, Any]]:
    """Values by path; ROS allows `iwlo.sharpness` for a section and its field."""
    for key, value in tree.items():
        path = (*prefix, *(key.split(".") if isinstance(key, str) else (key,)))
        if isinstance(value, dict) and value:
            yield from _values_in(value, path)
        else:
            yield path, value


def config_of(tree: dict[str, Any], name: str) -> Config:
    """Build settings from sections and values; missing ones get their default.

    Args:
        tree: as of `read_tree`, or the settings in a recording or a store; those of earlier
            versions are brought up to date.
        name: where it comes from, for messages.

    Raises:
        ConfigError: as `load_config`; here also for rules about several settings.
    """
    tree, _ = tree_updated(tree)
    try:
        return msgspec.convert(tree, Config)
    except msgspec.ValidationError as error:
        raise _explained(str(error), tree, "$", name) from error


def _check_section(tree: Any, section: type[Any], path: str, name: str) -> None:  # noqa: ANN401
    if not isinstance(tree, dict):
        raise ConfigError(f"{name}: {path}: {_section_problem('Expected `object`', path)}", path)
    for field, value in tree.items():
        if not isinstance(field, str):
            raise ConfigError(f"{name}: {path}: a key is not a name", path)
        if field not in section.__struct_fields__:
            raise _unknown_field(field, path, name)
        here = f"{path}.{field}"
        if rule_text(here) is None:
            _check_section(value, hint_at(here), here, name)
        else:
            check_value(value, here, name)


def _explained(message: str, value: object, at: str, name: str) -> ConfigError:
    """Turn msgspec's sentence about a value into ours: place, what is wrong, what is allowed."""
    match = re.fullmatch(r"(.*?)(?: - at (?:`key` in )?`\$([^`]*)`)?", message, re.DOTALL)
    what, below = (match[1], match[2] or "") if match else (message, "")
    path = at + below
    if unknown := re.search(r"unknown field `(.*)`", what, re.DOTALL):
        return _unknown_field(unknown[1], path, name)
    allowed = rule_text(path)
    if allowed is None:
        return ConfigError(f"{name}: {path}: {_section_problem(what, path)}", path)
    shown = _shown(_value_at(value, below))
    return ConfigError(f"{name}: {path}: {shown} is not allowed; allowed: {allowed}", path)


def _section_problem(what: str, path: str) -> str:
    """A rule about several fields as it stands, or ours for a section of the wrong kind."""
    if not what.startswith("Expected"):
        return what
    if what == "Expected `str`":
        return "a key is not a name"
    names = ", ".join(_fields_at(path))
    return f"a section was expected; allowed: {names}"


def _fields_at(path: str) -> tuple[str, ...]:
    section = section_of(hint_at(path))
    return () if section is None else section.__struct_fields__


def _unknown_field(field: str, path: str, name: str) -> ConfigError:
    known = _fields_at(path)
    hint = hint_at_name(field, known, f"allowed: {', '.join(known)}")
    where = f"{path}.{field[:60]}"
    return ConfigError(f"{name}: {where}: there is no such setting; {hint}", where)


def _value_at(tree: Any, below: str) -> Any:  # noqa: ANN401 whatever stands in the file
    for name, index in re.findall(r"\.([^.\[]+)|\[(\d+)\]", below):
        if isinstance(tree, dict):
            tree = tree.get(name)
        elif isinstance(tree, list) and index:
            tree = tree[int(index)]
    return tree


def _shown(value: object) -> str:
    """The value as its writer would know it, in one short line."""
    text = "nothing" if value is None else " ".join(yaml.safe_dump(value, width=10**6).split())
    return textwrap.shorten(text.removesuffix("..."), 60, placeholder="...")
